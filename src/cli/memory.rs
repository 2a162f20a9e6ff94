//! How the program takes memory from the system.

/// Blocks from this size on are given back to the system when they are free, bytes: frames are larger, all else is smaller.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const GIVEN_BACK_FROM: i32 = 1 << 20;

/// Has the C library give free frames back to the system.
///
/// By itself it keeps blocks as large as any that was ever freed, in a heap for each of many threads, where they leave holes: three hours
/// of `stars soak` then hold 446 MiB and more each hour, and 179 MiB so, in less CPU time.
pub fn give_back_what_is_large() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        // SAFETY: called before any other thread is there; it takes two numbers and keeps no pointer.
        #[allow(unsafe_code, reason = "the C library has no safe way to set this; measured: see above")]
        let taken = unsafe { libc::mallopt(libc::M_MMAP_THRESHOLD, GIVEN_BACK_FROM) };
        if taken == 0 {
            tracing::warn!("the C library keeps its own way with large blocks of memory");
        }
    }
}
