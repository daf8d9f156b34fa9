//! What draws of catalogue rows share: states, and single-precision numbers of several rows, leaves or
//! columns, side by side.
//!
//! Plain loops that the compiler turns into vector instructions, within [`dispatch`]; each
//! operation is rounded once, so that every instruction set gives the same bits.
//!
//! [`dispatch`]: crate::lanes::dispatch

use std::ops::{Index, IndexMut};

use pulp::Simd;
use pulp::bytemuck::cast;

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
        if !in_one_register::<S>() {
            return [1, 2, 4, 8].into_iter().fold(self, |sums, step| {
                Self::of(|k| if k < step { sums[k] } else { sums[k] + sums[k - step] })
            });
        }
        let places: S::f32s = cast(PLACES);
        let mut sums: S::f32s = cast(self.0);
        for step in [1, 2, 4, 8] {
            let there = simd.greater_than_or_equal_f32s(places, simd.splat_f32s(step as f32));
            let before = simd.rotate_right_f32s(sums, step);
            sums = simd.add_f32s(sums, simd.select_f32s(there, before, simd.splat_f32s(0.0)));
        }
        Self(cast(sums))
    }

    /// Place of the first number above another one; [`ABREAST`] if there is none.
    #[inline(always)]
    pub(super) fn first_above<S: Simd>(&self, simd: S, other: f32) -> usize {
        if !in_one_register::<S>() {
            let places = self.0.iter().zip(0..);
            let above = places.map(|(number, k)| if *number > other { k } else { ABREAST as i32 });
            return above.fold(ABREAST as i32, i32::min) as usize;
        }
        let above = simd.greater_than_f32s(cast(self.0), simd.splat_f32s(other));
        cast::<_, u16>(above).trailing_zeros() as usize
    }
}

/// Whether an instruction set takes all places at once, with a bit of a mask for each. What is told
/// of them then spares the compiler what it does not find.
#[inline(always)]
fn in_one_register<S: Simd>() -> bool {
    S::F32_LANES == ABREAST && size_of::<S::m32s>() == size_of::<u16>()
}

const PLACES: [f32; ABREAST] =
    [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0];

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

/// A number above `2^t`, for `t < 127`, by at most 6.4 %; for `t < −126` it is that of −126.
#[inline(always)]
pub(super) fn power_above(t: f32) -> f32 {
    chord(t + ROUNDED)
}

/// What [`chord`] may lack by the rounding of its argument.
pub(super) const ROUNDED: f32 = 1e-3;

/// The chord of the powers `2^t` between integers, up to [`ROUNDED`] in `t`: the bits of a float
/// grow along it, which lies above the power. For `t < −126` it is that of −126.
#[inline(always)]
pub(super) fn chord(t: f32) -> f32 {
    // The sum, between 512 and 1024, has 14 bits after the point; the shift drops its own exponent
    // and makes what is above 512 the new one, and the mantissa.
    let fixed = greater(t, -126.0) + (127.0 + 512.0);
    f32::from_bits(fixed.to_bits() << 9)
}

/// [`power_above`] is no more than so many times `2^t`.
pub(super) const LOOSEST: f64 = 1.064;

/// `2^t` for `t < 127`, up to 3·10⁻⁷ of it; 0 for `t < −126`.
#[inline(always)]
pub(super) fn power(t: f32) -> f32 {
    /// Added to a number, it leaves the nearest integer in the last bits.
    const ROUNDING: f32 = 12_582_912.0;
    let within = greater(t, -126.0);
    let whole = within + ROUNDING;
    let rest = within - (whole - ROUNDING);
    let power = 1.340_043_3e-3_f32
        .mul_add(rest, 9.676_037e-3)
        .mul_add(rest, 5.550_327e-2)
        .mul_add(rest, 2.402_210_7e-1)
        .mul_add(rest, std::f32::consts::LN_2)
        .mul_add(rest, 1.0);
    let exponent = (whole.to_bits() << 23).wrapping_add(1.0_f32.to_bits());
    if t < -126.0 { 0.0 } else { power * f32::from_bits(exponent) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn power_above_is_a_close_bound() {
        for k in 0..1_250_000 {
            let t = -1e-4 * k as f32;
            let (power, above) = (f64::from(t).exp2(), f64::from(power_above(t)));
            assert!(power <= above && above <= LOOSEST * power, "{t}: {power} {above}");
        }
    }

    #[test]
    fn power_is_the_power() {
        for k in 0..1_330_000 {
            let t = 7.0 - 1e-4 * k as f32;
            let (exact, power) = (f64::from(t).exp2(), f64::from(power(t)));
            if t < -126.0 {
                assert_eq!(power, 0.0);
            } else {
                assert!((power / exact - 1.0).abs() < 3e-7, "{t}: {power} {exact}");
            }
        }
    }

    struct Sums(Abreast, f32);

    impl pulp::WithSimd for Sums {
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
        for (other, first) in [(-1.0, 0), (0.0, 1), (2.9, 2), (3.0, 3), (119.0, 15), (120.0, 16)] {
            let wide = crate::lanes::dispatch(Sums(numbers, other));
            let narrow = pulp::WithSimd::with_simd(Sums(numbers, other), pulp::Scalar::new());
            assert_eq!(wide, narrow);
            assert!((0..ABREAST).all(|k| wide.0[k] == (k * (k + 1) / 2) as f32));
            assert_eq!(wide.1, first);
        }
        // Each instruction set rounds alike.
        let numbers = Abreast::of(|k| (0.7 * k as f32).sin().exp());
        let wide = crate::lanes::dispatch(Sums(numbers, 0.0));
        assert_eq!(wide, pulp::WithSimd::with_simd(Sums(numbers, 0.0), pulp::Scalar::new()));
    }
}
