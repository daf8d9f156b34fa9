//! Wind paths for the members of an ensemble: a resampled synoptic part and a small-scale part.
//!
//! One (seed, member) is one wind, whatever model asks for it and however finely: the synoptic
//! states, the small scale at the synoptic steps and its fine path are three separate random
//! streams, each read in the order of time. A [`Lineage`] goes over to the streams of other members
//! on its way: what it shares with another up to there, and nothing after, is its past.

mod abreast;
pub mod bootstrap;
mod columns;
pub mod fields;
pub mod hand_over;
pub mod lanes;
pub mod path;
pub mod small_scale;
mod tree;

use std::iter::Peekable;
use std::sync::Arc;
use std::vec::IntoIter;

use nalgebra::Matrix2;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use smallvec::SmallVec;

use crate::error::{DriftError, positive, product, room};
use crate::field::Vec2;
use crate::lanes::{LaneVec2, Lanes, WIDTH, lane, set_lane};
use bootstrap::{Bootstrap, Chain, Chains, Scratch};
use hand_over::HandOver;
use path::WindPath;
use small_scale::SmallScale;

/// What a random stream is used for.
#[derive(Debug, Clone, Copy)]
enum Stream {
    Synoptic = 0,
    SmallScale = 1,
    FinePath = 2,
    Jibes = 3,
}

/// A century of tides has 70,000, and each a hundred knots.
const MOST_KNOTS: f64 = 2e7;

/// Streams of each member.
const STREAMS: u64 = 4;

/// Streams are numbered by four times the member.
pub(crate) const MOST_MEMBERS: u64 = 1 << 62;

/// Fails unless a member has streams of its own.
pub(crate) fn numbered(member: u64) -> Result<(), DriftError> {
    if member < MOST_MEMBERS {
        return Ok(());
    }
    Err(DriftError::invalid("member", member, "members are numbered to 2⁶²"))
}

/// Generator keyed by (seed, member, stream): no member's numbers depend on another's.
fn stream(seed: u64, member: u64, stream: Stream) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(STREAMS * member + stream as u64);
    rng
}

/// Whose random numbers a wind is drawn from: a member's at first, and from synoptic steps after the
/// release on those of others.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Lineage {
    /// Who begins.
    pub member: u64,
    /// From which step on, whose; the steps must not decrease.
    pub branches: Vec<(usize, u64)>,
}

impl From<u64> for Lineage {
    fn from(member: u64) -> Self {
        Self { member, branches: Vec::new() }
    }
}

/// Times at which a member's body jibes, up to `end`: a Poisson process.
pub(crate) fn jibes(seed: u64, member: u64, rate: f64, end: f64) -> Vec<f64> {
    let mut jibes = Vec::new();
    if rate <= 0.0 {
        return jibes;
    }
    let mut rng = stream(seed, member, Stream::Jibes);
    let mut t = 0.0;
    loop {
        t += -(1.0 - rng.random::<f64>()).ln() / rate;
        if t >= end {
            return jibes;
        }
        jibes.push(t);
    }
}

/// Wind of one member over the run, which may vary in space.
pub trait Wind: Sync {
    /// Wind at time `t`, position `x`; `OutsideDomain` beyond the data.
    fn at(&self, t: f64, x: Vec2) -> Result<Vec2, DriftError>;

    /// Its Jacobian in space, and the second derivatives of each component.
    fn derivatives(&self, t: f64, x: Vec2)
    -> Result<(Matrix2<f64>, [Matrix2<f64>; 2]), DriftError>;

    /// Times where it is not smooth.
    fn knots(&self) -> &[f64];

    /// Fails unless it covers `[start, end]`, up to rounding.
    fn require(&self, start: f64, end: f64) -> Result<(), DriftError>;
}

impl Wind for WindPath {
    fn at(&self, t: f64, _: Vec2) -> Result<Vec2, DriftError> {
        Ok(self.velocity(t))
    }

    fn derivatives(
        &self,
        _: f64,
        _: Vec2,
    ) -> Result<(Matrix2<f64>, [Matrix2<f64>; 2]), DriftError> {
        Ok((Matrix2::zeros(), [Matrix2::zeros(); 2]))
    }

    fn knots(&self) -> &[f64] {
        self.times()
    }

    fn require(&self, start: f64, end: f64) -> Result<(), DriftError> {
        path::require_cover((self.start(), self.end()), (start, end))
    }
}

impl<W: Wind> Wind for &W {
    fn at(&self, t: f64, x: Vec2) -> Result<Vec2, DriftError> {
        (**self).at(t, x)
    }

    fn derivatives(
        &self,
        t: f64,
        x: Vec2,
    ) -> Result<(Matrix2<f64>, [Matrix2<f64>; 2]), DriftError> {
        (**self).derivatives(t, x)
    }

    fn knots(&self) -> &[f64] {
        (**self).knots()
    }

    fn require(&self, start: f64, end: f64) -> Result<(), DriftError> {
        (**self).require(start, end)
    }
}

/// How finely a member's wind is sampled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sampling {
    /// At the synoptic steps, with the small scale's exact integrals between them.
    Coarse,
    /// At every small-scale knot.
    Fine,
}

/// Simulated synoptic winds of several members.
#[derive(Debug, Clone, Default)]
pub struct SynopticSample {
    /// Wind [m/s], members × steps.
    pub wind: Vec<Vec2>,
    /// Record row whose successor gave each value, if one did, members × steps.
    pub predecessor: Vec<Option<usize>>,
}

/// How synoptic winds begin.
#[derive(Debug, Clone, Default)]
pub struct Beginning {
    /// Phase of the mean cycle at the first step; any, if none is given.
    pub phase: Option<usize>,
    /// What the first steps are, if not drawn from the record.
    pub hand_over: Option<Arc<HandOver>>,
}

impl From<Option<usize>> for Beginning {
    fn from(phase: Option<usize>) -> Self {
        Self { phase, hand_over: None }
    }
}

/// The synoptic winds of some members side by side, each with its random stream.
#[derive(Debug, Clone)]
struct Synoptic {
    chains: Chains,
    rngs: Vec<ChaCha8Rng>,
    members: Vec<u64>,
    /// Steps that were handed over, and the error of the last, before it is scaled.
    handed: Vec<usize>,
    errors: Vec<Vec2>,
    scratch: Scratch,
}

impl Synoptic {
    /// Nobody's.
    fn new(bootstrap: &Bootstrap) -> Self {
        Self {
            chains: bootstrap.chains(),
            rngs: Vec::with_capacity(WIDTH),
            members: Vec::with_capacity(WIDTH),
            handed: Vec::with_capacity(WIDTH),
            errors: Vec::with_capacity(WIDTH),
            scratch: Scratch::default(),
        }
    }

    /// Puts a member beside the others, at its beginning.
    fn begin(
        &mut self,
        bootstrap: &Bootstrap,
        beginning: &Beginning,
        seed: u64,
        member: u64,
    ) -> Result<(), DriftError> {
        numbered(member)?;
        let mut rng = stream(seed, member, Stream::Synoptic);
        let at = self.members.len();
        let (mut handed, mut error) = (0, Vec2::zeros());
        if let Some(hand_over) = &beginning.hand_over {
            let order = bootstrap.catalogue().order;
            if hand_over.steps() < order {
                let accepted = format!("the bootstrap goes on from {order}");
                return Err(DriftError::invalid("forecast steps", hand_over.steps(), accepted));
            }
            let known = beginning.phase.filter(|phase| *phase < bootstrap.phases());
            let phase = known.ok_or_else(|| {
                let given = beginning.phase.map_or(String::from("none"), |phase| phase.to_string());
                DriftError::invalid(
                    "start phase",
                    given,
                    "a forecast begins at one of the record's",
                )
            })?;
            (handed, error) = (1, hand_over.start(&mut rng));
            self.chains.set(at, &bootstrap.empty(phase));
            bootstrap.hand(&mut self.chains, at, hand_over.anomaly(member, 0, error));
        } else {
            self.chains.set(at, &bootstrap.start(beginning.phase, &mut rng)?);
        }
        self.rngs.push(rng);
        self.members.push(member);
        self.handed.push(handed);
        self.errors.push(error);
        Ok(())
    }

    /// Takes one member's next step if that is handed over; whether it was.
    fn hand(&mut self, bootstrap: &Bootstrap, hand_over: &HandOver, at: usize) -> bool {
        if self.handed[at] >= hand_over.steps() {
            return false;
        }
        self.errors[at] = hand_over.advance(self.errors[at], &mut self.rngs[at]);
        let anomaly = hand_over.anomaly(self.members[at], self.handed[at], self.errors[at]);
        bootstrap.hand(&mut self.chains, at, anomaly);
        self.handed[at] += 1;
        true
    }

    /// Moves some of the winds by one step of the record.
    fn advance(&mut self, bootstrap: &Bootstrap, beginning: &Beginning, numbers: &[usize]) {
        let mut drawn: SmallVec<[usize; WIDTH]> = numbers.into();
        if let Some(hand_over) = &beginning.hand_over {
            drawn.retain(|at| !self.hand(bootstrap, hand_over, *at));
        }
        bootstrap.step(&mut self.chains, &drawn, &mut self.rngs, &mut self.scratch);
    }
}

/// Draws the wind of any member in a scenario's units.
#[derive(Debug, Clone)]
pub struct WindGenerator {
    bootstrap: Arc<Bootstrap>,
    small_scale: SmallScale,
    /// Synoptic step [time].
    step: f64,
    /// Velocity unit of the scenario [m/s].
    unit: f64,
    /// Steps simulated before time 0, for windows that reach back.
    lead_in: usize,
    /// How the first of them begins.
    beginning: Beginning,
}

impl WindGenerator {
    /// `step` is the record's step in scenario time, `unit` the scenario's velocity unit in m/s;
    /// the small scale comes in scenario units.
    pub fn new(
        bootstrap: Arc<Bootstrap>,
        small_scale: SmallScale,
        step: f64,
        unit: f64,
        lead_in: usize,
        phase: Option<usize>,
    ) -> Result<Self, DriftError> {
        positive("synoptic step", step)?;
        positive("wind unit", unit)?;
        let beginning = phase.into();
        Ok(Self { bootstrap, small_scale, step, unit, lead_in, beginning })
    }

    /// The same, with the first steps (of the lead-in, if there is one) handed over.
    #[must_use]
    pub fn handed_over(mut self, hand_over: Arc<HandOver>) -> Self {
        self.beginning.hand_over = Some(hand_over);
        self
    }

    /// The winds of nobody yet.
    pub(crate) fn winds(&self, seed: u64) -> MemberWinds<'_> {
        let zero = [Lanes::ZERO; 2];
        MemberWinds {
            generator: self,
            seed,
            synoptic: Synoptic::new(&self.bootstrap),
            streams: Vec::with_capacity(WIDTH),
            slow: zero,
            fast: zero,
            before: [zero; 2],
            fast_integral: zero,
        }
    }

    /// Synoptic steps drawn before time 0.
    pub(crate) fn lead_in(&self) -> usize {
        self.lead_in
    }

    /// Time up to which the wind is drawn where it is needed up to `t`.
    pub(crate) fn drawn_until(&self, t: f64) -> f64 {
        (t / self.step - 1e-9).ceil() * self.step
    }

    /// Spacing of a path's knots, and how many of them one synoptic step holds.
    pub(crate) fn knots(&self, sampling: Sampling) -> (f64, usize) {
        let substeps = match sampling {
            Sampling::Coarse => 1,
            Sampling::Fine => self.small_scale.substeps(),
        };
        (self.step / substeps as f64, substeps)
    }

    /// Synoptic steps from `−lead_in` on that reach `end`; fails where their knots are too many.
    pub(crate) fn steps(&self, end: f64, sampling: Sampling) -> Result<usize, DriftError> {
        let (_, substeps) = self.knots(sampling);
        let steps = self.lead_in as f64 + (end / self.step - 1e-9).ceil().max(1.0);
        if steps.is_nan() || steps * substeps as f64 > MOST_KNOTS {
            let accepted = format!("a wind path has at most {MOST_KNOTS} knots");
            return Err(DriftError::invalid("end of the wind path", end, accepted));
        }
        Ok(steps as usize)
    }

    /// The path of one member from `−lead_in` steps to `end`.
    pub fn path(
        &self,
        seed: u64,
        lineage: impl Into<Lineage>,
        end: f64,
        sampling: Sampling,
    ) -> Result<WindPath, DriftError> {
        let (spacing, substeps) = self.knots(sampling);
        let steps = self.steps(end, sampling)?;
        let start = -(self.lead_in as f64) * self.step;
        let mut winds = self.winds(seed);
        winds.begin(lineage)?;
        let mut velocity = room("wind path", steps * substeps + 1)?;
        let mut integrals = Vec::with_capacity(steps);
        for _ in 0..steps {
            velocity.push(lane(&winds.velocity(), 0));
            integrals.push(lane(&winds.draw(&[0]), 0));
            if sampling == Sampling::Fine {
                winds.fill(0, &mut velocity);
            }
        }
        velocity.push(lane(&winds.velocity(), 0));
        match sampling {
            Sampling::Coarse => WindPath::from_coarse(start, spacing, velocity, &integrals),
            Sampling::Fine => {
                let times = (0..velocity.len()).map(|k| start + k as f64 * spacing).collect();
                WindPath::new(times, velocity)
            }
        }
    }
}

/// The winds of some members, at most [`WIDTH`], side by side on their way.
#[derive(Debug, Clone)]
pub(crate) struct MemberWinds<'a> {
    generator: &'a WindGenerator,
    seed: u64,
    synoptic: Synoptic,
    streams: Vec<Streams>,
    /// Both parts of each wind now, and before the last step.
    slow: LaneVec2,
    fast: LaneVec2,
    before: [LaneVec2; 2],
    /// The small scale's integrals over that step.
    fast_integral: LaneVec2,
}

/// The small scale's random streams of one member.
#[derive(Debug, Clone)]
struct Streams {
    coarse: ChaCha8Rng,
    fine: ChaCha8Rng,
    /// Those still ahead, and the steps drawn up to now.
    branches: Peekable<IntoIter<(usize, u64)>>,
    drawn: usize,
}

/// What one member's wind has come to, small enough to be kept for many: streams are named, with the
/// words read of each.
#[derive(Debug, Clone)]
pub(crate) struct Mark {
    chain: Chain,
    handed: usize,
    error: Vec2,
    slow: Vec2,
    fast: Vec2,
    drawn: usize,
    /// Whose streams are read.
    streams_of: u64,
    read: [u128; 3],
}

impl MemberWinds<'_> {
    /// Puts the wind of a lineage beside the others, to be drawn from `−lead_in` steps on.
    pub(crate) fn begin(&mut self, lineage: impl Into<Lineage>) -> Result<(), DriftError> {
        let Self { generator, seed, .. } = *self;
        let Lineage { member, branches } = lineage.into();
        self.synoptic.begin(&generator.bootstrap, &generator.beginning, seed, member)?;
        let mut coarse = stream(seed, member, Stream::SmallScale);
        let at = self.streams.len();
        let slow = generator.bootstrap.wind(&self.synoptic.chains, at) / generator.unit;
        set_lane(&mut self.slow, at, slow);
        set_lane(&mut self.fast, at, generator.small_scale.start(&mut coarse));
        let fine = stream(seed, member, Stream::FinePath);
        let branches = branches.into_iter().peekable();
        self.streams.push(Streams { coarse, fine, branches, drawn: 0 });
        Ok(())
    }

    /// Puts the wind of a lineage beside the others, to be drawn on from where a member with the same
    /// past was.
    pub(crate) fn resume(&mut self, lineage: &Lineage, mark: &Mark) {
        let Mark { chain, handed, error, slow, fast, drawn, streams_of, read } = mark;
        let [synoptic, coarse, fine] = [
            (Stream::Synoptic, read[0]),
            (Stream::SmallScale, read[1]),
            (Stream::FinePath, read[2]),
        ]
        .map(|(name, read)| {
            let mut rng = stream(self.seed, *streams_of, name);
            rng.set_word_pos(read);
            rng
        });
        let at = self.streams.len();
        self.synoptic.chains.set(at, chain);
        self.synoptic.rngs.push(synoptic);
        self.synoptic.members.push(lineage.member);
        self.synoptic.handed.push(*handed);
        self.synoptic.errors.push(*error);
        set_lane(&mut self.slow, at, *slow);
        set_lane(&mut self.fast, at, *fast);
        let ahead = |(step, _): &&(usize, u64)| self.generator.lead_in + step >= *drawn;
        let branches: Vec<_> = lineage.branches.iter().filter(ahead).copied().collect();
        let branches = branches.into_iter().peekable();
        self.streams.push(Streams { coarse, fine, branches, drawn: *drawn });
    }

    /// What one of them has come to; none if there are not so many.
    pub(crate) fn mark(&self, at: usize) -> Option<Mark> {
        let Streams { coarse, fine, drawn, .. } = self.streams.get(at)?;
        let synoptic = &self.synoptic.rngs[at];
        Some(Mark {
            chain: self.synoptic.chains.get(at),
            handed: self.synoptic.handed[at],
            error: self.synoptic.errors[at],
            slow: lane(&self.slow, at),
            fast: lane(&self.fast, at),
            drawn: *drawn,
            streams_of: synoptic.get_stream() / STREAMS,
            read: [synoptic, coarse, fine].map(ChaCha8Rng::get_word_pos),
        })
    }

    /// Who draws them.
    pub(crate) fn generator(&self) -> &WindGenerator {
        self.generator
    }

    /// Those for whom so many steps are drawn, the ones before time 0 included.
    pub(crate) fn drawn(&self, steps: usize) -> SmallVec<[usize; WIDTH]> {
        (0..self.streams.len()).filter(|at| self.streams[*at].drawn == steps).collect()
    }

    /// The winds at the last knot drawn.
    pub(crate) fn velocity(&self) -> LaneVec2 {
        [0, 1].map(|k| self.slow[k] + self.fast[k])
    }

    /// Draws one step of some of the winds, and returns their integrals over it.
    pub(crate) fn draw(&mut self, numbers: &[usize]) -> LaneVec2 {
        let WindGenerator { bootstrap, small_scale, step, unit, lead_in, beginning } =
            self.generator;
        for at in numbers {
            let Streams { coarse, fine, branches, drawn } = &mut self.streams[*at];
            while let Some((_, member)) = branches.next_if(|(step, _)| lead_in + *step <= *drawn) {
                self.synoptic.rngs[*at] = stream(self.seed, member, Stream::Synoptic);
                *coarse = stream(self.seed, member, Stream::SmallScale);
                *fine = stream(self.seed, member, Stream::FinePath);
            }
            *drawn += 1;
        }
        self.synoptic.advance(bootstrap, beginning, numbers);
        self.before = [self.slow, self.fast];
        for at in numbers {
            let slow = bootstrap.wind(&self.synoptic.chains, *at) / *unit;
            set_lane(&mut self.slow, *at, slow);
            let coarse = &mut self.streams[*at].coarse;
            let (fast, integral) = small_scale.advance(lane(&self.fast, *at), coarse);
            set_lane(&mut self.fast, *at, fast);
            set_lane(&mut self.fast_integral, *at, integral);
        }
        let [slow, _] = &self.before;
        [0, 1].map(|k| (slow[k] + self.slow[k]) * (step / 2.0) + self.fast_integral[k])
    }

    /// Draws the knots of one of the winds within the step that was drawn last, its ends left out,
    /// and appends them to `knots`.
    pub(crate) fn fill(&mut self, at: usize, knots: &mut Vec<Vec2>) {
        let [slow, fast] = self.before.map(|of| lane(&of, at));
        let slow_next = lane(&self.slow, at);
        let to = (lane(&self.fast, at), lane(&self.fast_integral, at));
        let small_scale = &self.generator.small_scale;
        let first = knots.len();
        small_scale.fill(fast, to, &mut self.streams[at].fine, knots);
        let share = 1.0 / small_scale.substeps() as f64;
        for (k, w) in knots[first..].iter_mut().enumerate() {
            *w += slow.lerp(&slow_next, (k + 1) as f64 * share);
        }
    }
}

/// The synoptic part alone, in m/s: what [`WindGenerator::path`] draws for these members.
pub fn sample(
    bootstrap: &Bootstrap,
    seed: u64,
    members: std::ops::Range<u64>,
    steps: usize,
    beginning: impl Into<Beginning>,
) -> Result<SynopticSample, DriftError> {
    let beginning = &beginning.into();
    let count = product("members", &[(members.end - members.start) as usize, steps])?;
    let mut sample =
        SynopticSample { wind: room("members", count)?, predecessor: room("members", count)? };
    sample.wind.resize(count, Vec2::zeros());
    sample.predecessor.resize(count, None);
    let mut first = 0;
    while first < members.end - members.start {
        let group = first..(first + WIDTH as u64).min(members.end - members.start);
        let mut winds = Synoptic::new(bootstrap);
        for number in group.clone() {
            winds.begin(bootstrap, beginning, seed, members.start + number)?;
        }
        let numbers: Vec<usize> = (0..winds.members.len()).collect();
        for step in 0..steps {
            if step > 0 {
                winds.advance(bootstrap, beginning, &numbers);
            }
            for (number, place) in group.clone().zip(&numbers) {
                let at = number as usize * steps + step;
                sample.wind[at] = bootstrap.wind(&winds.chains, *place);
                sample.predecessor[at] = winds.chains.predecessor(*place);
            }
        }
        first = group.end;
    }
    Ok(sample)
}
