//! What is written down of one member while it is followed: where it was, what it met.

use std::ops::ControlFlow;

use crate::coast::Coast;
use crate::ensemble::{Member, Status};
use crate::error::DriftError;
use crate::field::Vec2;
use crate::model::{Piece, Reach};
use crate::statistics::Maps;

/// What the members of an ensemble are observed for, beside where they strand.
#[derive(Clone, Copy, Default)]
pub struct Observed<'a> {
    /// Output times, and the number of members, from the first on, that keep their positions there.
    pub outputs: (&'a [f64], u64),
    /// Maps on which they are counted.
    pub maps: Option<&'a Maps>,
    /// Shapes whose first entry is written down; entering stops nobody.
    pub targets: &'a [&'a Coast],
}

impl<'a> Observed<'a> {
    /// Whether positions of a member are asked for.
    pub fn watches(&self, member: u64) -> bool {
        member < self.outputs.1 || self.maps.is_some()
    }

    /// The logbook of a member released at `start`; the coast comes with the tide's period.
    pub fn log(
        &self,
        member: u64,
        (coast, period): (Option<&'a Coast>, f64),
        start: f64,
    ) -> Logbook<'a> {
        let outputs = if member < self.outputs.1 { self.outputs.0 } else { &[] };
        let samples = self.maps.map_or(&[][..], |maps| maps.grid().samples());
        // Before the release there is no position.
        let places = |times: &[f64]| {
            let mut places = Vec::with_capacity(times.len());
            places.resize(times.partition_point(|t| *t < start), Vec2::repeat(f64::NAN));
            places
        };
        Logbook {
            coast,
            period,
            targets: self.targets,
            outputs,
            samples,
            stranding: None,
            positions: places(outputs),
            track: places(samples),
            entries: vec![f64::NAN; self.targets.len()],
            safe: (None, vec![None; self.targets.len()]),
        }
    }

    /// Counts a member on the maps, and frees its track.
    pub fn count(&self, member: &mut Member) {
        if let Some(maps) = self.maps {
            maps.count(member);
            member.track = Vec::new();
        }
    }
}

/// Where a clearance was found last, and how large.
type Safe = Option<(Vec2, f64)>;

/// The logbook of one member.
pub struct Logbook<'a> {
    coast: Option<&'a Coast>,
    period: f64,
    targets: &'a [&'a Coast],
    outputs: &'a [f64],
    samples: &'a [f64],
    stranding: Option<(f64, Vec2)>,
    positions: Vec<Vec2>,
    track: Vec<Vec2>,
    /// First entry of each target, NaN before.
    entries: Vec<f64>,
    /// Of the coast and the targets.
    safe: (Safe, Vec<Safe>),
}

impl Logbook<'_> {
    /// Whether a position is to be written down at `t` or before.
    pub fn is_due(&self, t: f64) -> bool {
        let due = |times: &[f64], done: usize| times.get(done).is_some_and(|next| *next <= t);
        due(self.outputs, self.positions.len()) || due(self.samples, self.track.len())
    }

    /// Whether the coast, or a target not entered yet, may be met within `reach`.
    pub fn is_near(&mut self, reach: &Reach) -> bool {
        let (safe, safe_targets) = &mut self.safe;
        let mut near = self.coast.is_some_and(|coast| !clear(coast, reach, safe));
        for ((target, entry), safe) in self.targets.iter().zip(&self.entries).zip(safe_targets) {
            near = near || entry.is_nan() && !clear(target, reach, safe);
        }
        near
    }

    /// Writes down what a piece of trajectory tells; with `near`, looks for the coast and targets.
    /// Breaks where the member strands.
    pub fn look(&mut self, piece: &dyn Piece, near: bool) -> Result<ControlFlow<()>, DriftError> {
        let Self { coast, targets, period, outputs, samples, .. } = *self;
        if let Some(coast) = coast.filter(|_| near) {
            self.stranding = coast.first_crossing(piece, period)?;
        }
        let until = self.stranding.map_or(f64::INFINITY, |(t, _)| t);
        for (target, entry) in targets.iter().zip(&mut self.entries) {
            if near && entry.is_nan() {
                let entered = target.first_crossing(piece, period)?;
                *entry = entered.map_or(f64::NAN, |(t, _)| t);
                if *entry > until {
                    *entry = f64::NAN;
                }
            }
        }
        let end = piece.span().1.min(until);
        for (times, places) in [(outputs, &mut self.positions), (samples, &mut self.track)] {
            while let Some(t) = times.get(places.len()).filter(|t| **t <= end) {
                places.push(piece.position(*t)?);
            }
        }
        Ok(match self.stranding {
            Some(_) => ControlFlow::Break(()),
            None => ControlFlow::Continue(()),
        })
    }

    /// Closes the book: what the member came to, or what ended it.
    pub fn close(self, run: Result<(), DriftError>) -> Member {
        let Self { stranding, positions, track, entries, .. } = self;
        let status = match run {
            Ok(()) if stranding.is_some() => Status::Stranded,
            Ok(()) => Status::Afloat,
            Err(DriftError::OutsideDomain { .. }) => Status::LeftDomain,
            Err(error) => return Member { positions, ..Member::failed(error) },
        };
        Member { status, stranding, positions, track, entries, failure: None }
    }
}

/// Whether a coast is out of reach. A clearance changes by no more than the distance moved, so
/// the one found last (`safe`: where, and how large) often tells without looking again.
fn clear(coast: &Coast, reach: &Reach, safe: &mut Safe) -> bool {
    if safe.is_some_and(|(x, clearance)| clearance - (reach.center - x).norm() > reach.radius) {
        return true;
    }
    let clearance = coast.clearance(reach.center);
    *safe = Some((reach.center, clearance));
    clearance > reach.radius
}
