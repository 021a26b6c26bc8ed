//! Vectors of `f64` for the machine at hand, chosen when the program runs.
//!
//! This is the only file of the crate with unsafe code. All of it rests on one fact: a value of
//! [`Avx512`] or [`Avx2`] exists only where [`run`] has made sure that the processor has the
//! instructions, so calling them is sound.
#![allow(unsafe_code)]

/// Vectors of [`LANES`](Simd::LANES) numbers. Results differ between implementations by rounding
/// alone: where there is no fused multiplication, products are rounded on their own.
pub(crate) trait Simd: Copy {
    /// [`LANES`](Simd::LANES) numbers.
    type Vector: Copy;
    /// Numbers in a vector.
    const LANES: usize;
    /// The same number in every lane.
    fn splat(self, x: f64) -> Self::Vector;
    /// The first numbers of a slice, which must be long enough.
    fn load(self, from: &[f64]) -> Self::Vector;
    /// Into the first places of a slice, which must be long enough.
    fn store(self, v: Self::Vector, to: &mut [f64]);
    /// a − b.
    fn sub(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a·b.
    fn mul(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a·b + c.
    fn mul_add(self, a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;
    /// c − a·b.
    fn mul_sub(self, a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;
    /// a·b + c for a single number: the bits of [`mul_add`](Simd::mul_add).
    fn one_mul_add(self, a: f64, b: f64, c: f64) -> f64;
    /// a / b.
    fn div(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// √a.
    fn sqrt(self, a: Self::Vector) -> Self::Vector;
    /// The lesser of each pair; `x` where it is NaN.
    fn at_most(self, x: Self::Vector, most: Self::Vector) -> Self::Vector;
    /// `then` in the lanes where `x` > 0, zero in the others.
    fn where_positive(self, x: Self::Vector, then: Self::Vector) -> Self::Vector;
    /// `m`·2ⁿ from n + 1.5·2⁵², for an integer −1022 ≤ n ≤ 1023.
    fn times_power(self, m: Self::Vector, shifted: Self::Vector) -> Self::Vector;
}

/// Something to compute with vectors of any width.
pub(crate) trait Work {
    /// What comes of it.
    type Output;
    /// Does it. Implementations are `#[inline(always)]`, so that they are compiled for the
    /// instructions of `simd`.
    fn with<S: Simd>(self, simd: S) -> Self::Output;
}

/// Sets of instructions there is code for, the least demanding first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Instructions {
    /// What every processor does.
    Portable,
    /// 256 bits and fused multiplication.
    Avx2,
    /// 512 bits.
    Avx512,
}

impl Instructions {
    /// The most this processor can do.
    pub(crate) fn best() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::is_x86_feature_detected as has;
            if has!("avx512f") && has!("avx2") && has!("fma") {
                return Instructions::Avx512;
            }
            if has!("avx2") && has!("fma") {
                return Instructions::Avx2;
            }
        }
        Instructions::Portable
    }
}

/// Does the work with the widest vectors of this processor.
pub(crate) fn run<W: Work>(work: W) -> W::Output {
    run_with(Instructions::best(), work)
}

/// Does the work with the widest vectors of this processor up to `most`.
pub(crate) fn run_with<W: Work>(most: Instructions, work: W) -> W::Output {
    match Instructions::best().min(most) {
        // SAFETY: `best` is at least Avx512: the processor has avx512f, avx2 and fma.
        #[cfg(target_arch = "x86_64")]
        Instructions::Avx512 => unsafe { x86::avx512(work) },
        // SAFETY: `best` is at least Avx2: the processor has avx2 and fma.
        #[cfg(target_arch = "x86_64")]
        Instructions::Avx2 => unsafe { x86::avx2(work) },
        _ => work.with(Portable(())),
    }
}

/// Two lanes of plain arithmetic.
#[derive(Clone, Copy)]
pub(crate) struct Portable(());

impl Simd for Portable {
    type Vector = [f64; 2];
    const LANES: usize = 2;

    #[inline(always)]
    fn splat(self, x: f64) -> [f64; 2] {
        [x; 2]
    }

    #[inline(always)]
    fn load(self, from: &[f64]) -> [f64; 2] {
        [from[0], from[1]]
    }

    #[inline(always)]
    fn store(self, v: [f64; 2], to: &mut [f64]) {
        to[..2].copy_from_slice(&v);
    }

    #[inline(always)]
    fn sub(self, a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
        [a[0] - b[0], a[1] - b[1]]
    }

    #[inline(always)]
    fn mul(self, a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
        [a[0] * b[0], a[1] * b[1]]
    }

    #[inline(always)]
    fn mul_add(self, a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> [f64; 2] {
        [a[0] * b[0] + c[0], a[1] * b[1] + c[1]]
    }

    #[inline(always)]
    fn mul_sub(self, a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> [f64; 2] {
        [c[0] - a[0] * b[0], c[1] - a[1] * b[1]]
    }

    #[inline(always)]
    fn one_mul_add(self, a: f64, b: f64, c: f64) -> f64 {
        a * b + c
    }

    #[inline(always)]
    fn div(self, a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
        [a[0] / b[0], a[1] / b[1]]
    }

    #[inline(always)]
    fn sqrt(self, a: [f64; 2]) -> [f64; 2] {
        [a[0].sqrt(), a[1].sqrt()]
    }

    #[inline(always)]
    fn at_most(self, x: [f64; 2], most: [f64; 2]) -> [f64; 2] {
        let one = |x: f64, most: f64| if x > most { most } else { x };
        [one(x[0], most[0]), one(x[1], most[1])]
    }

    #[inline(always)]
    fn where_positive(self, x: [f64; 2], then: [f64; 2]) -> [f64; 2] {
        let one = |x: f64, then: f64| if x > 0.0 { then } else { 0.0 };
        [one(x[0], then[0]), one(x[1], then[1])]
    }

    #[inline(always)]
    fn times_power(self, m: [f64; 2], shifted: [f64; 2]) -> [f64; 2] {
        let power = |s: f64| f64::from_bits(s.to_bits().wrapping_add(1023) << 52);
        [m[0] * power(shifted[0]), m[1] * power(shifted[1])]
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    use super::{Simd, Work};

    /// Proof that avx512f, avx2 and fma are there: made only in [`avx512`].
    #[derive(Clone, Copy)]
    pub(in crate::dense) struct Avx512(());

    /// Proof that avx2 and fma are there: made only in [`avx2`].
    #[derive(Clone, Copy)]
    pub(in crate::dense) struct Avx2(());

    #[target_feature(enable = "avx512f,avx2,fma")]
    pub(crate) fn avx512<W: Work>(work: W) -> W::Output {
        work.with(Avx512(()))
    }

    #[target_feature(enable = "avx2,fma")]
    pub(crate) fn avx2<W: Work>(work: W) -> W::Output {
        work.with(Avx2(()))
    }

    // SAFETY, for every block of both implementations: `self` proves that the instructions are
    // there, and loads and stores go through a slice whose length has just been checked.

    impl Simd for Avx512 {
        type Vector = __m512d;
        const LANES: usize = 8;

        #[inline(always)]
        fn splat(self, x: f64) -> __m512d {
            unsafe { _mm512_set1_pd(x) }
        }

        #[inline(always)]
        fn load(self, from: &[f64]) -> __m512d {
            let from = &from[..8];
            unsafe { _mm512_loadu_pd(from.as_ptr()) }
        }

        #[inline(always)]
        fn store(self, v: __m512d, to: &mut [f64]) {
            let to = &mut to[..8];
            unsafe { _mm512_storeu_pd(to.as_mut_ptr(), v) }
        }

        #[inline(always)]
        fn sub(self, a: __m512d, b: __m512d) -> __m512d {
            unsafe { _mm512_sub_pd(a, b) }
        }

        #[inline(always)]
        fn mul(self, a: __m512d, b: __m512d) -> __m512d {
            unsafe { _mm512_mul_pd(a, b) }
        }

        #[inline(always)]
        fn mul_add(self, a: __m512d, b: __m512d, c: __m512d) -> __m512d {
            unsafe { _mm512_fmadd_pd(a, b, c) }
        }

        #[inline(always)]
        fn mul_sub(self, a: __m512d, b: __m512d, c: __m512d) -> __m512d {
            unsafe { _mm512_fnmadd_pd(a, b, c) }
        }

        #[inline(always)]
        fn one_mul_add(self, a: f64, b: f64, c: f64) -> f64 {
            a.mul_add(b, c)
        }

        #[inline(always)]
        fn div(self, a: __m512d, b: __m512d) -> __m512d {
            unsafe { _mm512_div_pd(a, b) }
        }

        #[inline(always)]
        fn sqrt(self, a: __m512d) -> __m512d {
            unsafe { _mm512_sqrt_pd(a) }
        }

        #[inline(always)]
        fn at_most(self, x: __m512d, most: __m512d) -> __m512d {
            // The instruction gives its second operand where either is NaN.
            unsafe { _mm512_min_pd(most, x) }
        }

        #[inline(always)]
        fn where_positive(self, x: __m512d, then: __m512d) -> __m512d {
            unsafe {
                let positive = _mm512_cmp_pd_mask::<_CMP_GT_OQ>(x, _mm512_setzero_pd());
                _mm512_maskz_mov_pd(positive, then)
            }
        }

        #[inline(always)]
        fn times_power(self, m: __m512d, shifted: __m512d) -> __m512d {
            unsafe {
                let bits = _mm512_add_epi64(_mm512_castpd_si512(shifted), _mm512_set1_epi64(1023));
                _mm512_mul_pd(m, _mm512_castsi512_pd(_mm512_slli_epi64::<52>(bits)))
            }
        }
    }

    impl Simd for Avx2 {
        type Vector = __m256d;
        const LANES: usize = 4;

        #[inline(always)]
        fn splat(self, x: f64) -> __m256d {
            unsafe { _mm256_set1_pd(x) }
        }

        #[inline(always)]
        fn load(self, from: &[f64]) -> __m256d {
            let from = &from[..4];
            unsafe { _mm256_loadu_pd(from.as_ptr()) }
        }

        #[inline(always)]
        fn store(self, v: __m256d, to: &mut [f64]) {
            let to = &mut to[..4];
            unsafe { _mm256_storeu_pd(to.as_mut_ptr(), v) }
        }

        #[inline(always)]
        fn sub(self, a: __m256d, b: __m256d) -> __m256d {
            unsafe { _mm256_sub_pd(a, b) }
        }

        #[inline(always)]
        fn mul(self, a: __m256d, b: __m256d) -> __m256d {
            unsafe { _mm256_mul_pd(a, b) }
        }

        #[inline(always)]
        fn mul_add(self, a: __m256d, b: __m256d, c: __m256d) -> __m256d {
            unsafe { _mm256_fmadd_pd(a, b, c) }
        }

        #[inline(always)]
        fn mul_sub(self, a: __m256d, b: __m256d, c: __m256d) -> __m256d {
            unsafe { _mm256_fnmadd_pd(a, b, c) }
        }

        #[inline(always)]
        fn one_mul_add(self, a: f64, b: f64, c: f64) -> f64 {
            a.mul_add(b, c)
        }

        #[inline(always)]
        fn div(self, a: __m256d, b: __m256d) -> __m256d {
            unsafe { _mm256_div_pd(a, b) }
        }

        #[inline(always)]
        fn sqrt(self, a: __m256d) -> __m256d {
            unsafe { _mm256_sqrt_pd(a) }
        }

        #[inline(always)]
        fn at_most(self, x: __m256d, most: __m256d) -> __m256d {
            unsafe { _mm256_min_pd(most, x) }
        }

        #[inline(always)]
        fn where_positive(self, x: __m256d, then: __m256d) -> __m256d {
            unsafe { _mm256_and_pd(_mm256_cmp_pd::<_CMP_GT_OQ>(x, _mm256_setzero_pd()), then) }
        }

        #[inline(always)]
        fn times_power(self, m: __m256d, shifted: __m256d) -> __m256d {
            unsafe {
                let bits = _mm256_add_epi64(_mm256_castpd_si256(shifted), _mm256_set1_epi64x(1023));
                _mm256_mul_pd(m, _mm256_castsi256_pd(_mm256_slli_epi64::<52>(bits)))
            }
        }
    }
}
