//! What is written down of one member while it is followed: where it was, what it met.

use std::ops::ControlFlow;

use crate::coast::Coast;
use crate::ensemble::{Member, Status};
use crate::error::DriftError;
use crate::field::Vec2;
use crate::model::{Piece, Reach};

/// What a member is watched for.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    /// The coast, where it strands.
    pub coast: Option<&'a Coast>,
    /// Shapes whose first entry is written down; entering stops nobody.
    pub targets: &'a [&'a Coast],
    /// Tide period.
    pub period: f64,
    /// Output times.
    pub outputs: &'a [f64],
    /// Times at which the track is sampled.
    pub samples: &'a [f64],
}

/// Where a clearance was found last, and how large.
type Safe = Option<(Vec2, f64)>;

/// The logbook of one member.
pub struct Logbook<'a> {
    watch: Watch<'a>,
    stranding: Option<(f64, Vec2)>,
    positions: Vec<Vec2>,
    track: Vec<Vec2>,
    /// First entry of each target, NaN before.
    entries: Vec<f64>,
    /// Of the coast and the targets.
    safe: (Safe, Vec<Safe>),
}

impl<'a> Logbook<'a> {
    /// Nothing written yet.
    pub fn new(watch: Watch<'a>) -> Self {
        Self {
            watch,
            stranding: None,
            positions: Vec::with_capacity(watch.outputs.len()),
            track: Vec::with_capacity(watch.samples.len()),
            entries: vec![f64::NAN; watch.targets.len()],
            safe: (None, vec![None; watch.targets.len()]),
        }
    }

    /// That of a member who is nowhere before its release.
    pub fn from_release(watch: Watch<'a>, time: f64) -> Self {
        let mut log = Self::new(watch);
        let nowhere = Vec2::repeat(f64::NAN);
        log.positions.resize(watch.outputs.partition_point(|t| *t < time), nowhere);
        log.track.resize(watch.samples.partition_point(|t| *t < time), nowhere);
        log
    }

    /// Whether a position is to be written down at `t` or before.
    pub fn is_due(&self, t: f64) -> bool {
        let due = |times: &[f64], done: usize| times.get(done).is_some_and(|next| *next <= t);
        due(self.watch.outputs, self.positions.len()) || due(self.watch.samples, self.track.len())
    }

    /// Whether the coast, or a target not entered yet, may be met within `reach`.
    pub fn is_near(&mut self, reach: &Reach) -> bool {
        let (safe, safe_targets) = &mut self.safe;
        let mut near = self.watch.coast.is_some_and(|coast| !clear(coast, reach, safe));
        for ((target, entry), safe) in
            self.watch.targets.iter().zip(&self.entries).zip(safe_targets)
        {
            near = near || entry.is_nan() && !clear(target, reach, safe);
        }
        near
    }

    /// Writes down what a piece of trajectory tells; with `near`, looks for the coast and targets.
    /// Breaks where the member strands.
    pub fn look(&mut self, piece: &dyn Piece, near: bool) -> Result<ControlFlow<()>, DriftError> {
        let Watch { coast, targets, period, outputs, samples } = self.watch;
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
                let x = piece.position(*t)?;
                if !(x.x.is_finite() && x.y.is_finite()) {
                    let reason = "the state is not finite";
                    return Err(DriftError::Integration { t: *t, reason });
                }
                places.push(x);
            }
        }
        Ok(match self.stranding {
            Some(_) => ControlFlow::Break(()),
            None => ControlFlow::Continue(()),
        })
    }

    /// Closes the book: what the member came to, or what ended it.
    pub fn close(self, run: Result<(), DriftError>) -> Member {
        let Self { stranding, positions, track, mut entries, .. } = self;
        let (status, failure) = match run {
            Ok(()) if stranding.is_some() => (Status::Stranded, None),
            Ok(()) => (Status::Afloat, None),
            Err(DriftError::OutsideDomain { .. }) => (Status::LeftDomain, None),
            Err(error) => (Status::Failed, Some(error)),
        };
        if status == Status::Failed {
            entries.fill(f64::NAN);
        }
        Member { status, stranding, positions, track, entries, failure }
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

#[cfg(test)]
mod tests {
    use crate::coast::Side;

    use super::*;

    const TIMES: [f64; 3] = [0.0, 0.5, 1.0];

    fn watch<'a>(targets: &'a [&'a Coast], outputs: &'a [f64], samples: &'a [f64]) -> Watch<'a> {
        Watch { coast: None, targets, period: 0.1, outputs, samples }
    }

    #[test]
    fn before_its_release_a_member_is_nowhere() {
        for (time, before) in [(0.0, 0), (0.2, 1), (0.5, 1), (0.6, 2), (2.0, 3)] {
            let log = Logbook::from_release(watch(&[], &TIMES, &TIMES[1..]), time);
            assert_eq!(log.positions.len(), before);
            assert_eq!(log.track.len(), before.saturating_sub(1));
            assert!(log.positions.iter().chain(&log.track).all(|x| x.x.is_nan() && x.y.is_nan()));
        }
    }

    #[test]
    fn a_time_is_due_once_it_has_come() {
        for (outputs, samples) in [(&TIMES[1..], &[][..]), (&[], &TIMES[1..])] {
            let log = Logbook::new(watch(&[], outputs, samples));
            assert_eq!([0.4, 0.5, 0.6].map(|t| log.is_due(t)), [false, true, true]);
        }
        assert!(!Logbook::new(watch(&[], &[], &[])).is_due(9.0));
    }

    #[test]
    fn a_target_is_near_until_it_is_entered() -> Result<(), DriftError> {
        let target = Coast::circle(Vec2::zeros(), 1.0, Side::Outside)?;
        let targets = [&target];
        let mut log = Logbook::new(watch(&targets, &[], &[]));
        let around = |x: f64| Reach { center: Vec2::new(x, 0.0), radius: 0.5, speed: 1.0 };
        assert_eq!(
            [3.0, 1.6, 1.4, 3.0].map(|x| log.is_near(&around(x))),
            [false, false, true, false]
        );
        log.entries[0] = 0.3;
        assert!(!log.is_near(&around(1.4)));
        Ok(())
    }

    /// Straight on along the first axis, from `from` at time 0.
    struct Straight {
        from: f64,
    }

    impl Piece for Straight {
        fn span(&self) -> (f64, f64) {
            (0.0, 4.0)
        }
        fn position(&self, t: f64) -> Result<Vec2, DriftError> {
            Ok(Vec2::new(self.from + t, 0.0))
        }
        fn velocity(&self, _: f64) -> Result<Vec2, DriftError> {
            Ok(Vec2::new(1.0, 0.0))
        }
        fn mean(&self, _: f64) -> Result<Option<(Vec2, Vec2)>, DriftError> {
            Ok(None)
        }
        fn reach(&self) -> Reach {
            Reach { center: Vec2::new(self.from + 2.0, 0.0), radius: 2.0, speed: 1.0 }
        }
    }

    /// Ashore at 2; a target is met at 1, another would have been at 3.
    #[test]
    fn who_has_stranded_enters_nothing_and_is_nowhere() -> Result<(), DriftError> {
        let disc = |x: f64| Coast::circle(Vec2::new(x, 0.0), 0.5, Side::Outside);
        let (shore, early, late) = (disc(2.5)?, disc(1.5)?, disc(3.5)?);
        let targets = [&early, &late];
        let times = [1.5, 2.5];
        let watch = Watch { coast: Some(&shore), ..watch(&targets, &times, &times) };
        let mut log = Logbook::new(watch);
        assert_eq!(log.look(&Straight { from: 0.0 }, true)?, ControlFlow::Break(()));
        let member = log.close(Ok(()));
        assert_eq!(member.status, Status::Stranded);
        assert!(member.stranding.is_some_and(|(t, x)| (t - 2.0).abs() + (x.x - 2.0).abs() < 1e-12));
        assert_eq!(member.positions, [Vec2::new(1.5, 0.0)]);
        assert_eq!(member.track, member.positions);
        assert!((member.entries[0] - 1.0).abs() < 1e-12 && member.entries[1].is_nan());
        Ok(())
    }

    #[test]
    fn a_place_that_is_none_is_a_failure() {
        let mut log = Logbook::new(watch(&[], &TIMES, &[]));
        let lost = log.look(&Straight { from: f64::NAN }, false);
        assert!(lost.is_err_and(|error| error.to_string().contains("the state is not finite")));
    }
}
