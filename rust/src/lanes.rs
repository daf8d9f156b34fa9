//! Numbers of several members side by side, so that one instruction serves many of them.
//!
//! Plain arrays and loops: the compiler turns them into vector instructions, and [`dispatch`]
//! picks the widest set of the processor at run time. Only additions, multiplications, fused
//! multiply-adds and comparisons are used, each rounded once, so that every instruction set gives
//! the same bits; a processor that cannot fuse does it slowly.

use std::ops::{Add, AddAssign, Mul, Sub};

use pulp::WithSimd;

use crate::field::Vec2;

/// Members followed side by side.
pub const WIDTH: usize = 16;

/// One number of each member.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(64))]
pub struct Lanes(pub [f64; WIDTH]);

/// A plane vector of each member.
pub type LaneVec2 = [Lanes; 2];

impl Lanes {
    /// Zero in every lane.
    pub const ZERO: Self = Self([0.0; WIDTH]);

    /// The same number in every lane.
    #[inline(always)]
    pub fn splat(value: f64) -> Self {
        Self([value; WIDTH])
    }

    #[inline(always)]
    fn zip(mut self, other: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        for (a, b) in self.0.iter_mut().zip(other.0) {
            *a = f(*a, b);
        }
        self
    }

    /// `self·factor + other`, rounded once.
    #[inline(always)]
    pub fn mul_add(self, factor: f64, other: Self) -> Self {
        self.zip(other, |a, b| a.mul_add(factor, b))
    }

    /// The greater of two numbers, lane by lane; `other` where `self` is not a number.
    #[inline(always)]
    pub fn max(self, other: Self) -> Self {
        self.zip(other, |a, b| if a > b { a } else { b })
    }

    /// Magnitude.
    #[inline(always)]
    pub fn abs(self) -> Self {
        Self(self.0.map(f64::abs))
    }
}

impl Add for Lanes {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
}

impl AddAssign for Lanes {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for Lanes {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
}

impl Mul<f64> for Lanes {
    type Output = Self;
    #[inline(always)]
    fn mul(mut self, factor: f64) -> Self {
        for a in &mut self.0 {
            *a *= factor;
        }
        self
    }
}

/// The vector of one lane.
#[inline(always)]
pub fn lane(of: &LaneVec2, lane: usize) -> Vec2 {
    Vec2::new(of[0].0[lane], of[1].0[lane])
}

/// Puts a vector into one lane.
#[inline(always)]
pub fn set_lane(of: &mut LaneVec2, lane: usize, value: Vec2) {
    of[0].0[lane] = value.x;
    of[1].0[lane] = value.y;
}

/// The same vector in every lane.
pub fn splat(value: Vec2) -> LaneVec2 {
    [Lanes::splat(value.x), Lanes::splat(value.y)]
}

/// Asks for memory that a kernel will need in a while, where processors can be asked.
#[inline(always)]
pub fn prefetch<T>(item: &T) {
    #[cfg(target_arch = "x86_64")]
    if let Some(sse) = pulp::core_arch::x86::Sse::try_new() {
        let start = std::ptr::from_ref(item).cast::<i8>();
        for line in (0..size_of::<T>()).step_by(64) {
            sse._mm_prefetch::<{ std::arch::x86_64::_MM_HINT_T0 }>(start.wrapping_add(line));
        }
    }
}

/// Runs a kernel, which is compiled once for each instruction set, with the widest instructions
/// that this processor has. Its method and all that it calls must be `inline(always)`.
#[inline]
pub fn dispatch<K: WithSimd>(kernel: K) -> K::Output {
    pulp::Arch::new().dispatch(kernel)
}

/// The same with at most 256 bits: where a kernel mostly waits, wider instructions only slow the
/// processor's clock, for all that comes after them, too.
#[inline]
pub fn dispatch_narrow<K: WithSimd>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if let Some(simd) = pulp::x86::V3::try_new() {
        return pulp::Simd::vectorize(simd, kernel);
    }
    dispatch(kernel)
}
