//! How the program takes memory from the system.

/// Blocks from this size on are given back to the system when they are free, bytes: frames are larger, all else is smaller.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const GIVEN_BACK_FROM: i32 = 1 << 20;

/// Heaps that the threads share: what is smaller is seldom asked for, and holes in one are filled from all.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const HEAPS: i32 = 1;

/// Has the C library give free frames back to the system, and keep all else together.
///
/// By itself it keeps blocks as large as any that was ever freed, in a heap for each of many threads, where they leave holes: three hours
/// of `stars soak` then hold 446 MiB and more each hour, and 179 MiB so, in less CPU time. With a heap for each thread eleven days still
/// added 7 %, and with one 1 to 5 %.
pub fn give_back_what_is_large() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        let wanted = [(libc::M_MMAP_THRESHOLD, GIVEN_BACK_FROM), (libc::M_ARENA_MAX, HEAPS)];
        // SAFETY: called before any other thread is there; it takes two numbers and keeps no pointer.
        #[allow(unsafe_code, reason = "the C library has no safe way to set this; measured: see above")]
        let taken = wanted.map(|(what, value)| unsafe { libc::mallopt(what, value) });
        if taken.contains(&0) {
            tracing::warn!("the C library keeps its own way with large blocks of memory");
        }
    }
}
