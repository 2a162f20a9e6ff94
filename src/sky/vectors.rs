//! Wider vectors where the processor has them.
//!
//! The kernels are plain loops that the compiler vectorises: for every x86-64 with 128 bits. Compiled once more for AVX2 and for AVX-512,
//! and chosen at run time, the same loops use 256 and 512. The results are the same bit for bit: the compiler does not contract
//! multiplications and additions by itself.

/// A piece of work in plain loops. [`Kernel::run`] and all that it calls must be `#[inline(always)]`, or they stay as they are.
pub trait Kernel {
    /// What comes out.
    type Output;
    /// Does the work.
    fn run(self) -> Self::Output;
}

/// Runs a kernel, compiled for the widest vectors that this processor has.
#[inline]
pub fn with_vectors<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn with_avx2<K: Kernel>(kernel: K) -> K::Output {
            kernel.run()
        }
        #[target_feature(enable = "avx2,avx512f,avx512bw,avx512dq,avx512vl")]
        fn with_avx512<K: Kernel>(kernel: K) -> K::Output {
            kernel.run()
        }
        if has_avx512() {
            // Measured on rendered frames: the fit takes six tenths of the time that it takes with AVX2, a whole frame 93 %.
            #[allow(unsafe_code, reason = "as below, for AVX-512")]
            // SAFETY: the processor was just found to have all that the call needs.
            return unsafe { with_avx512(kernel) };
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            // Measured on the flight images: the search for sources takes about half the time.
            #[allow(unsafe_code, reason = "the one place: code compiled for AVX2 is called where the processor has it")]
            // SAFETY: the processor was just found to have AVX2, which is all that the call needs.
            return unsafe { with_avx2(kernel) };
        }
    }
    kernel.run()
}

/// Whether this processor has AVX-512 with what kernels make use of.
#[cfg(target_arch = "x86_64")]
fn has_avx512() -> bool {
    std::arch::is_x86_feature_detected!("avx2")
        && std::arch::is_x86_feature_detected!("avx512f")
        && std::arch::is_x86_feature_detected!("avx512bw")
        && std::arch::is_x86_feature_detected!("avx512dq")
        && std::arch::is_x86_feature_detected!("avx512vl")
}
