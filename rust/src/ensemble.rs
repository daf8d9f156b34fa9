//! Monte Carlo: many members, each followed under its own wind, in parallel.

use std::borrow::Cow;
use std::ops::{ControlFlow, Range};
use std::sync::Arc;

use rayon::prelude::*;

use crate::coast::Coast;
use crate::dopri5::Work;
use crate::error::{DriftError, finite, positive};
use crate::field::{SeaField, Vec2};
use crate::lanes::{WIDTH, lane};
use crate::logbook::{Logbook, Watch};
use crate::model::lanes::{Carrier, Grid, State};
use crate::model::{Model, OnPiece, Problem, Solver};
use crate::particles::{Particle, Snapshot, Trail};
use crate::statistics::Maps;
use crate::wind::fields::FieldWinds;
use crate::wind::lanes::{LaneWind, WindPaths};
use crate::wind::path::WindPath;
use crate::wind::{Sampling, Wind, WindGenerator};

/// Everything about a scenario but its wind.
pub struct Scenario {
    /// The sea.
    pub sea: Arc<dyn SeaField>,
    /// The coast, if there is one.
    pub coast: Option<Coast>,
    /// Drag rate `Λ` [1/time].
    pub drag: f64,
    /// Length of the run [time].
    pub duration: f64,
    /// Position at the release.
    pub position: Vec2,
    /// Velocity at the release.
    pub velocity: Vec2,
}

/// Tides in a run: of more, a unit is wrong.
pub(crate) const MOST_TIDES: f64 = 1e6;

/// Response times in a run: steps are explicit, so that they would be as many.
const STIFFEST: f64 = 1e6;

impl Scenario {
    /// Fails unless the numbers make sense.
    pub fn validated(self) -> Result<Self, DriftError> {
        positive("drag", self.drag)?;
        positive("duration", self.duration)?;
        finite("position", self.position.as_slice())?;
        finite("velocity", self.velocity.as_slice())?;
        if self.duration / self.sea.period() > MOST_TIDES {
            let accepted = format!("a run has at most {MOST_TIDES} tides");
            return Err(DriftError::invalid("duration", self.duration, accepted));
        }
        if self.drag * self.duration > STIFFEST {
            let accepted = format!("a run has at most {STIFFEST} response times");
            return Err(DriftError::invalid("drag", self.drag, accepted));
        }
        Ok(self)
    }

    /// Follows the body through the whole run under a given wind, whatever coast there is.
    pub fn trajectory(
        &self,
        wind: &WindPath,
        solver: &Solver,
        times: &[f64],
    ) -> Result<Trajectory, DriftError> {
        let solver = solver.tightened(self.drag, self.duration);
        trajectory(times, |on_piece| solver.follow(self.problem(wind), on_piece))
    }

    fn problem<'a>(&'a self, wind: &'a WindPath) -> Problem<'a> {
        Problem {
            sea: self.sea.as_ref(),
            wind,
            drag: self.drag,
            duration: self.duration,
            position: self.position,
            velocity: self.velocity,
        }
    }
}

/// How a member ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Status {
    /// Still adrift at the end of the run.
    Afloat = 0,
    /// Met the coast.
    Stranded = 1,
    /// Left the domain of the data.
    LeftDomain = 2,
    /// Could not be followed to the end.
    Failed = 3,
}

/// One member of an ensemble.
#[derive(Debug, Clone)]
pub struct Member {
    /// How it ended.
    pub status: Status,
    /// Time and place of stranding.
    pub stranding: Option<(f64, Vec2)>,
    /// Position at the output times it was adrift.
    pub positions: Vec<Vec2>,
    /// Position at the times that maps sample, while it was adrift; empty once it is counted.
    pub track: Vec<Vec2>,
    /// Time of the first entry of each target, NaN where there was none.
    pub entries: Vec<f64>,
    /// Why it failed.
    pub failure: Option<DriftError>,
}

/// What a trajectory holds at each output time.
#[derive(Debug, Clone, Default)]
pub struct Trajectory {
    /// Position, tidal oscillation included.
    pub position: Vec<Vec2>,
    /// Velocity, tidal oscillation included.
    pub velocity: Vec<Vec2>,
    /// Slow position and velocity, empty where the model has none.
    pub mean: Vec<(Vec2, Vec2)>,
    /// What the integration took.
    pub work: Work,
}

/// Records what `follow` hands over, a body's motion through the whole run, at some times.
pub(crate) fn trajectory(
    times: &[f64],
    follow: impl FnOnce(OnPiece) -> Result<Work, DriftError>,
) -> Result<Trajectory, DriftError> {
    let mut out = Trajectory::default();
    let work = follow(&mut |piece| {
        while let Some(t) = times.get(out.position.len()).filter(|t| **t <= piece.span().1) {
            out.position.push(piece.position(*t)?);
            out.velocity.push(piece.velocity(*t)?);
            out.mean.extend(piece.mean(*t)?);
        }
        Ok(ControlFlow::Continue(()))
    })?;
    Ok(Trajectory { work, ..out })
}

/// Follows one body until it strands; what goes wrong on the way becomes its status.
pub(crate) fn member(
    mut log: Logbook,
    follow: impl FnOnce(OnPiece) -> Result<Work, DriftError>,
) -> Member {
    let run = follow(&mut |piece| log.look(piece, true));
    log.close(run.map(|_| ()))
}

/// Wind of any member of an ensemble.
pub enum Winds<'a> {
    /// Drawn by a generator, named by (seed, member).
    Drawn {
        /// The generator.
        generator: &'a WindGenerator,
        /// The seed.
        seed: u64,
    },
    /// Drawn by a generator, one for each particle.
    Branched {
        /// The generator.
        generator: &'a WindGenerator,
        /// The seed.
        seed: u64,
        /// The particles.
        particles: &'a [Arc<Particle>],
        /// Parts of the run that they may be branched between.
        parts: usize,
    },
    /// Given, one for each member.
    Given(&'a [&'a WindPath]),
    /// Given, on common knots.
    InMemory(&'a WindPaths),
    /// Given, and varying in space.
    Fields(&'a FieldWinds),
}

impl Winds<'_> {
    /// Fails unless each of some members has a wind.
    pub fn require(&self, members: &Range<u64>) -> Result<(), DriftError> {
        let known = match self {
            Self::Drawn { .. } => 0..u64::MAX,
            Self::Branched { particles, .. } => 0..particles.len() as u64,
            Self::Given(paths) => 0..paths.len() as u64,
            Self::InMemory(paths) => 0..paths.members() as u64,
            Self::Fields(winds) => winds.members(),
        };
        if known.start <= members.start && members.end <= known.end {
            return Ok(());
        }
        let accepted = format!("the run is of members {members:?}");
        Err(DriftError::invalid("winds", format!("of members {known:?}"), accepted))
    }

    /// Wind of one member, up to `end` if it is drawn.
    pub(crate) fn wind(
        &self,
        member: u64,
        end: f64,
        sampling: Sampling,
    ) -> Result<Box<dyn Wind + '_>, DriftError> {
        match self {
            Self::Fields(winds) => Ok(Box::new(winds.member(member, sampling)?)),
            _ => match self.path(member, end, sampling)? {
                Cow::Borrowed(path) => Ok(Box::new(path)),
                Cow::Owned(path) => Ok(Box::new(path)),
            },
        }
    }

    /// Wind path of one member, up to `end` if it is drawn.
    pub(crate) fn path(
        &self,
        member: u64,
        end: f64,
        sampling: Sampling,
    ) -> Result<Cow<'_, WindPath>, DriftError> {
        match self {
            Self::Drawn { generator, seed } => {
                generator.path(*seed, member, end, sampling).map(Cow::Owned)
            }
            Self::Branched { generator, seed, particles, .. } => {
                let particle = (particles.get(member as usize))
                    .ok_or_else(|| DriftError::invalid("member", member, "it has no lineage"))?;
                generator.path(*seed, particle.lineage().clone(), end, sampling).map(Cow::Owned)
            }
            Self::Given(paths) => (paths.get(member as usize).map(|path| Cow::Borrowed(*path)))
                .ok_or_else(|| DriftError::invalid("member", member, "it has no wind path")),
            Self::InMemory(paths) => paths.path(member as usize).map(Cow::Owned),
            Self::Fields(_) => Err(DriftError::invalid(
                "wind",
                "fields",
                "the paper's body and its expansions take a wind uniform in space",
            )),
        }
    }
}

/// An ensemble about to be followed: a scenario, a model, the winds, and what is recorded.
pub struct Ensemble<'a> {
    scenario: &'a Scenario,
    winds: &'a Winds<'a>,
    solver: Solver,
    /// Output times, and the number of members that record their positions there.
    times: &'a [f64],
    keep: u64,
    maps: Option<&'a Maps>,
    targets: &'a [&'a Coast],
    end: f64,
    sampling: Sampling,
    side_by_side: Option<SideBySide<'a>>,
}

/// Steps taken at once where neither a coast nor an output is looked for.
const UNWATCHED_STEPS: usize = 32;

/// What members that step side by side have in common.
struct SideBySide<'a> {
    carrier: Carrier,
    grid: Grid,
    /// The problem of any member; its wind is calm.
    problem: Problem<'a>,
    start: Vec2,
    tolerance: Option<(f64, f64)>,
}

impl<'a> Ensemble<'a> {
    /// Prepares what all members share. `steps_per_tide` asks for steps of one length, without
    /// control of the error, from the models that step side by side.
    pub fn new(
        scenario: &'a Scenario,
        winds: &'a Winds<'a>,
        solver: Solver,
        steps_per_tide: Option<f64>,
        (times, keep): (&'a [f64], u64),
    ) -> Result<Self, DriftError> {
        let sampling = match solver.model {
            Model::MeanFlow { order: 1 } => Sampling::Coarse,
            _ => Sampling::Fine,
        };
        let solver = solver.tightened(scenario.drag, scenario.duration);
        let (_, end) = solver.wind_needed(scenario.duration, scenario.sea.period());
        let carrier = Carrier::of(solver.model)
            .filter(|_| solver.euler_step.is_none() && !matches!(winds, Winds::Given(_)));
        let shared = carrier.map(|carrier| {
            let problem = scenario.problem(WindPath::calm());
            if let Some(steps) = steps_per_tide {
                positive("steps_per_tide", steps)?;
            }
            let longest = steps_per_tide.map_or(carrier.max_step(), |steps| 1.0 / steps);
            let Scenario { sea, duration, drag, .. } = scenario;
            let parts = if let Winds::Branched { parts, .. } = winds { *parts } else { 1 };
            Ok(SideBySide {
                carrier,
                grid: Grid::new(carrier, sea.as_ref(), *duration, *drag, (longest, parts))?,
                problem,
                start: carrier.start(problem)?,
                tolerance: steps_per_tide.is_none().then_some((solver.rtol, solver.atol)),
            })
        });
        let side_by_side = match (shared, steps_per_tide) {
            (Some(shared), Some(_)) => Some(shared?),
            // What cannot be prepared for all fails member by member, or takes adaptive steps.
            (Some(shared), None) => shared.ok(),
            (None, None) => None,
            (None, Some(steps)) => {
                return Err(DriftError::invalid(
                    "steps_per_tide",
                    steps,
                    "only the full model and mean-flow order 1, under winds that are drawn or \
                     on common knots, take steps of one length",
                ));
            }
        };
        let (maps, targets) = (None, &[][..]);
        Ok(Self {
            scenario,
            winds,
            solver,
            times,
            keep,
            maps,
            targets,
            end,
            sampling,
            side_by_side,
        })
    }

    /// Counts the members on maps, and notes when they first enter each target.
    pub fn observed(self, maps: Option<&'a Maps>, targets: &'a [&'a Coast]) -> Self {
        Self { maps, targets, ..self }
    }

    /// Follows the members of a range, in the order of their indices; groups of [`WIDTH`] share
    /// their steps, and no member depends on another.
    pub fn follow(&self, members: Range<u64>) -> Vec<Member> {
        let width = WIDTH as u64;
        let groups = members.start / width..members.end.div_ceil(width);
        let followed: Vec<Vec<Member>> = groups
            .into_par_iter()
            .map(|group| {
                let range =
                    (group * width).max(members.start)..((group + 1) * width).min(members.end);
                let mut members = self.group(range);
                if let Some(maps) = self.maps {
                    for member in &mut members {
                        maps.count(member);
                        member.track = Vec::new();
                    }
                }
                members
            })
            .collect();
        followed.into_iter().flatten().collect()
    }

    fn group(&self, members: Range<u64>) -> Vec<Member> {
        if let Some(shared) = &self.side_by_side
            && let Ok(wind) = self.lane_wind(members.clone())
        {
            return self.abreast(shared, wind, members);
        }
        members.map(|index| self.alone(index)).collect()
    }

    fn watch(&self, member: u64) -> Watch<'a> {
        Watch {
            coast: self.scenario.coast.as_ref(),
            targets: self.targets,
            period: self.scenario.sea.period(),
            outputs: if member < self.keep { self.times } else { &[] },
            samples: self.maps.map_or(&[], |maps| maps.grid().samples()),
        }
    }

    /// A member's logbook, from a time on.
    fn log(&self, member: u64, from: f64) -> Logbook<'a> {
        Logbook::from_release(self.watch(member), from)
    }

    /// The particle of an index, if members are particles.
    fn particle(&self, index: u64) -> Option<&'a Particle> {
        match self.winds {
            Winds::Branched { particles, .. } => particles.get(index as usize).map(Arc::as_ref),
            _ => None,
        }
    }

    /// Follows one member by the adaptive integrator.
    fn alone(&self, index: u64) -> Member {
        let path = match self.winds.path(index, self.end, self.sampling) {
            Ok(path) => path,
            Err(error) => return self.log(index, 0.0).close(Err(error)),
        };
        let follow = |log| {
            member(log, |on_piece| self.solver.follow(self.scenario.problem(&path), on_piece))
        };
        let Winds::Branched { generator, parts, .. } = self.winds else {
            return follow(self.log(index, 0.0));
        };
        let Scenario { duration, .. } = self.scenario;
        let ends: Vec<f64> = (1..=*parts).map(|k| duration * (k as f64 / *parts as f64)).collect();
        // Nobody maps particles: their track is what is seen of them.
        let watch = Watch { samples: &ends, ..self.watch(index) };
        let mut particle = follow(Logbook::new(watch));
        let before = path.integral(0.0);
        let drawn = |t: f64| path.velocity(generator.drawn_until(t));
        let seen = (std::mem::take(&mut particle.track).into_iter().zip(&ends))
            .map(|(x, t)| [x, path.integral(*t) - before, drawn(*t)])
            .collect();
        // What it was followed side by side with others before counts as a whole run.
        let share = if self.side_by_side.is_some() { 2.0 } else { 1.0 };
        if let Some(of) = self.particle(index) {
            of.leave(Trail { seen, share, ..Trail::default() });
        }
        particle
    }

    /// The winds of the members of one group; those before the first count as absent.
    fn lane_wind(&self, members: Range<u64>) -> Result<LaneWind<'_>, DriftError> {
        self.winds.require(&members)?;
        match self.winds {
            Winds::Drawn { generator, seed } => {
                generator.steps(self.end, self.sampling)?;
                let mut winds = generator.winds(*seed);
                for member in members {
                    winds.begin(member)?;
                }
                Ok(LaneWind::drawn(winds, self.sampling))
            }
            Winds::Branched { generator, seed, particles, .. } => {
                generator.steps(self.end, self.sampling)?;
                let mut winds = generator.winds(*seed);
                let range = members.start as usize..members.end as usize;
                for particle in particles.get(range).unwrap_or_default() {
                    match particle.start() {
                        Some(start) => winds.resume(particle.lineage(), start.wind.member()),
                        None => winds.begin(particle.lineage().clone())?,
                    }
                }
                Ok(LaneWind::drawn(winds, self.sampling))
            }
            Winds::InMemory(paths) => {
                paths.require(0.0, self.end)?;
                Ok(LaneWind::in_memory(paths, members.start as usize / WIDTH))
            }
            Winds::Given(_) | Winds::Fields(_) => {
                Err(DriftError::invalid("winds", "paths", "they have no lanes"))
            }
        }
    }

    /// Follows a group side by side. A member whose error is estimated above the tolerance, or who
    /// leaves the data, is followed alone: that depends on nobody else. Branches join where they
    /// begin.
    fn abreast(&self, shared: &SideBySide, mut wind: LaneWind, members: Range<u64>) -> Vec<Member> {
        // In memory the lanes belong to fixed members, drawn winds begin with the first asked for.
        let first = match self.winds {
            Winds::InMemory(_) => members.start - members.start % WIDTH as u64,
            _ => members.start,
        };
        let index = |place: usize| first + place as u64;
        let here = |place: usize| members.contains(&index(place));
        let particles: [Option<&Particle>; WIDTH] =
            std::array::from_fn(|place| self.particle(index(place)).filter(|_| here(place)));
        let starts = particles.map(|particle| particle.and_then(Particle::start));
        let mut adrift: [bool; WIDTH] =
            std::array::from_fn(|place| here(place) && starts[place].is_none());
        let mut alone = [false; WIDTH];
        let mut logs: [Logbook; WIDTH] = std::array::from_fn(|place| {
            self.log(index(place), starts[place].map_or(0.0, |start| start.time))
        });
        let Scenario { sea, coast, .. } = self.scenario;
        let bounded = coast.is_some() || !self.targets.is_empty();
        let Ok(mut state) = State::new(&shared.grid, &shared.problem, shared.start) else {
            return members.map(|index| self.alone(index)).collect();
        };
        // Steps of a part of the run; none where nobody is branched.
        let part = match self.winds {
            Winds::Branched { parts, .. } => Some(shared.grid.steps() / parts),
            _ => None,
        };
        let mut trails: [Trail; WIDTH] = std::array::from_fn(|_| Trail::default());
        let watched = bounded || members.start < self.keep || self.maps.is_some() || part.is_some();
        let together = if watched { 1 } else { UNWATCHED_STEPS };
        let mut n = 0;
        if adrift == [false; WIDTH]
            && let Some(first) = starts.iter().flatten().min_by_key(|start| start.step)
        {
            n = first.step;
            wind.begin_at(&first.wind);
        }
        while n < shared.grid.steps() {
            for (place, start) in starts.iter().enumerate() {
                if let Some(start) = start.filter(|start| start.step == n) {
                    adrift[place] = wind.join(place, &start.wind);
                    alone[place] = !adrift[place];
                    state.put(place, start.body);
                }
            }
            let steps = n..(n + together).min(shared.grid.steps());
            let last = steps.end - 1;
            n = steps.end;
            let (_, t1) = shared.grid.span(last);
            wind.draw_until(t1, &adrift);
            let before = state.p;
            let stepped =
                state.advance(&shared.grid, sea.as_ref(), &wind, steps, shared.tolerance, bounded);
            for place in 0..WIDTH {
                if !adrift[place] {
                    continue;
                }
                if state.failed(place) {
                    (adrift[place], alone[place]) = (false, true);
                    continue;
                }
                let log = &mut logs[place];
                let near = stepped.reach.as_ref().is_some_and(|reach| {
                    log.is_near(&shared.carrier.oscillating(&shared.problem, reach.of(place)))
                });
                if !(near || log.is_due(t1)) {
                    continue;
                }
                let stretch = wind.stretch(t1, place);
                let problem = Problem { wind: &stretch, ..shared.problem };
                let step = state.one_step(&shared.grid, last, &before, place);
                let looked =
                    shared.carrier.with_piece(problem, &step, |piece| log.look(piece, near));
                match looked {
                    Ok(Ok(ControlFlow::Continue(()))) => {}
                    Ok(Ok(ControlFlow::Break(()))) => adrift[place] = false,
                    _ => (adrift[place], alone[place]) = (false, true),
                }
            }
            let awaited = starts.iter().flatten().any(|start| start.step >= n);
            if adrift == [false; WIDTH] && !awaited {
                break;
            }
            wind.go_on(stepped.wind);
            if part.is_some_and(|part| n.is_multiple_of(part)) {
                let seen = wind.seen(t1, shared.problem.drag, state.p);
                for (place, trail) in trails.iter_mut().enumerate().filter(|(k, _)| adrift[*k]) {
                    trail.seen.push(seen.map(|of| lane(&of, place)));
                    let body = state.place(place);
                    let snapshot = |wind| Snapshot { step: n, time: t1, body, wind };
                    if n < shared.grid.steps() {
                        trail.snapshots.extend(wind.mark(place).map(snapshot));
                    }
                }
            }
        }
        let whole = shared.grid.steps();
        let along = part.unwrap_or(whole);
        for (place, trail) in trails.into_iter().enumerate() {
            if let Some(particle) = particles[place].filter(|_| !alone[place]) {
                let begun = starts[place].map_or(0, |start| start.step);
                let share = (whole - begun) as f64 / whole as f64;
                particle.leave(Trail { first: begun / along, share, ..trail });
            }
        }
        (0..WIDTH)
            .zip(logs)
            .filter(|(place, _)| here(*place))
            .map(
                |(place, log)| {
                    if alone[place] { self.alone(index(place)) } else { log.close(Ok(())) }
                },
            )
            .collect()
    }
}
