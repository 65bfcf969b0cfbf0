//! Vectors of f32 for the fast body. Every operation rounds individually by IEEE 754, so all widths give the same bits.
//!
//! Safety: the methods of `Avx2` and `Avx512` are instructions that an older processor lacks. They are private to
//! `blending`, and reached only through `super::cpu::dispatch`, which checks the processor first. Loads and stores go through
//! arrays whose size holds every part.
#![allow(unsafe_code)]

use crate::rasteriser::binning::TILE;

/// One row of a tile.
pub(super) type Row = [f32; TILE];

/// A vector of f32: half a row of a tile, or a whole one. The sum of a row is ((x₀+x₂)+(x₁+x₃)) + ((x₄+x₆)+(x₅+x₇)),
/// where xᵢ is the sum of pixels i and i + 8.
pub(crate) trait Lanes: Copy {
    /// 8 or 16; a row has `TILE / WIDTH` parts.
    const WIDTH: usize;
    type Mask: Copy;

    fn splat(value: f32) -> Self;
    fn load(row: &Row, part: usize) -> Self;
    fn store(self, row: &mut Row, part: usize);
    fn add(self, other: Self) -> Self;
    fn sub(self, other: Self) -> Self;
    fn mul(self, other: Self) -> Self;
    fn div(self, other: Self) -> Self;
    fn min(self, other: Self) -> Self;
    fn max(self, other: Self) -> Self;
    /// self·factor + summand with one rounding.
    fn mul_add(self, factor: Self, summand: Self) -> Self;
    /// summand − self·factor with one rounding.
    fn neg_mul_add(self, factor: Self, summand: Self) -> Self;
    /// To the nearest integer, ties to even.
    fn round(self) -> Self;
    /// self·2ⁿ for integral n where self and the result are normal numbers.
    fn scale_by_power_of_two(self, n: Self) -> Self;
    fn negate(self) -> Self;
    /// self ≤ other.
    fn le(self, other: Self) -> Self::Mask;
    /// self < other.
    fn lt(self, other: Self) -> Self::Mask;
    fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// Bit i is lane i.
    fn bits(mask: Self::Mask) -> u32;
    /// self where the mask is set, 0 elsewhere.
    fn keep(self, mask: Self::Mask) -> Self;
    /// `yes` where the mask is set, `no` elsewhere.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// The sum over all lanes of both parts of a row, for eight rows; the right part does not exist for 16 lanes.
    fn sum8(left: &[Self; 8], right: &[Self; 8]) -> [f32; 8];
    /// The sum of the pixels of one row.
    fn sum(left: Self, right: Self) -> f32;
}

/// Eight lanes in the instructions of the target.
#[derive(Clone, Copy)]
pub(super) struct Portable([f32; 8]);

impl Portable {
    #[inline(always)]
    fn map(self, f: impl Fn(f32) -> f32) -> Self {
        Self(self.0.map(f))
    }

    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|lane| f(self.0[lane], other.0[lane])))
    }

    #[inline(always)]
    fn compare(self, other: Self, f: impl Fn(&f32, &f32) -> bool) -> [bool; 8] {
        std::array::from_fn(|lane| f(&self.0[lane], &other.0[lane]))
    }
}

impl Lanes for Portable {
    const WIDTH: usize = 8;
    type Mask = [bool; 8];

    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self([value; 8])
    }
    #[inline(always)]
    fn load(row: &Row, part: usize) -> Self {
        Self(row.as_chunks().0[part])
    }
    #[inline(always)]
    fn store(self, row: &mut Row, part: usize) {
        row.as_chunks_mut().0[part] = self.0;
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.zip(other, f32::min)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.zip(other, f32::max)
    }
    #[inline(always)]
    fn mul_add(self, factor: Self, summand: Self) -> Self {
        Self(std::array::from_fn(|lane| self.0[lane].mul_add(factor.0[lane], summand.0[lane])))
    }
    #[inline(always)]
    fn neg_mul_add(self, factor: Self, summand: Self) -> Self {
        self.negate().mul_add(factor, summand)
    }
    #[inline(always)]
    fn round(self) -> Self {
        self.map(f32::round_ties_even)
    }
    #[inline(always)]
    fn scale_by_power_of_two(self, n: Self) -> Self {
        self.zip(n, |value, n| f32::from_bits(value.to_bits().wrapping_add((n as i32 as u32) << 23)))
    }
    #[inline(always)]
    fn negate(self) -> Self {
        self.map(|value| -value)
    }
    #[inline(always)]
    fn le(self, other: Self) -> Self::Mask {
        self.compare(other, f32::le)
    }
    #[inline(always)]
    fn lt(self, other: Self) -> Self::Mask {
        self.compare(other, f32::lt)
    }
    #[inline(always)]
    fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        std::array::from_fn(|lane| a[lane] & b[lane])
    }
    #[inline(always)]
    fn bits(mask: Self::Mask) -> u32 {
        (0..8).fold(0, |bits, lane| bits | u32::from(mask[lane]) << lane)
    }
    #[inline(always)]
    fn keep(self, mask: Self::Mask) -> Self {
        Self::select(mask, self, Self::splat(0.0))
    }
    #[inline(always)]
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self {
        Self(std::array::from_fn(|lane| if mask[lane] { yes.0[lane] } else { no.0[lane] }))
    }
    #[inline(always)]
    fn sum8(left: &[Self; 8], right: &[Self; 8]) -> [f32; 8] {
        std::array::from_fn(|row| Self::sum(left[row], right[row]))
    }
    #[inline(always)]
    fn sum(left: Self, right: Self) -> f32 {
        let x = left.add(right).0;
        ((x[0] + x[2]) + (x[1] + x[3])) + ((x[4] + x[6]) + (x[5] + x[7]))
    }
}

#[cfg(target_arch = "x86_64")]
pub(crate) use x86::{Avx2, Avx512};

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    use super::{Lanes, Row};

    #[derive(Clone, Copy)]
    pub(crate) struct Avx2(__m256);

    #[derive(Clone, Copy)]
    pub(crate) struct Avx512(__m512);

    /// Methods that are one instruction each.
    macro_rules! instructions {
        ($($name:ident($($other:ident),*) = $intrinsic:ident;)*) => {
            $(#[inline(always)]
            fn $name(self $(, $other: Self)*) -> Self {
                Self(unsafe { $intrinsic(self.0 $(, $other.0)*) })
            })*
        };
    }

    const TO_NEAREST: i32 = _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC;

    impl Lanes for Avx2 {
        const WIDTH: usize = 8;
        type Mask = __m256;

        instructions! {
            add(other) = _mm256_add_ps;
            sub(other) = _mm256_sub_ps;
            mul(other) = _mm256_mul_ps;
            div(other) = _mm256_div_ps;
            min(other) = _mm256_min_ps;
            max(other) = _mm256_max_ps;
            mul_add(factor, summand) = _mm256_fmadd_ps;
            neg_mul_add(factor, summand) = _mm256_fnmadd_ps;
        }

        #[inline(always)]
        fn splat(value: f32) -> Self {
            Self(unsafe { _mm256_set1_ps(value) })
        }
        #[inline(always)]
        fn load(row: &Row, part: usize) -> Self {
            Self(unsafe { _mm256_loadu_ps(row.as_ptr().add(8 * (part & 1))) })
        }
        #[inline(always)]
        fn store(self, row: &mut Row, part: usize) {
            unsafe { _mm256_storeu_ps(row.as_mut_ptr().add(8 * (part & 1)), self.0) }
        }
        #[inline(always)]
        fn round(self) -> Self {
            Self(unsafe { _mm256_round_ps::<TO_NEAREST>(self.0) })
        }
        #[inline(always)]
        fn scale_by_power_of_two(self, n: Self) -> Self {
            Self(unsafe {
                let exponent = _mm256_slli_epi32::<23>(_mm256_cvtps_epi32(n.0));
                _mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(self.0), exponent))
            })
        }
        #[inline(always)]
        fn negate(self) -> Self {
            Self(unsafe { _mm256_xor_ps(self.0, _mm256_set1_ps(-0.0)) })
        }
        #[inline(always)]
        fn le(self, other: Self) -> __m256 {
            unsafe { _mm256_cmp_ps::<_CMP_LE_OQ>(self.0, other.0) }
        }
        #[inline(always)]
        fn lt(self, other: Self) -> __m256 {
            unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0) }
        }
        #[inline(always)]
        fn and(a: __m256, b: __m256) -> __m256 {
            unsafe { _mm256_and_ps(a, b) }
        }
        #[inline(always)]
        fn bits(mask: __m256) -> u32 {
            unsafe { _mm256_movemask_ps(mask) as u32 }
        }
        #[inline(always)]
        fn keep(self, mask: __m256) -> Self {
            Self(unsafe { _mm256_and_ps(self.0, mask) })
        }
        #[inline(always)]
        fn select(mask: __m256, yes: Self, no: Self) -> Self {
            Self(unsafe { _mm256_blendv_ps(no.0, yes.0, mask) })
        }
        #[inline(always)]
        fn sum8(left: &[Self; 8], right: &[Self; 8]) -> [f32; 8] {
            let mut x = [left[0].0; 8];
            for row in 0..8 {
                x[row] = left[row].add(right[row]).0;
            }
            unsafe { sum8(x) }
        }
        #[inline(always)]
        fn sum(left: Self, right: Self) -> f32 {
            unsafe { sum(left.add(right).0) }
        }
    }

    impl Lanes for Avx512 {
        const WIDTH: usize = 16;
        type Mask = __mmask16;

        instructions! {
            add(other) = _mm512_add_ps;
            sub(other) = _mm512_sub_ps;
            mul(other) = _mm512_mul_ps;
            div(other) = _mm512_div_ps;
            min(other) = _mm512_min_ps;
            max(other) = _mm512_max_ps;
            mul_add(factor, summand) = _mm512_fmadd_ps;
            neg_mul_add(factor, summand) = _mm512_fnmadd_ps;
            scale_by_power_of_two(n) = _mm512_scalef_ps;
        }

        #[inline(always)]
        fn splat(value: f32) -> Self {
            Self(unsafe { _mm512_set1_ps(value) })
        }
        #[inline(always)]
        fn load(row: &Row, _part: usize) -> Self {
            Self(unsafe { _mm512_loadu_ps(row.as_ptr()) })
        }
        #[inline(always)]
        fn store(self, row: &mut Row, _part: usize) {
            unsafe { _mm512_storeu_ps(row.as_mut_ptr(), self.0) }
        }
        #[inline(always)]
        fn round(self) -> Self {
            Self(unsafe { _mm512_roundscale_ps::<TO_NEAREST>(self.0) })
        }
        #[inline(always)]
        fn negate(self) -> Self {
            Self(unsafe { _mm512_xor_ps(self.0, _mm512_set1_ps(-0.0)) })
        }
        #[inline(always)]
        fn le(self, other: Self) -> __mmask16 {
            unsafe { _mm512_cmp_ps_mask::<_CMP_LE_OQ>(self.0, other.0) }
        }
        #[inline(always)]
        fn lt(self, other: Self) -> __mmask16 {
            unsafe { _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0) }
        }
        #[inline(always)]
        fn and(a: __mmask16, b: __mmask16) -> __mmask16 {
            a & b
        }
        #[inline(always)]
        fn bits(mask: __mmask16) -> u32 {
            u32::from(mask)
        }
        #[inline(always)]
        fn keep(self, mask: __mmask16) -> Self {
            Self(unsafe { _mm512_maskz_mov_ps(mask, self.0) })
        }
        #[inline(always)]
        fn select(mask: __mmask16, yes: Self, no: Self) -> Self {
            Self(unsafe { _mm512_mask_mov_ps(no.0, mask, yes.0) })
        }
        #[inline(always)]
        fn sum8(row: &[Self; 8], _right: &[Self; 8]) -> [f32; 8] {
            // A loop, not `map`: closures are not compiled for the caller's instruction set.
            let mut x = [unsafe { fold(row[0].0) }; 8];
            for index in 1..8 {
                x[index] = unsafe { fold(row[index].0) };
            }
            unsafe { sum8(x) }
        }
        #[inline(always)]
        fn sum(row: Self, _right: Self) -> f32 {
            unsafe { sum(fold(row.0)) }
        }
    }

    /// Adds lanes i and i + 8.
    #[inline(always)]
    unsafe fn fold(row: __m512) -> __m256 {
        unsafe { _mm256_add_ps(_mm512_castps512_ps256(row), _mm512_extractf32x8_ps::<1>(row)) }
    }

    /// Sums of eight vectors at once: each step adds the two halves of every remaining vector.
    #[inline(always)]
    unsafe fn sum8(x: [__m256; 8]) -> [f32; 8] {
        unsafe {
            let (ab, cd) = (add_alternating(x[0], x[1]), add_alternating(x[2], x[3]));
            let (ef, gh) = (add_alternating(x[4], x[5]), add_alternating(x[6], x[7]));
            let (abcd, efgh) = (add_pairs(ab, cd), add_pairs(ef, gh));
            let low = _mm256_permute2f128_ps::<0x20>(abcd, efgh);
            let high = _mm256_permute2f128_ps::<0x31>(abcd, efgh);
            let mut sums = [0.0; 8];
            _mm256_storeu_ps(sums.as_mut_ptr(), _mm256_add_ps(low, high));
            sums
        }
    }

    /// (a₀+a₂, b₀+b₂, a₁+a₃, b₁+b₃) per 128 bits.
    #[inline(always)]
    unsafe fn add_alternating(a: __m256, b: __m256) -> __m256 {
        unsafe { _mm256_add_ps(_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b)) }
    }

    /// (p₀+p₂, p₁+p₃, q₀+q₂, q₁+q₃) per 128 bits.
    #[inline(always)]
    unsafe fn add_pairs(p: __m256, q: __m256) -> __m256 {
        unsafe { _mm256_add_ps(_mm256_shuffle_ps::<0b01_00_01_00>(p, q), _mm256_shuffle_ps::<0b11_10_11_10>(p, q)) }
    }

    #[inline(always)]
    unsafe fn sum(x: __m256) -> f32 {
        unsafe {
            let pairs = _mm256_add_ps(x, _mm256_permute_ps::<0b00_00_11_10>(x));
            let quads = _mm256_add_ps(pairs, _mm256_permute_ps::<0b00_00_00_01>(pairs));
            _mm_cvtss_f32(_mm_add_ss(_mm256_castps256_ps128(quads), _mm256_extractf128_ps::<1>(quads)))
        }
    }
}
