//! Monte Carlo: many members, each followed under its own wind, in parallel.

use std::borrow::Cow;
use std::ops::ControlFlow;
use std::sync::Arc;

use rayon::prelude::*;

use crate::coast::Coast;
use crate::dopri5::Work;
use crate::error::DriftError;
use crate::field::{SeaField, Vec2};
use crate::model::{Model, Piece, Problem, Solver};
use crate::wind::path::WindPath;
use crate::wind::{Sampling, WindGenerator};

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

impl Scenario {
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

/// Calls `visit` for each output time that the piece covers, up to `until`.
fn outputs(
    piece: &dyn Piece,
    times: &[f64],
    next: &mut usize,
    until: f64,
    mut visit: impl FnMut(f64) -> Result<(), DriftError>,
) -> Result<(), DriftError> {
    let end = piece.span().1.min(until);
    while let Some(t) = times.get(*next).filter(|t| **t <= end) {
        visit(*t)?;
        *next += 1;
    }
    Ok(())
}

/// Follows one body through the whole run under a given wind, whatever coast there is.
pub fn trajectory(
    scenario: &Scenario,
    wind: &WindPath,
    solver: &Solver,
    times: &[f64],
) -> Result<Trajectory, DriftError> {
    let mut next = 0;
    let mut out = Trajectory::default();
    let work = solver.follow(scenario.problem(wind), &mut |piece| {
        outputs(piece, times, &mut next, f64::INFINITY, |t| {
            out.position.push(piece.position(t)?);
            out.velocity.push(piece.velocity(t)?);
            out.mean.extend(piece.mean(t)?);
            Ok(())
        })?;
        Ok(ControlFlow::Continue(()))
    })?;
    Ok(Trajectory { work, ..out })
}

/// Follows one body until it strands; what goes wrong on the way becomes its status.
pub fn member(scenario: &Scenario, wind: &WindPath, solver: &Solver, times: &[f64]) -> Member {
    let mut next = 0;
    let mut positions = Vec::with_capacity(times.len());
    let mut stranding = None;
    let run = solver.follow(scenario.problem(wind), &mut |piece| {
        if let Some(coast) = &scenario.coast {
            stranding = coast.first_crossing(piece, scenario.sea.period())?;
        }
        let until = stranding.map_or(f64::INFINITY, |(t, _)| t);
        outputs(piece, times, &mut next, until, |t| {
            positions.push(piece.position(t)?);
            Ok(())
        })?;
        Ok(match stranding {
            Some(_) => ControlFlow::Break(()),
            None => ControlFlow::Continue(()),
        })
    });
    let (status, failure) = match run {
        Ok(_) if stranding.is_some() => (Status::Stranded, None),
        Ok(_) => (Status::Afloat, None),
        Err(DriftError::OutsideDomain { .. }) => (Status::LeftDomain, None),
        Err(error) => (Status::Failed, Some(error)),
    };
    Member { status, stranding, positions, failure }
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
    /// Given, one for each member.
    Given(&'a [&'a WindPath]),
}

impl Winds<'_> {
    fn path(
        &self,
        member: u64,
        end: f64,
        sampling: Sampling,
    ) -> Result<Cow<'_, WindPath>, DriftError> {
        match self {
            Self::Drawn { generator, seed } => {
                generator.path(*seed, member, end, sampling).map(Cow::Owned)
            }
            Self::Given(paths) => (paths.get(member as usize).map(|path| Cow::Borrowed(*path)))
                .ok_or_else(|| DriftError::invalid("member", member, "it has no wind path")),
        }
    }
}

/// Follows the members of a range, in the order of their indices, each under its own wind.
/// Members below `keep` record their positions at `times`.
pub fn run(
    scenario: &Scenario,
    winds: &Winds,
    solver: &Solver,
    members: std::ops::Range<u64>,
    times: &[f64],
    keep: u64,
) -> Vec<Member> {
    let sampling = match solver.model {
        Model::MeanFlow { order: 1 } => Sampling::Coarse,
        _ => Sampling::Fine,
    };
    let (_, end) = solver.wind_needed(scenario.duration, scenario.sea.period());
    members
        .into_par_iter()
        .map(|index| match winds.path(index, end, sampling) {
            Ok(path) => {
                let times = if index < keep { times } else { &[] };
                member(scenario, &path, solver, times)
            }
            Err(error) => Member {
                status: Status::Failed,
                stranding: None,
                positions: Vec::new(),
                failure: Some(error),
            },
        })
        .collect()
}
