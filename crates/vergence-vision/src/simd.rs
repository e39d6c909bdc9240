//! Runs plain loops with the widest vector instructions that this processor has.
//!
//! Nothing is written in intrinsics: a [`Task`] is ordinary Rust over short arrays, always inlined, which the compiler turns into
//! vector code for the instruction set of the function that it lands in. No fused multiply-add is enabled, so results
//! have the same bits on every processor.

#![expect(
    unsafe_code,
    reason = "one call of a function for an instruction set that the processor was asked for"
)]

/// Work that is compiled once for each instruction set.
pub(crate) trait Task {
    /// What it gives.
    type Out;

    /// Does it. Implementations are `#[inline(always)]`, as is everything they call, or they gain nothing.
    fn run(self) -> Self::Out;
}

/// Runs `task` with 256-bit vectors where the processor has them.
#[inline]
pub(crate) fn vectorised<T: Task>(task: T) -> T::Out {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("popcnt") {
        #[target_feature(enable = "avx2,popcnt")]
        fn with_avx2<T: Task>(task: T) -> T::Out {
            task.run()
        }
        // SAFETY: with_avx2 needs AVX2 and POPCNT and nothing else; the processor has just said that it has both.
        return unsafe { with_avx2(task) };
    }
    task.run()
}

/// Eight numbers side by side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct F8(pub [f32; 8]);

impl F8 {
    #[inline(always)]
    pub fn splat(x: f32) -> Self {
        Self([x; 8])
    }

    /// From the first eight bytes of `bytes`.
    #[inline(always)]
    pub fn from_bytes(bytes: &[u8]) -> Self {
        let bytes: &[u8; 8] = bytes[..8].try_into().expect("eight bytes");
        Self(std::array::from_fn(|i| f32::from(bytes[i])))
    }

    /// From the first eight of `numbers`.
    #[inline(always)]
    pub fn load(numbers: &[f32]) -> Self {
        Self(numbers[..8].try_into().expect("eight numbers"))
    }

    /// Over the first eight of `numbers`.
    #[inline(always)]
    pub fn store(self, numbers: &mut [f32]) {
        numbers[..8].copy_from_slice(&self.0);
    }

    /// The sum, always in the same order.
    #[inline(always)]
    pub fn sum(self) -> f32 {
        let a = self.0;
        ((a[0] + a[4]) + (a[2] + a[6])) + ((a[1] + a[5]) + (a[3] + a[7]))
    }
}

impl std::ops::Add for F8 {
    type Output = Self;

    #[inline(always)]
    fn add(self, right: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + right.0[i]))
    }
}

impl std::ops::Sub for F8 {
    type Output = Self;

    #[inline(always)]
    fn sub(self, right: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] - right.0[i]))
    }
}

impl std::ops::Mul for F8 {
    type Output = Self;

    #[inline(always)]
    fn mul(self, right: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] * right.0[i]))
    }
}
