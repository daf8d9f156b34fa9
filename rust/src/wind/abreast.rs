//! What draws of catalogue rows share: states, and single-precision numbers of several rows, leaves or
//! columns, side by side.
//!
//! Plain loops that the compiler turns into vector instructions, within [`dispatch_narrow`], and those
//! instructions where it does not find them; each operation is rounded once, so that every
//! instruction set gives the same bits.
//!
//! [`dispatch_narrow`]: crate::lanes::dispatch_narrow

#[cfg(target_arch = "x86_64")]
use std::any::Any;
#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::{__m256, __m256i};
use std::f32::consts::LN_2;
use std::ops::{Index, IndexMut};

use pulp::Simd;
use pulp::bytemuck::{cast, cast_slice_mut};
#[cfg(target_arch = "x86_64")]
use pulp::x86::V3;

use crate::lanes::WIDTH;

/// How many are worked out together.
pub(super) const ABREAST: usize = 16;

/// Most components of a state.
pub(super) const MAX_DIMENSION: usize = 16;

/// Whitened or raw state; the components that it does not have are 0.
pub(super) type State = [f64; MAX_DIMENSION];

/// The states of a group of members, component by component.
pub(super) type States = [[f64; WIDTH]];

/// One number of each member of a group.
pub(super) type Each<T> = [T; WIDTH];

/// The number of each member.
#[inline(always)]
pub(super) fn each(number: impl Fn(usize) -> f32) -> Each<f32> {
    let mut numbers = [0.0; WIDTH];
    for (at, slot) in numbers.iter_mut().enumerate() {
        *slot = number(at);
    }
    numbers
}

/// After so many trials no row is drawn. A trial accepts by the law of the weights whatever went
/// before it, so the law stays exact.
pub(super) const MAX_TRIALS: usize = 200;

/// Least sum of the bounds at a state, of which the nearest is about 1 as a rule.
pub(super) const LEAST_TOTAL: f32 = 1e-18;

/// One number of each.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
#[repr(align(64))]
pub(super) struct Abreast(pub [f32; ABREAST]);

impl Abreast {
    /// The number of each place.
    #[inline(always)]
    pub(super) fn of(number: impl Fn(usize) -> f32) -> Self {
        let mut numbers = [0.0; ABREAST];
        for (place, slot) in numbers.iter_mut().enumerate() {
            *slot = number(place);
        }
        Self(numbers)
    }

    /// The same number in every place.
    #[inline(always)]
    pub(super) fn splat(number: f32) -> Self {
        Self([number; ABREAST])
    }

    /// Sums of the numbers up to each place, by doubling: of the last two, four, eight, all.
    #[inline(always)]
    pub(super) fn running<S: Simd>(self, simd: S) -> Self {
        #[cfg(target_arch = "x86_64")]
        if let Some(simd) = two_registers(simd) {
            return Self(cast(running_in_two(simd, cast(self.0))));
        }
        let mut sums = self;
        for step in [1, 2, 4, 8] {
            for place in (step..ABREAST).rev() {
                sums[place] += sums[place - step];
            }
        }
        sums
    }

    /// `2^t` of each `t < 127`, up to 3·10⁻⁷ of it; 0 for `t < −126`.
    #[inline(always)]
    pub(super) fn power<S: Simd>(mut self, simd: S) -> Self {
        const COEFFICIENTS: [f32; 6] =
            [1.340_043_3e-3, 9.676_037e-3, 5.550_327e-2, 2.402_210_7e-1, LN_2, 1.0];
        for t in cast_slice_mut::<f32, S::f32s>(&mut self.0) {
            let tiny = simd.less_than_f32s(*t, simd.splat_f32s(LEAST_EXPONENT));
            let power = polynomial_power(simd, *t, &COEFFICIENTS);
            *t = simd.select_f32s(tiny, simd.splat_f32s(0.0), power);
        }
        self
    }

    /// Numbers above `2^t`, for `t < 127`, by at most 0.35 %; for `t < −126` those of −126.
    #[inline(always)]
    pub(super) fn power_just_above<S: Simd>(mut self, simd: S) -> Self {
        const COEFFICIENTS: [f32; 3] = [0.238_840_9, 0.704_663_4, 1.002_172];
        for t in cast_slice_mut::<f32, S::f32s>(&mut self.0) {
            *t = polynomial_power(simd, *t, &COEFFICIENTS);
        }
        self
    }

    /// Place of the first number above another one; [`ABREAST`] if there is none.
    #[inline(always)]
    pub(super) fn first_above<S: Simd>(&self, simd: S, other: f32) -> usize {
        #[cfg(target_arch = "x86_64")]
        if let Some(simd) = two_registers(simd) {
            let (other, [first, last]) = (simd.splat_f32x8(other), cast(self.0));
            let above =
                |numbers| simd.avx._mm256_movemask_ps(cast(simd.cmp_gt_f32x8(numbers, other)));
            // Put together in one mask, they would be shuffled first.
            let (first, last) = (above(first), above(last) | 1 << (ABREAST / 2));
            let past = (ABREAST / 2) as u32 + last.trailing_zeros();
            return if first == 0 { past } else { first.trailing_zeros() } as usize;
        }
        self.0.iter().position(|number| *number > other).unwrap_or(ABREAST)
    }
}

/// The instruction set that takes half of the places at once, if it is that one.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn two_registers<S: Simd>(simd: S) -> Option<V3> {
    (&simd as &dyn Any).downcast_ref().copied()
}

/// [`Abreast::running`].
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn running_in_two(simd: V3, [mut first, mut last]: [__m256; 2]) -> [__m256; 2] {
    let add = |a, b: __m256i| simd.avx._mm256_add_ps(a, cast(b));
    for step in [1, 2, 4] {
        // The four places before each four.
        let [a, b]: [__m256i; 2] = [cast(first), cast(last)];
        let before_first = simd.avx2._mm256_permute2x128_si256::<0x08>(a, a);
        let before_last = simd.avx2._mm256_permute2x128_si256::<0x21>(a, b);
        let before = [(a, before_first), (b, before_last)].map(|(of, before)| match step {
            1 => simd.avx2._mm256_alignr_epi8::<12>(of, before),
            2 => simd.avx2._mm256_alignr_epi8::<8>(of, before),
            _ => before,
        });
        (first, last) = (add(first, before[0]), add(last, before[1]));
    }
    [first, add(last, cast(first))]
}

impl Index<usize> for Abreast {
    type Output = f32;
    #[inline(always)]
    fn index(&self, place: usize) -> &f32 {
        &self.0[place]
    }
}

impl IndexMut<usize> for Abreast {
    #[inline(always)]
    fn index_mut(&mut self, place: usize) -> &mut f32 {
        &mut self.0[place]
    }
}

/// Numbers less the squared distances of a place from boxes, `[lowest, highest]` of each component.
#[inline(always)]
pub(super) fn less_distance2(
    mut numbers: Abreast,
    boxes: &[[Abreast; 2]],
    place: &[f32],
) -> Abreast {
    for ([low, high], z) in boxes.iter().zip(place) {
        numbers = Abreast::of(|k| {
            let beyond = z - lesser(greater(*z, low[k]), high[k]);
            (-beyond).mul_add(beyond, numbers[k])
        });
    }
    numbers
}

/// Parts rows at the place `middle` in the order of one of the first `among` components: the one
/// that varies most.
pub(super) fn part(
    mut rows: Vec<u32>,
    middle: usize,
    whitened: &[f64],
    d: usize,
    among: usize,
) -> [Vec<u32>; 2] {
    let value = |row: &u32, k: usize| whitened[*row as usize * d + k];
    let range = |k: usize| {
        let of = rows.iter().map(|row| value(row, k));
        let bounds = of.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)));
        bounds.1 - bounds.0
    };
    let widest = (0..among).max_by(|a, b| range(*a).total_cmp(&range(*b))).unwrap_or(0);
    if middle > 0 {
        rows.select_nth_unstable_by(middle, |a, b| {
            value(a, widest).total_cmp(&value(b, widest)).then(a.cmp(b))
        });
    }
    let second = rows.split_off(middle);
    [rows, second]
}

/// The greater of two numbers: [`f32::max`] would look out for NaN.
#[inline(always)]
pub(super) fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The lesser of two numbers.
#[inline(always)]
pub(super) fn lesser(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// Exponent of the least normal float.
const LEAST_EXPONENT: f32 = -126.0;

/// A number above `2^t`, for `t < 127`, by at most 6.4 %; for `t < −126` it is that of −126.
///
/// It is on the chord of the powers between integers: the bits of a float grow along it.
#[inline(always)]
pub(super) fn power_above(t: f32) -> f32 {
    /// More than the sum's rounding can take.
    const ROUNDED: f32 = 1e-3;
    // The sum, between 512 and 1024, has 14 bits after the point; the shift drops its own exponent
    // and makes what is above 512 the new one, and the mantissa.
    let fixed = greater(t + ROUNDED, LEAST_EXPONENT) + (127.0 + 512.0);
    f32::from_bits(fixed.to_bits() << 9)
}

/// [`power_above`] is no more than so many times `2^t`.
pub(super) const LOOSEST: f64 = 1.064;

/// [`Abreast::power_just_above`] is no more than so many times the power.
pub(super) const JUST_ABOVE: f64 = 1.0035;

/// `2^t` for `t < 127`, by a polynomial in what `t` is above the nearest integer; for `t` below
/// [`LEAST_EXPONENT`] it is that of the latter.
#[inline(always)]
fn polynomial_power<S: Simd>(simd: S, t: S::f32s, coefficients: &[f32]) -> S::f32s {
    // A number whose last bits are the integer nearest to `t`.
    const ROUNDING: f32 = 12_582_912.0;
    let t = simd.max_f32s(t, simd.splat_f32s(LEAST_EXPONENT));
    let whole = simd.add_f32s(t, simd.splat_f32s(ROUNDING));
    let rest = simd.sub_f32s(t, simd.sub_f32s(whole, simd.splat_f32s(ROUNDING)));
    let mut power = simd.splat_f32s(coefficients[0]);
    for coefficient in &coefficients[1..] {
        power = simd.mul_add_f32s(power, rest, simd.splat_f32s(*coefficient));
    }
    let doublings = simd.wrapping_dyn_shl_u32s(cast(whole), simd.splat_u32s(23));
    cast(simd.add_u32s(cast(power), doublings))
}

#[cfg(test)]
mod tests {
    use pulp::{Scalar, WithSimd};

    use super::*;
    use crate::lanes::dispatch;

    #[test]
    fn power_above_is_a_close_bound() {
        for k in 0..1_250_000 {
            let t = -1e-4 * k as f32;
            let (power, above) = (f64::from(t).exp2(), f64::from(power_above(t)));
            assert!(power <= above && above <= LOOSEST * power, "{t}: {power} {above}");
        }
    }

    /// What a kernel gives with every instruction set that this processor has.
    fn of_all_sets<K: WithSimd + Clone>(kernel: &K) -> Vec<K::Output> {
        let mut all = vec![dispatch(kernel.clone()), kernel.clone().with_simd(Scalar::new())];
        #[cfg(target_arch = "x86_64")]
        all.extend(V3::try_new().map(|simd| Simd::vectorize(simd, kernel.clone())));
        all
    }

    #[derive(Clone)]
    struct Powers(Abreast);

    impl WithSimd for Powers {
        type Output = [Abreast; 2];

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
            [self.0.power(simd), self.0.power_just_above(simd)]
        }
    }

    #[test]
    fn powers_are_the_power_and_a_closer_bound() {
        for first in (0..1_330_000).step_by(ABREAST) {
            let exponents = Abreast::of(|k| 7.0 - 1e-4 * (first + k) as f32);
            let all = of_all_sets(&Powers(exponents));
            assert!(all.iter().all(|powers| *powers == all[0]), "{exponents:?}");
            for (k, t) in exponents.0.into_iter().enumerate() {
                let exact = f64::from(t).exp2();
                let [power, above] = all[0].map(|of| f64::from(of[k]));
                assert!(exact <= above, "{t}: {exact} {above}");
                if t < -126.0 {
                    assert_eq!(power, 0.0);
                } else {
                    assert!((power / exact - 1.0).abs() < 3e-7, "{t}: {power} {exact}");
                    assert!(above <= JUST_ABOVE * exact, "{t}: {exact} {above}");
                }
            }
        }
    }

    #[derive(Clone)]
    struct Sums(Abreast, f32);

    impl WithSimd for Sums {
        type Output = (Abreast, usize);

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
            let sums = self.0.running(simd);
            (sums, sums.first_above(simd, self.1))
        }
    }

    #[test]
    fn sums_run_and_are_searched() {
        let numbers = Abreast::of(|k| k as f32);
        let places = (0..=ABREAST).flat_map(|place| {
            let sum = (place * (place + 1) / 2) as f32;
            [(sum - 0.5, place), (sum, place + 1)]
        });
        for (other, first) in places {
            for (sums, found) in of_all_sets(&Sums(numbers, other)) {
                assert!((0..ABREAST).all(|k| sums[k] == (k * (k + 1) / 2) as f32));
                assert_eq!(found, first.min(ABREAST));
            }
        }
        // Each instruction set rounds alike.
        let numbers = Abreast::of(|k| (0.7 * k as f32).sin().exp());
        let all = of_all_sets(&Sums(numbers, 0.0));
        assert!(all.iter().all(|sums| *sums == all[0]));
    }
}
