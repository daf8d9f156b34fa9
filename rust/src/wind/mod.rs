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

use crate::error::{DriftError, positive, product, room};
use crate::field::Vec2;
use crate::lanes::WIDTH;
use bootstrap::{Bootstrap, Chain, Scratch};
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

/// The synoptic wind of one member, with its random stream.
#[derive(Debug, Clone)]
struct Synoptic {
    chain: Chain,
    rng: ChaCha8Rng,
    member: u64,
    /// Steps that were handed over, and the error of the last, before it is scaled.
    handed: usize,
    error: Vec2,
}

impl Synoptic {
    fn start(
        bootstrap: &Bootstrap,
        beginning: &Beginning,
        seed: u64,
        member: u64,
    ) -> Result<Self, DriftError> {
        numbered(member)?;
        let mut rng = stream(seed, member, Stream::Synoptic);
        let Some(hand_over) = &beginning.hand_over else {
            let chain = bootstrap.start(beginning.phase, &mut rng)?;
            return Ok(Self { chain, rng, member, handed: 0, error: Vec2::zeros() });
        };
        let order = bootstrap.catalogue().order;
        if hand_over.steps() < order {
            let accepted = format!("the bootstrap goes on from {order}");
            return Err(DriftError::invalid("forecast steps", hand_over.steps(), accepted));
        }
        let phase =
            beginning.phase.filter(|phase| *phase < bootstrap.phases()).ok_or_else(|| {
                let given = beginning.phase.map_or(String::from("none"), |phase| phase.to_string());
                DriftError::invalid(
                    "start phase",
                    given,
                    "a forecast begins at one of the record's",
                )
            })?;
        let error = hand_over.start(&mut rng);
        let mut chain = bootstrap.empty(phase);
        bootstrap.hand(&mut chain, hand_over.anomaly(member, 0, error));
        Ok(Self { chain, rng, member, handed: 1, error })
    }

    /// Takes the next step if that is handed over; whether it was.
    fn hand(&mut self, bootstrap: &Bootstrap, beginning: &Beginning) -> bool {
        let of = beginning.hand_over.as_ref();
        let Some(hand_over) = of.filter(|hand_over| self.handed < hand_over.steps()) else {
            return false;
        };
        self.error = hand_over.advance(self.error, &mut self.rng);
        let anomaly = hand_over.anomaly(self.member, self.handed, self.error);
        bootstrap.hand(&mut self.chain, anomaly);
        self.handed += 1;
        true
    }

    /// Moves several winds by one step of the record.
    fn advance<'a>(
        winds: impl Iterator<Item = &'a mut Self>,
        bootstrap: &Bootstrap,
        beginning: &Beginning,
        scratch: &mut Scratch,
    ) {
        let drawn = winds.filter_map(|wind| {
            let handed = wind.hand(bootstrap, beginning);
            (!handed).then_some((&mut wind.chain, &mut wind.rng))
        });
        bootstrap.advance(drawn, scratch);
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

    /// The wind of one member, ready to be drawn from `−lead_in` steps on.
    pub(crate) fn member(
        &self,
        seed: u64,
        lineage: impl Into<Lineage>,
    ) -> Result<MemberWind, DriftError> {
        let Lineage { member, branches } = lineage.into();
        let synoptic = Synoptic::start(&self.bootstrap, &self.beginning, seed, member)?;
        let mut coarse = stream(seed, member, Stream::SmallScale);
        Ok(MemberWind {
            slow: self.bootstrap.wind(&synoptic.chain) / self.unit,
            fast: self.small_scale.start(&mut coarse),
            fine: stream(seed, member, Stream::FinePath),
            synoptic,
            coarse,
            seed,
            branches: branches.into_iter().peekable(),
            drawn: 0,
        })
    }

    /// The wind of a lineage, ready to be drawn on from where a member with the same past was.
    pub(crate) fn resumed(&self, seed: u64, lineage: &Lineage, mark: &Mark) -> MemberWind {
        let Mark { chain, handed, error, slow, fast, drawn, streams_of, read } = mark;
        let [synoptic, coarse, fine] = [
            (Stream::Synoptic, read[0]),
            (Stream::SmallScale, read[1]),
            (Stream::FinePath, read[2]),
        ]
        .map(|(name, read)| {
            let mut rng = stream(seed, *streams_of, name);
            rng.set_word_pos(read);
            rng
        });
        let ahead = |(step, _): &&(usize, u64)| self.lead_in + step >= *drawn;
        let branches: Vec<_> = lineage.branches.iter().filter(ahead).copied().collect();
        MemberWind {
            synoptic: Synoptic {
                chain: chain.clone(),
                rng: synoptic,
                member: lineage.member,
                handed: *handed,
                error: *error,
            },
            slow: *slow,
            fast: *fast,
            coarse,
            fine,
            seed,
            branches: branches.into_iter().peekable(),
            drawn: *drawn,
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

    /// Draws the synoptic part of one step of several winds, each of which is to be filled then.
    pub(crate) fn draw<'a>(
        &self,
        winds: impl Iterator<Item = &'a mut MemberWind>,
        scratch: &mut Scratch,
    ) {
        let synoptic = winds.map(|wind| {
            let branches = &mut wind.branches;
            while let Some((_, member)) =
                branches.next_if(|(step, _)| self.lead_in + *step <= wind.drawn)
            {
                wind.synoptic.rng = stream(wind.seed, member, Stream::Synoptic);
                wind.coarse = stream(wind.seed, member, Stream::SmallScale);
                wind.fine = stream(wind.seed, member, Stream::FinePath);
            }
            wind.drawn += 1;
            &mut wind.synoptic
        });
        Synoptic::advance(synoptic, &self.bootstrap, &self.beginning, scratch);
    }

    /// Draws the small scale of the step that was drawn: the wind at its knots but the last goes to
    /// `knots`, and for coarse sampling the integral over the step is returned.
    pub(crate) fn fill(
        &self,
        wind: &mut MemberWind,
        sampling: Sampling,
        knots: &mut Vec<Vec2>,
    ) -> Vec2 {
        let (slow, fast) = (wind.slow, wind.fast);
        wind.slow = self.bootstrap.wind(&wind.synoptic.chain) / self.unit;
        let (fast_next, fast_integral) = self.small_scale.advance(fast, &mut wind.coarse);
        wind.fast = fast_next;
        knots.push(slow + fast);
        if sampling == Sampling::Fine {
            let first = knots.len();
            self.small_scale.fill(fast, (fast_next, fast_integral), &mut wind.fine, knots);
            let share = 1.0 / self.small_scale.substeps() as f64;
            for (k, w) in knots[first..].iter_mut().enumerate() {
                *w += slow.lerp(&wind.slow, (k + 1) as f64 * share);
            }
        }
        (slow + wind.slow) * (self.step / 2.0) + fast_integral
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
        let mut wind = self.member(seed, lineage)?;
        let mut velocity = room("wind path", steps * substeps + 1)?;
        let mut scratch = Scratch::default();
        let integrals: Vec<Vec2> = (0..steps)
            .map(|_| {
                self.draw(std::iter::once(&mut wind), &mut scratch);
                self.fill(&mut wind, sampling, &mut velocity)
            })
            .collect();
        velocity.push(wind.velocity());
        match sampling {
            Sampling::Coarse => WindPath::from_coarse(start, spacing, velocity, &integrals),
            Sampling::Fine => {
                let times = (0..velocity.len()).map(|k| start + k as f64 * spacing).collect();
                WindPath::new(times, velocity)
            }
        }
    }
}

/// What one member's wind has come to, with its random streams.
#[derive(Debug, Clone)]
pub(crate) struct MemberWind {
    synoptic: Synoptic,
    slow: Vec2,
    fast: Vec2,
    coarse: ChaCha8Rng,
    fine: ChaCha8Rng,
    seed: u64,
    /// Those still ahead, and the steps drawn up to now.
    branches: Peekable<IntoIter<(usize, u64)>>,
    drawn: usize,
}

/// The same, small enough to be kept for many: streams are named, with the words read of each.
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

impl MemberWind {
    /// What it has come to.
    pub(crate) fn mark(&self) -> Mark {
        let Self { synoptic, slow, fast, coarse, fine, drawn, .. } = self;
        Mark {
            chain: synoptic.chain.clone(),
            handed: synoptic.handed,
            error: synoptic.error,
            slow: *slow,
            fast: *fast,
            drawn: *drawn,
            streams_of: synoptic.rng.get_stream() / STREAMS,
            read: [&synoptic.rng, coarse, fine].map(ChaCha8Rng::get_word_pos),
        }
    }

    /// Synoptic steps drawn, those before time 0 included.
    pub(crate) fn drawn(&self) -> usize {
        self.drawn
    }

    /// The wind at the last knot drawn.
    pub(crate) fn velocity(&self) -> Vec2 {
        self.slow + self.fast
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
    let mut scratch = Scratch::default();
    let mut first = 0;
    while first < members.end - members.start {
        let group = first..(first + WIDTH as u64).min(members.end - members.start);
        let mut winds = (group.clone())
            .map(|number| Synoptic::start(bootstrap, beginning, seed, members.start + number))
            .collect::<Result<Vec<_>, _>>()?;
        for step in 0..steps {
            if step > 0 {
                Synoptic::advance(winds.iter_mut(), bootstrap, beginning, &mut scratch);
            }
            for (number, Synoptic { chain, .. }) in group.clone().zip(&winds) {
                let at = number as usize * steps + step;
                sample.wind[at] = bootstrap.wind(chain);
                sample.predecessor[at] = chain.predecessor();
            }
        }
        first = group.end;
    }
    Ok(sample)
}
