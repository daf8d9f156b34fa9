//! Winds of several members side by side, on common regular knots, with the integrals that a step
//! of all of them needs: equations.md (21), summed from knot to knot.

use pulp::{Simd, WithSimd};
use smallvec::SmallVec;

use super::path::{WindPath, require_cover};
use super::{Mark, MemberWinds, Sampling};
use crate::error::{DriftError, finite, positive, product, room};
use crate::field::Vec2;
use crate::lanes::{LaneVec2, Lanes, WIDTH, dispatch, lane, prefetch, set_lane};

/// The winds of a group of members at one knot.
pub(crate) trait Knot: Copy + Send + Sync {
    /// Calm.
    const CALM: Self;
    /// All of them.
    fn lanes(&self) -> LaneVec2;
    /// Sets one of them.
    fn set(&mut self, place: usize, wind: Vec2);
}

impl Knot for LaneVec2 {
    const CALM: Self = [Lanes::ZERO; 2];

    #[inline(always)]
    fn lanes(&self) -> LaneVec2 {
        *self
    }

    fn set(&mut self, place: usize, wind: Vec2) {
        set_lane(self, place, wind);
    }
}

/// The same in single precision: half as much memory to go through.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(crate) struct Single([[f32; WIDTH]; 2]);

impl Knot for Single {
    const CALM: Self = Self([[0.0; WIDTH]; 2]);

    #[inline(always)]
    fn lanes(&self) -> LaneVec2 {
        let mut lanes = [Lanes::ZERO; 2];
        for (lanes, winds) in lanes.iter_mut().zip(&self.0) {
            for (lane, wind) in lanes.0.iter_mut().zip(winds) {
                *lane = f64::from(*wind);
            }
        }
        lanes
    }

    fn set(&mut self, place: usize, wind: Vec2) {
        (self.0[0][place], self.0[1][place]) = (wind.x as f32, wind.y as f32);
    }
}

/// Winds of an ensemble in memory, on common regular knots, [`WIDTH`] members to a block.
#[derive(Debug, Clone)]
pub struct WindPaths {
    start: f64,
    spacing: f64,
    knots: usize,
    members: usize,
    blocks: Blocks,
}

/// Block by block, knot by knot.
#[derive(Debug, Clone)]
enum Blocks {
    Double(Vec<LaneVec2>),
    Single(Vec<Single>),
}

impl WindPaths {
    /// `velocity(member, knot)` at `start + knot·spacing`.
    pub fn new(
        start: f64,
        spacing: f64,
        shape: [usize; 2],
        velocity: impl Fn(usize, usize) -> Vec2,
    ) -> Result<Self, DriftError> {
        Self::of(start, spacing, shape, || Ok(Blocks::Double(blocks(shape, velocity)?)))
    }

    /// The same, kept in single precision: seven digits in half the memory.
    pub fn single(
        start: f64,
        spacing: f64,
        shape: [usize; 2],
        velocity: impl Fn(usize, usize) -> Vec2,
    ) -> Result<Self, DriftError> {
        Self::of(start, spacing, shape, || Ok(Blocks::Single(blocks(shape, velocity)?)))
    }

    fn of(
        start: f64,
        spacing: f64,
        [members, knots]: [usize; 2],
        blocks: impl FnOnce() -> Result<Blocks, DriftError>,
    ) -> Result<Self, DriftError> {
        positive("wind paths' spacing", spacing)?;
        finite("wind paths' start", &[start, start + knots as f64 * spacing])?;
        if members == 0 || knots < 2 {
            return Err(DriftError::invalid(
                "wind paths",
                format!("{members} members, {knots} knots"),
                "they need at least 1 member and 2 knots",
            ));
        }
        Ok(Self { start, spacing, knots, members, blocks: blocks()? })
    }

    /// Number of members.
    pub fn members(&self) -> usize {
        self.members
    }

    /// Time of the last knot.
    pub fn end(&self) -> f64 {
        self.start + (self.knots - 1) as f64 * self.spacing
    }

    /// Fails unless the paths cover `[start, end]`, up to rounding.
    pub fn require(&self, start: f64, end: f64) -> Result<(), DriftError> {
        require_cover((self.start, self.end()), (start, end))
    }

    /// Wind of one member at a knot.
    fn knot(&self, member: usize, knot: usize) -> Vec2 {
        let (at, place) = (member / WIDTH * self.knots + knot, member % WIDTH);
        match &self.blocks {
            Blocks::Double(blocks) => lane(&blocks[at], place),
            Blocks::Single(blocks) => lane(&blocks[at].lanes(), place),
        }
    }

    /// Wind of one member at time `t`; the end intervals are continued.
    pub fn velocity(&self, member: usize, t: f64) -> Vec2 {
        let place = (t - self.start) / self.spacing;
        let knot = (place.max(0.0) as usize).min(self.knots - 2);
        let [here, next] = [knot, knot + 1].map(|knot| self.knot(member, knot));
        here.lerp(&next, place - knot as f64)
    }

    /// The path of one member.
    pub fn path(&self, member: usize) -> Result<WindPath, DriftError> {
        if member >= self.members {
            return Err(DriftError::invalid("member", member, "it has no wind path"));
        }
        let times = (0..self.knots).map(|k| self.start + k as f64 * self.spacing).collect();
        WindPath::new(times, (0..self.knots).map(|knot| self.knot(member, knot)).collect())
    }
}

fn blocks<K: Knot>(
    [members, knots]: [usize; 2],
    velocity: impl Fn(usize, usize) -> Vec2,
) -> Result<Vec<K>, DriftError> {
    let count = product("wind paths", &[members.div_ceil(WIDTH), knots])?;
    let mut blocks = room("wind paths", count)?;
    blocks.resize(count, K::CALM);
    for (group, block) in blocks.chunks_exact_mut(knots).enumerate() {
        for (knot, values) in block.iter_mut().enumerate() {
            for member in group * WIDTH..members.min((group + 1) * WIDTH) {
                let wind = velocity(member, knot);
                finite("wind paths' velocity", wind.as_slice())?;
                values.set(member % WIDTH, wind);
            }
        }
    }
    Ok(blocks)
}

/// Where the wind of a group of members comes from.
enum Source<'a> {
    Double(&'a [LaneVec2]),
    Single(&'a [Single]),
    Drawn {
        winds: Box<MemberWinds<'a>>,
        sampling: Sampling,
        velocity: Vec<LaneVec2>,
        /// Excess of each interval's mean over the chord's; empty for fine sampling.
        excess: Vec<LaneVec2>,
        /// One member's knots within one synoptic step.
        knots: Vec<Vec2>,
    },
}

/// The wind of a group of members, walked through in the order of time.
pub struct LaneWind<'a> {
    source: Source<'a>,
    spacing: f64,
    /// Time of the first knot, and the number of those no longer held.
    start: f64,
    dropped: usize,
    /// The knot up to which the integrals have been summed, among those held.
    base: usize,
    sums: Sums,
}

/// One member's wind at a step of all, to go on from.
#[derive(Debug, Clone)]
pub(crate) struct LaneMark {
    /// The knot up to which the integrals have been summed, counted from the first.
    knot: usize,
    sums: [Vec2; 2],
    /// Wind and excess at the knots drawn from there on.
    velocity: SmallVec<[Vec2; 2]>,
    excess: SmallVec<[Vec2; 1]>,
    member: Mark,
    /// Synoptic step up to which it is drawn.
    known: usize,
}

impl LaneMark {
    /// Synoptic step up to which the wind is drawn.
    pub(crate) fn known(&self) -> usize {
        self.known
    }

    /// The member's wind, to be drawn on.
    pub(crate) fn member(&self) -> &Mark {
        &self.member
    }
}

/// What a knot `n` has come to: `∫W + W_n/2` and `∬W − W_n/6` from the release on, in units of the
/// spacing and of its square. From knot to knot, each grows by a sum: the second by the first, the
/// first by the next wind.
type Sums = [LaneVec2; 2];

/// The sums where the integrals are known.
fn sums_of(integrals: [LaneVec2; 2], wind: &LaneVec2) -> Sums {
    let [mut single, mut double] = integrals;
    for k in 0..2 {
        single[k] = wind[k].mul_add(0.5, single[k]);
        double[k] = wind[k].mul_add(-1.0 / 6.0, double[k]);
    }
    [single, double]
}

/// Knots are asked for so far ahead.
const AHEAD: usize = 16;
/// Knots that have been passed are dropped when there are so many of them.
const KEPT_KNOTS: usize = 16;

impl<'a> LaneWind<'a> {
    /// Members `WIDTH·group` and following, in memory.
    pub fn in_memory(paths: &'a WindPaths, group: usize) -> Self {
        let (spacing, start) = (paths.spacing, paths.start);
        let block = group * paths.knots..(group + 1) * paths.knots;
        let source = match &paths.blocks {
            Blocks::Double(blocks) => Source::Double(&blocks[block]),
            Blocks::Single(blocks) => Source::Single(&blocks[block]),
        };
        let zero = [[Lanes::ZERO; 2]; 2];
        let mut wind = Self { source, spacing, start, dropped: 0, base: 0, sums: zero };
        let u;
        (wind.base, u) = wind.place(0.0);
        // From that knot to the release, which becomes the origin of the integrals.
        let first = wind.knot(wind.base);
        wind.sums = sums_of(zero, &first);
        let [double, single, _] = wind.seen(0.0, 1.0, zero[0]);
        let (mut before, mut before_that) = (zero[0], zero[0]);
        for k in 0..2 {
            before[k] = single[k] * (-1.0 / spacing);
            before_that[k] = (single[k] * (u / spacing)) - double[k] * (1.0 / (spacing * spacing));
        }
        wind.sums = sums_of([before, before_that], &first);
        wind
    }

    /// Winds to be drawn; those not at their beginning are to join later.
    pub(crate) fn drawn(mut winds: MemberWinds<'a>, sampling: Sampling) -> Self {
        let mut knots = Vec::new();
        for drawn in 0..winds.generator().lead_in() {
            let due = winds.drawn(drawn);
            winds.draw(&due);
            if sampling == Sampling::Fine {
                for at in due {
                    knots.clear();
                    winds.fill(at, &mut knots);
                }
            }
        }
        let velocity = vec![winds.velocity()];
        let spacing = winds.generator().knots(sampling).0;
        let sums = sums_of([[Lanes::ZERO; 2]; 2], &velocity[0]);
        let winds = Box::new(winds);
        let source = Source::Drawn { winds, sampling, velocity, excess: Vec::new(), knots };
        Self { source, spacing, start: 0.0, dropped: 0, base: 0, sums }
    }

    /// What one member's wind has come to; none of winds that are not drawn.
    pub(crate) fn mark(&self, place: usize) -> Option<LaneMark> {
        let Source::Drawn { winds, velocity, excess, .. } = &self.source else {
            return None;
        };
        let member = winds.mark(place)?;
        Some(LaneMark {
            knot: self.dropped + self.base,
            sums: self.sums.map(|sum| lane(&sum, place)),
            velocity: velocity.iter().skip(self.base).map(|w| lane(w, place)).collect(),
            excess: excess.iter().skip(self.base).map(|w| lane(w, place)).collect(),
            known: member.drawn.saturating_sub(winds.generator().lead_in()),
            member,
        })
    }

    /// `onto + factor·∬W` and `∫W` at time `t`, which all have come to, and the last wind drawn.
    pub(crate) fn seen(&self, t: f64, factor: f64, onto: LaneVec2) -> [LaneVec2; 3] {
        match self.view() {
            View::Double(wind) => dispatch(SeenKernel { wind, t, factor, onto }),
            View::Single(wind) => dispatch(SeenKernel { wind, t, factor, onto }),
        }
    }

    /// Begins where a member is that is to join, and not at the release.
    pub(crate) fn begin_at(&mut self, mark: &LaneMark) {
        if let Source::Drawn { velocity, excess, .. } = &mut self.source {
            (self.dropped, self.base) = (mark.knot, 0);
            velocity.resize(mark.velocity.len(), [Lanes::ZERO; 2]);
            excess.resize(mark.excess.len(), [Lanes::ZERO; 2]);
        }
    }

    /// Lets a member join where it was marked; whether the others have come to the same knots.
    pub(crate) fn join(&mut self, place: usize, mark: &LaneMark) -> bool {
        let Source::Drawn { velocity, excess, .. } = &mut self.source else {
            return false;
        };
        let held = |knots: &[LaneVec2]| knots.len().saturating_sub(self.base);
        if self.dropped + self.base != mark.knot
            || held(velocity) != mark.velocity.len()
            || held(excess) != mark.excess.len()
        {
            return false;
        }
        for (knots, of) in [(velocity, &mark.velocity[..]), (excess, &mark.excess[..])] {
            for (knot, value) in knots.iter_mut().skip(self.base).zip(of) {
                set_lane(knot, place, *value);
            }
        }
        for (sum, value) in self.sums.iter_mut().zip(mark.sums) {
            set_lane(sum, place, value);
        }
        true
    }

    /// Sees to it that the wind is known up to time `t`, for the members `wanted`.
    pub fn draw_until(&mut self, t: f64, wanted: &[bool; WIDTH]) {
        let needed = ((t - self.start) / self.spacing - 1e-9).ceil() as usize;
        let mut needed = needed.saturating_sub(self.dropped).max(1);
        let Source::Drawn { winds, sampling, velocity, excess, knots } = &mut self.source else {
            return;
        };
        let per_step = winds.generator().knots(*sampling).1;
        let wanted: SmallVec<[usize; WIDTH]> = (0..WIDTH).filter(|at| wanted[*at]).collect();
        while velocity.len() <= needed {
            if self.base > KEPT_KNOTS {
                velocity.drain(..self.base);
                excess.drain(..self.base.min(excess.len()));
                needed -= self.base;
                self.dropped += self.base;
                self.base = 0;
                continue;
            }
            let now = winds.velocity();
            let integral = winds.draw(&wanted);
            let next = winds.velocity();
            if *sampling == Sampling::Coarse {
                excess.push(
                    [0, 1].map(|k| integral[k] * (1.0 / self.spacing) - (now[k] + next[k]) * 0.5),
                );
            } else {
                let first = velocity.len();
                velocity.resize(first + per_step - 1, now);
                for at in &wanted {
                    knots.clear();
                    winds.fill(*at, knots);
                    for (knot, value) in velocity[first..].iter_mut().zip(&*knots) {
                        set_lane(knot, *at, *value);
                    }
                }
            }
            velocity.push(next);
        }
    }

    /// Knot before `t`, among those held, and the place in its interval.
    fn place(&self, t: f64) -> (usize, f64) {
        let place = (t - self.start) / self.spacing;
        let knot = (place as usize).saturating_sub(self.dropped).min(self.held() - 2);
        (knot, place - (self.dropped + knot) as f64)
    }

    /// Number of knots held.
    fn held(&self) -> usize {
        match &self.source {
            Source::Double(knots) => knots.len(),
            Source::Single(knots) => knots.len(),
            Source::Drawn { velocity, .. } => velocity.len(),
        }
    }

    /// The winds at one of them.
    fn knot(&self, knot: usize) -> LaneVec2 {
        match self.view() {
            View::Double(view) => view.velocity[knot],
            View::Single(view) => view.velocity[knot].lanes(),
        }
    }

    /// What a kernel needs of the wind over one step.
    pub(crate) fn view(&self) -> View<'_> {
        match &self.source {
            Source::Double(knots) => View::Double(self.view_of(knots, &[])),
            Source::Single(knots) => View::Single(self.view_of(knots, &[])),
            Source::Drawn { velocity, excess, .. } => View::Double(self.view_of(velocity, excess)),
        }
    }

    fn view_of<'b, K>(&'b self, velocity: &'b [K], excess: &'b [LaneVec2]) -> WindView<'b, K> {
        WindView {
            drawn: matches!(self.source, Source::Drawn { .. }),
            velocity,
            excess,
            spacing: self.spacing,
            start: self.start,
            dropped: self.dropped,
            base: self.base,
            sums: &self.sums,
        }
    }

    /// Goes on to the knot that a step came to.
    pub(crate) fn go_on(&mut self, (base, sums): (usize, Sums)) {
        self.base = base;
        self.sums = sums;
    }

    /// One member's path over `[t0, t1]`, its integrals counted from the release; to be asked
    /// before the wind has gone on.
    pub(crate) fn stretch(&self, t1: f64, place: usize) -> WindPath {
        let last = (self.place(t1).0 + 1).min(self.held() - 1);
        let excess = match &self.source {
            Source::Drawn { excess, .. } => excess.get(self.base..last).unwrap_or_default(),
            _ => &[],
        };
        let [single, double] = self.sums.map(|sum| lane(&sum, place));
        let first = lane(&self.knot(self.base), place);
        let (single, double) = (single - first / 2.0, double + first / 6.0);
        WindPath::stretch(
            self.start + (self.dropped + self.base) as f64 * self.spacing,
            self.spacing,
            (self.base..=last).map(|knot| lane(&self.knot(knot), place)).collect(),
            excess.iter().map(|w| lane(w, place)).collect(),
            [single * self.spacing, double * (self.spacing * self.spacing)],
        )
    }
}

struct SeenKernel<'a, K> {
    wind: WindView<'a, K>,
    t: f64,
    factor: f64,
    onto: LaneVec2,
}

impl<K: Knot> WithSimd for SeenKernel<'_, K> {
    type Output = [LaneVec2; 3];
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        let Self { wind, t, factor, onto } = self;
        let mut walk = wind.walk();
        let single = walk.integral(t);
        let last = wind.velocity[wind.velocity.len() - 1].lanes();
        [walk.double_integral(t, factor, onto), single, last]
    }
}

/// The knots around one step, in either precision.
pub(crate) enum View<'a> {
    Double(WindView<'a, LaneVec2>),
    Single(WindView<'a, Single>),
}

/// The knots around one step, and the sums up to the first of them.
#[derive(Clone, Copy)]
pub(crate) struct WindView<'a, K> {
    /// Whether they are drawn, and not in memory.
    pub(crate) drawn: bool,
    velocity: &'a [K],
    excess: &'a [LaneVec2],
    spacing: f64,
    start: f64,
    dropped: usize,
    base: usize,
    sums: &'a Sums,
}

/// A walk along the knots: two additions a knot.
pub(crate) struct Walk<'a, K> {
    view: WindView<'a, K>,
    knot: usize,
    sums: Sums,
}

impl<'a, K: Knot> WindView<'a, K> {
    #[inline(always)]
    pub(crate) fn walk(self) -> Walk<'a, K> {
        Walk { view: self, knot: self.base, sums: *self.sums }
    }

    /// Upper bound of the wind's speed from the base to time `t`.
    #[inline(always)]
    pub(crate) fn max_speed(&self, t: f64) -> Lanes {
        let last = ((t - self.start) / self.spacing).ceil() as usize;
        let last = last.saturating_sub(self.dropped).min(self.velocity.len() - 1);
        let mut speed = Lanes::ZERO;
        for w in &self.velocity[self.base..=last] {
            let w = w.lanes();
            speed = speed.max(w[0].abs() + w[1].abs());
        }
        let mut excess = Lanes::ZERO;
        for e in self.excess.get(self.base..last).unwrap_or(&[]) {
            excess = excess.max(e[0].abs() + e[1].abs());
        }
        speed + excess * 1.5
    }
}

impl<K: Knot> Walk<'_, K> {
    /// Goes on to the knot before `t`, which is not before the last one asked for, and gives the
    /// place in its interval.
    #[inline(always)]
    fn go_to(&mut self, t: f64) -> f64 {
        let view = &self.view;
        let place = (t - view.start) / view.spacing;
        let target = (place as usize).saturating_sub(view.dropped).min(view.velocity.len() - 2);
        let [single, double] = &mut self.sums;
        while self.knot < target {
            let next = view.velocity[self.knot + 1].lanes();
            if let Some(ahead) = view.velocity.get(self.knot + AHEAD) {
                prefetch(ahead);
            }
            for k in 0..2 {
                double[k] += single[k];
                single[k] += next[k];
            }
            if let Some(e) = view.excess.get(self.knot) {
                for k in 0..2 {
                    double[k] = e[k].mul_add(0.5, double[k]);
                    single[k] += e[k];
                }
            }
            self.knot += 1;
        }
        place - (view.dropped + self.knot) as f64
    }

    /// `onto + factor·∬W` from the release to time `t`, not before the last one asked for.
    #[inline(always)]
    pub(crate) fn double_integral(&mut self, t: f64, factor: f64, onto: LaneVec2) -> LaneVec2 {
        let u = self.go_to(t);
        let view = &self.view;
        let last = view.velocity[self.knot].lanes();
        let next = view.velocity[self.knot + 1].lanes();
        let factor = factor * view.spacing * view.spacing;
        let of_last = factor * (1.0 - u).powi(3) / 6.0;
        let of_next = factor * u * u * u / 6.0;
        let [single, double] = &self.sums;
        let mut sum = onto;
        for k in 0..2 {
            sum[k] = next[k].mul_add(of_next, last[k].mul_add(of_last, sum[k]));
            sum[k] = double[k].mul_add(factor, single[k].mul_add(factor * u, sum[k]));
        }
        if let Some(e) = view.excess.get(self.knot) {
            let of_excess = factor * u * u * u * (1.0 - 0.5 * u);
            for k in 0..2 {
                sum[k] = e[k].mul_add(of_excess, sum[k]);
            }
        }
        sum
    }

    /// `∫W` from the release to time `t`, not before the last one asked for.
    #[inline(always)]
    pub(crate) fn integral(&mut self, t: f64) -> LaneVec2 {
        let u = self.go_to(t);
        let view = &self.view;
        let last = view.velocity[self.knot].lanes();
        let next = view.velocity[self.knot + 1].lanes();
        let mut sum = self.sums[0];
        for k in 0..2 {
            sum[k] =
                next[k].mul_add(0.5 * u * u, last[k].mul_add(-0.5 * (1.0 - u).powi(2), sum[k]));
        }
        if let Some(e) = view.excess.get(self.knot) {
            for k in 0..2 {
                sum[k] = e[k].mul_add(u * u * (3.0 - 2.0 * u), sum[k]);
            }
        }
        [sum[0] * view.spacing, sum[1] * view.spacing]
    }

    /// The present knot, and its sums.
    #[inline(always)]
    pub(crate) fn end(&self) -> (usize, Sums) {
        (self.knot, self.sums)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::super::bootstrap::{Bootstrap, Catalogue};
    use super::super::small_scale::SmallScale;
    use super::super::{Lineage, WindGenerator};
    use super::*;

    const MEMBERS: usize = 20;

    /// Winds of a wavy kind on knots that begin before the release, but not at a whole knot.
    fn wavy(member: usize, knot: usize) -> Vec2 {
        let phase = (3 * member + 2 * knot) as f64;
        Vec2::new(phase.sin(), 2.0 + phase.cos())
    }

    fn generator() -> Result<WindGenerator, DriftError> {
        // One row: white noise, and a small scale that decays within a step.
        let bootstrap = Bootstrap::new(Catalogue {
            order: 1,
            states: vec![0.0, 0.0],
            whitening: vec![1.0, 0.0, 0.0, 1.0],
            target: vec![0.0, 0.0],
            predictor: vec![0.0; 6],
            noise: vec![1.0, 0.0, 0.0, 1.0],
            row: vec![1],
            phase: vec![0],
            start: vec![true],
            cycle: vec![0.3, -0.7],
            bandwidth: 0.5,
        })?;
        let small_scale = SmallScale::new(0.8, 0.1, 0.25, 3)?;
        WindGenerator::new(Arc::new(bootstrap), small_scale, 0.25, 1.0, 2, None)
    }

    /// Walks with a wind to time 2, a few steps at once, and asks on the way for everything that a
    /// walk, a stretch and a bound give; `path` is the wind of the lane.
    fn assert_is(mut wind: LaneWind, place: usize, path: &WindPath) {
        let (single0, double0) = path.integrals(0.0);
        let wanted = std::array::from_fn(|k| k == place);
        let near = |a: Vec2, b: Vec2| assert!((a - b).norm() < 1e-12, "{a} {b}");
        let steps = 32;
        let time = |n: usize| 2.0 * n as f64 / f64::from(steps);
        for n in (0..steps as usize).step_by(4) {
            let end = time(n + 4);
            wind.draw_until(end, &wanted);
            let walked = match wind.view() {
                View::Double(view) => assert_walks(view, [n, n + 4].map(time), place, path),
                View::Single(view) => assert_walks(view, [n, n + 4].map(time), place, path),
            };
            for t in (n..=n + 4).map(time) {
                let (single, double) = path.integrals(t);
                let stretch = wind.stretch(end, place);
                near(stretch.velocity(t), path.velocity(t));
                near(stretch.integral(t), single - single0);
                near(stretch.double_integral(t), double - double0 - single0 * t);
            }
            // No knot of the stretch is beyond the interval of its end.
            let first = wind.start + (wind.dropped + wind.base) as f64 * wind.spacing;
            let knots = wind.stretch(end, place).times().len() as f64;
            assert!(first + (knots - 2.0) * wind.spacing <= end + 1e-12);
            wind.go_on(walked);
        }
    }

    /// Walks from `start` to `end`; where it comes to.
    fn assert_walks<K: Knot>(
        view: WindView<K>,
        [start, end]: [f64; 2],
        place: usize,
        path: &WindPath,
    ) -> (usize, Sums) {
        let (single0, double0) = path.integrals(0.0);
        let near = |a: Vec2, b: Vec2| assert!((a - b).norm() < 1e-12, "{a} {b}");
        let mut walk = view.walk();
        for k in 0..=4 {
            let t = start + (end - start) * f64::from(k) / 4.0;
            let (single, double) = path.integrals(t);
            near(lane(&walk.integral(t), place), single - single0);
            let from = [Lanes::splat(0.3), Lanes::splat(-0.2)];
            let moved = lane(&walk.double_integral(t, 1.7, from), place);
            let double = double - double0 - single0 * t;
            near(moved, double * 1.7 + Vec2::new(0.3, -0.2));
        }
        let first = view.start + (view.dropped + view.base) as f64 * view.spacing;
        let bound = view.max_speed(end).0[place];
        let known: f64 = (0..40)
            .map(|k| path.velocity(first + (end - first) * f64::from(k) / 39.0).norm())
            .fold(0.0, f64::max);
        assert!(bound >= known, "{bound} {known}");
        walk.end()
    }

    #[test]
    fn a_walk_is_the_path() -> Result<(), DriftError> {
        let double = WindPaths::new(-0.34, 0.25, [MEMBERS, 12], wavy)?;
        let single = WindPaths::single(-0.34, 0.25, [MEMBERS, 12], wavy)?;
        for (paths, rounding) in [(double, 0.0), (single, 2e-7)] {
            for member in [0, 5, 15, 16, 19] {
                let path = paths.path(member)?;
                assert_eq!(
                    (path.start(), path.end(), path.knots().len()),
                    (-0.34, paths.end(), 12)
                );
                for (knot, t) in path.times().iter().enumerate() {
                    assert!((path.knots()[knot] - wavy(member, knot)).norm() <= rounding);
                    for t in [t - 0.2, *t, t + 0.1] {
                        assert!((paths.velocity(member, t) - path.velocity(t)).norm() < 1e-12);
                    }
                }
                let (group, place) = (member / WIDTH, member % WIDTH);
                assert_is(LaneWind::in_memory(&paths, group), place, &path);
            }
        }
        let generator = generator()?;
        for sampling in [Sampling::Coarse, Sampling::Fine] {
            for place in [0, 3, 7] {
                let path = generator.path(8, 40 + place as u64, 2.0, sampling)?;
                let mut winds = generator.winds(8);
                for member in 40..48 {
                    winds.begin(member)?;
                }
                assert_is(LaneWind::drawn(winds, sampling), place, &path);
            }
        }
        Ok(())
    }

    /// Side by side or alone, a branch has its parent's wind up to the step where it begins, and the
    /// wind of nobody else after it.
    #[test]
    fn a_branch_keeps_its_past() -> Result<(), DriftError> {
        let generator = generator()?;
        let parent = Lineage { member: 40, branches: vec![(2, 7)] };
        let child = Lineage { member: 40, branches: vec![(2, 7), (5, 8), (5, 9)] };
        for sampling in [Sampling::Coarse, Sampling::Fine] {
            let path = |lineage: Lineage| generator.path(8, lineage, 2.0, sampling);
            let [plain, parents, childs, other] =
                [path(40.into())?, path(parent.clone())?, path(child.clone())?, path(9.into())?];
            let shared = |a: &WindPath, b: &WindPath| {
                let same = a.knots().iter().zip(b.knots()).take_while(|(a, b)| a == b).count();
                same.checked_sub(1).map(|last| a.times()[last])
            };
            assert_eq!(shared(&plain, &parents), Some(0.5));
            assert_eq!(shared(&parents, &childs), Some(1.25));
            assert_eq!(shared(&childs, &other), None);
            let mut winds = generator.winds(8);
            for lineage in [&parent, &child] {
                winds.begin(lineage.clone())?;
            }
            assert_is(LaneWind::drawn(winds, sampling), 1, &childs);
        }
        Ok(())
    }

    /// Of steady and of growing winds the bound is known.
    #[test]
    fn max_speed_is_that_of_the_knots() -> Result<(), DriftError> {
        let paths = WindPaths::new(0.0, 0.5, [1, 9], |_, knot| Vec2::new(-(knot as f64), 2.0))?;
        let wind = LaneWind::in_memory(&paths, 0);
        for (t, knot) in [(0.1, 1.0), (0.5, 1.0), (0.6, 2.0), (3.9, 8.0), (4.0, 8.0)] {
            let View::Double(view) = wind.view() else { unreachable!("the winds are in double") };
            assert_eq!(view.max_speed(t).0[0], knot + 2.0);
        }
        let knots = vec![[Lanes::splat(1.0), Lanes::splat(-2.0)]; 4];
        let excess = [0.1, -0.2, 0.5].map(|e| [Lanes::splat(e), Lanes::splat(e)]);
        let sums = [[Lanes::ZERO; 2]; 2];
        let view = WindView {
            drawn: true,
            velocity: &knots,
            excess: &excess,
            spacing: 0.5,
            start: 1.0,
            dropped: 0,
            base: 0,
            sums: &sums,
        };
        for (t, excess) in [(1.4, 0.2), (1.6, 0.4), (2.4, 1.0)] {
            assert!((view.max_speed(t).0[0] - 3.0 - 1.5 * excess).abs() < 1e-12);
        }
        Ok(())
    }

    /// Paths must cover the run up to rounding, and be paths.
    #[test]
    fn paths_cover_the_run() -> Result<(), DriftError> {
        let paths = WindPaths::new(-1.0, 500.0, [1, 3], |_, _| Vec2::zeros())?;
        assert_eq!((paths.members(), paths.end()), (1, 999.0));
        for (start, end, covered) in [
            (-1.0, 999.0, true),
            (0.0, 500.0, true),
            (-1.0 - 5e-7, 999.0 + 5e-7, true),
            (-1.0 - 5e-6, 999.0, false),
            (-1.0, 999.0 + 5e-6, false),
        ] {
            assert_eq!(paths.require(start, end).is_ok(), covered, "{start} {end}");
        }
        assert!(paths.path(1).is_err());
        for (spacing, shape) in [(0.0, [1, 3]), (1.0, [0, 3]), (1.0, [1, 1])] {
            assert!(WindPaths::new(0.0, spacing, shape, |_, _| Vec2::zeros()).is_err());
        }
        Ok(())
    }
}
