//! Ensembles of bodies of any kind, each with its own release, on the plane or the sphere.

use std::sync::Arc;

use rayon::prelude::*;

use crate::coast::Coast;
use crate::ensemble::{MOST_TIDES, Member, Trajectory, Winds, member, trajectory};
use crate::error::{DriftError, finite};
use crate::field::SeaField;
use crate::geometry::Geometry;
use crate::logbook::{Logbook, Watch};
use crate::model::body::{Body, Drift, Release};
use crate::model::{Model, Solver};
use crate::statistics::Maps;
use crate::wind::{MOST_MEMBERS, Sampling, Wind, jibes};

/// Bodies adrift in one sea: member `first + k` is body and release `k`, or the only one.
pub struct Fleet {
    /// The sea; its velocities are rates of the coordinates.
    pub sea: Arc<dyn SeaField>,
    /// The coast, if there is one.
    pub coast: Option<Coast>,
    /// The coordinates.
    pub geometry: Geometry,
    /// End of the run.
    pub end: f64,
    /// Index of the first member that the lists below are about.
    pub first: u64,
    /// Releases.
    pub releases: Vec<Release>,
    /// Bodies.
    pub bodies: Vec<Body>,
    /// Jibes in a unit of time, on average.
    pub jibing_rate: f64,
    /// Names the jibes, with the member.
    pub seed: u64,
}

/// Share of a run below which a response time counts as none: steps are explicit, so that they would
/// be as short, and what is left out is the way of a body in that time.
const INSTANT: f64 = 1e-6;
/// Each jibe is a corner that a step ends at.
const MOST_JIBES: f64 = 1e7;

impl Fleet {
    /// Fails unless every body and release makes sense.
    pub fn validated(mut self) -> Result<Self, DriftError> {
        let lists = [("releases", self.releases.len()), ("bodies", self.bodies.len())];
        if let Some((name, _)) = lists.into_iter().find(|(_, len)| *len == 0) {
            return Err(DriftError::invalid(name, "an empty list", "there must be one at least"));
        }
        if self.first >= MOST_MEMBERS {
            return Err(DriftError::invalid("first", self.first, "members are numbered to 2⁶²"));
        }
        finite("jibing rate", &[self.jibing_rate])?;
        if self.jibing_rate * self.end > MOST_JIBES {
            let accepted = format!("a run has at most {MOST_JIBES} jibes on average");
            return Err(DriftError::invalid("jibing rate", self.jibing_rate, accepted));
        }
        if self.end / self.sea.period() > MOST_TIDES {
            let accepted = format!("a run has at most {MOST_TIDES} tides");
            return Err(DriftError::invalid("end", self.end, accepted));
        }
        let sound = |values: &[f64]| values.iter().all(|value| value.is_finite());
        for Release { time, position, velocity } in &self.releases {
            let velocity = velocity.unwrap_or_default();
            if !sound(&[*time, position.x, position.y, velocity.x, velocity.y]) {
                return Err(DriftError::invalid("release", position, "it must be finite"));
            }
            if *time < 0.0 || *time >= self.end {
                return Err(DriftError::invalid("release time", time, "it must lie in the run"));
            }
        }
        for body in &self.bodies {
            let Body { response, slip, downwind, crosswind, jibed, surface_current } = body;
            let lines = [downwind, crosswind, jibed].map(|line| line.slope + line.offset);
            if !(sound(&lines) && sound(surface_current) && sound(&[*response, *slip])) {
                return Err(DriftError::invalid("body", format!("{body:?}"), "it must be finite"));
            }
            if *response < 0.0 || *slip < 0.0 {
                let accepted = "response time and slip must not be below 0";
                return Err(DriftError::invalid("body", format!("{body:?}"), accepted));
            }
        }
        for body in &mut self.bodies {
            if body.response < INSTANT * self.end {
                body.response = 0.0;
            }
        }
        Ok(self)
    }

    fn drift<'a>(&'a self, index: u64, wind: &'a dyn Wind, jibes: &'a [f64]) -> Drift<'a> {
        let of = |len: usize| index.saturating_sub(self.first) as usize % len;
        Drift {
            sea: self.sea.as_ref(),
            wind,
            geometry: self.geometry,
            body: self.bodies[of(self.bodies.len())],
            release: self.releases[of(self.releases.len())],
            end: self.end,
            jibes,
        }
    }

    fn jibes(&self, index: u64) -> Vec<f64> {
        jibes(self.seed, index, self.jibing_rate, self.end)
    }

    /// Follows the first body through the whole run, whatever coast there is.
    pub fn trajectory(
        &self,
        winds: &Winds,
        solver: &Solver,
        times: &[f64],
    ) -> Result<Trajectory, DriftError> {
        let wind = winds.wind(self.first, self.end, sampling(solver))?;
        let jibes = self.jibes(self.first);
        let drift = self.drift(self.first, wind.as_ref(), &jibes);
        let early = times.partition_point(|t| *t < drift.release.time);
        if early > 0 {
            let accepted = format!("the release is at {}", drift.release.time);
            return Err(DriftError::invalid("times", times[0], accepted));
        }
        trajectory(times, |on_piece| drift.follow(solver, on_piece))
    }

    /// Follows members in parallel, in the order of their indices.
    pub fn follow(
        &self,
        winds: &Winds,
        solver: &Solver,
        watched: Watched,
        members: std::ops::Range<u64>,
    ) -> Vec<Member> {
        let sampling = sampling(solver);
        let Watched { outputs, keep, maps, targets } = watched;
        members
            .into_par_iter()
            .map(|index| {
                let watch = Watch {
                    coast: self.coast.as_ref(),
                    targets,
                    period: self.sea.period(),
                    outputs: if index < keep { outputs } else { &[] },
                    samples: maps.map_or(&[], |maps| maps.grid().samples()),
                };
                let jibes = self.jibes(index);
                let followed = winds.wind(index, self.end, sampling).map(|wind| {
                    let drift = self.drift(index, wind.as_ref(), &jibes);
                    let log = Logbook::from_release(watch, drift.release.time);
                    member(log, |on_piece| drift.follow(solver, on_piece))
                });
                let mut member =
                    followed.unwrap_or_else(|error| Logbook::new(watch).close(Err(error)));
                if let Some(maps) = maps {
                    maps.count(&member);
                    member.track = Vec::new();
                }
                member
            })
            .collect()
    }
}

/// How finely a model needs the wind.
fn sampling(solver: &Solver) -> Sampling {
    match solver.model {
        Model::MeanFlow { .. } => Sampling::Coarse,
        _ => Sampling::Fine,
    }
}

/// What members are watched for beside the coast.
#[derive(Clone, Copy)]
pub struct Watched<'a> {
    /// Output times of the kept members.
    pub outputs: &'a [f64],
    /// How many members are kept, from the first of the run on.
    pub keep: u64,
    /// Maps that the members are counted into.
    pub maps: Option<&'a Maps>,
    /// Shapes whose first entry is written down.
    pub targets: &'a [&'a Coast],
}

#[cfg(test)]
mod tests {
    use crate::field::Vec2;
    use crate::field::gridded::{Axis, GriddedSea, Tide};
    use crate::model::body::Line;
    use crate::wind::path::WindPath;

    use super::*;

    fn fleet() -> Result<Fleet, DriftError> {
        let axis = Axis { start: 0.0, step: 1.0, count: 1 };
        let still = GriddedSea::new(0.1, [axis; 3], Tide::Harmonics(0), 2, vec![0.0.into(); 2])?;
        let release = Release { time: 0.25, position: Vec2::zeros(), velocity: None };
        Ok(Fleet {
            sea: Arc::new(still),
            coast: None,
            geometry: Geometry::Plane,
            end: 1.0,
            first: 10,
            releases: vec![release, Release { time: 0.5, ..release }],
            bodies: vec![Body { downwind: Line { slope: 1.0, offset: 0.0 }, ..Body::default() }],
            jibing_rate: 0.0,
            seed: 1,
        })
    }

    fn refused(change: impl FnOnce(&mut Fleet)) -> Result<String, DriftError> {
        let mut fleet = fleet()?;
        change(&mut fleet);
        Ok(fleet.validated().err().map_or_else(String::new, |error| error.to_string()))
    }

    #[test]
    fn what_makes_no_sense_is_refused_by_name() -> Result<(), DriftError> {
        assert!(fleet()?.validated().is_ok());
        assert!(refused(|f| f.releases.clear())?.starts_with("releases: an empty list"));
        assert!(refused(|f| f.bodies.clear())?.starts_with("bodies: an empty list"));
        let release = "must lie in the run";
        for time in [-0.1, 1.0, 2.0] {
            assert!(refused(|f| f.releases[1].time = time)?.contains(release), "{time}");
        }
        for bad in [f64::NAN, f64::INFINITY] {
            let finite = "must be finite";
            assert!(refused(|f| f.releases[0].time = bad)?.contains(finite));
            assert!(refused(|f| f.releases[1].position.y = bad)?.contains(finite));
            let velocity = Some(Vec2::new(bad, 0.0));
            assert!(refused(|f| f.releases[1].velocity = velocity)?.contains(finite));
            assert!(refused(|f| f.bodies[0].response = bad)?.contains(finite));
            assert!(refused(|f| f.bodies[0].slip = bad)?.contains(finite));
            assert!(refused(|f| f.bodies[0].downwind.slope = bad)?.contains(finite));
            assert!(refused(|f| f.bodies[0].crosswind.offset = bad)?.contains(finite));
            assert!(refused(|f| f.bodies[0].jibed.slope = bad)?.contains(finite));
            assert!(refused(|f| f.bodies[0].surface_current[1] = bad)?.contains(finite));
        }
        assert_eq!(refused(|f| f.releases[0].time = 0.0)?, "");
        assert_eq!(refused(|f| f.first = MOST_MEMBERS - 1)?, "");
        assert!(refused(|f| f.first = MOST_MEMBERS)?.contains("members are numbered to 2⁶²"));
        // A run of length 1, of ten tides.
        assert_eq!(refused(|f| f.jibing_rate = MOST_JIBES)?, "");
        assert!(refused(|f| f.jibing_rate = 1.001 * MOST_JIBES)?.contains("10000000 jibes"));
        assert!(refused(|f| f.jibing_rate = f64::NAN)?.starts_with("jibing rate: NaN"));
        assert_eq!(refused(|f| f.end = 0.1 * MOST_TIDES)?, "");
        assert!(refused(|f| f.end = 0.1001 * MOST_TIDES)?.contains("at most 1000000 tides"));
        assert!(refused(|f| f.bodies[0].response = -1e-9)?.contains("must not be below 0"));
        assert!(refused(|f| f.bodies[0].slip = -1e-9)?.contains("must not be below 0"));
        Ok(())
    }

    /// Of a run of length 1: steps as short as the response would be too many.
    #[test]
    fn a_response_that_is_hardly_any_is_none() -> Result<(), DriftError> {
        for (given, kept) in [(0.99e-6, 0.0), (1.01e-6, 1.01e-6), (0.5, 0.5)] {
            let mut fleet = fleet()?;
            fleet.bodies[0].response = given;
            assert_eq!(fleet.validated()?.bodies[0].response, kept);
        }
        Ok(())
    }

    /// Members count from `first`, take releases in turn, and are nowhere before their own.
    #[test]
    fn members_have_releases_of_their_own() -> Result<(), DriftError> {
        let fleet = fleet()?.validated()?;
        let wind = WindPath::new(vec![0.0, 1.0], vec![Vec2::new(2.0, 0.0); 2])?;
        let paths = [&wind; 13];
        let solver = Solver {
            model: Model::Full(crate::model::Formulation::A),
            rtol: 1e-9,
            atol: 1e-9,
            euler_step: None,
        };
        let outputs = [0.0, 0.25, 0.5, 1.0];
        let watched = Watched { outputs: &outputs, keep: 12, maps: None, targets: &[] };
        let members = fleet.follow(&Winds::Given(&paths), &solver, watched, 10..13);
        for (member, release) in members.iter().zip([0.25, 0.5, 0.25]) {
            for (x, t) in member.positions.iter().zip(outputs) {
                if t < release {
                    assert!(x.x.is_nan() && x.y.is_nan());
                } else {
                    assert!((x - Vec2::new(2.0 * (t - release), 0.0)).norm() < 1e-12);
                }
            }
        }
        // Only members below `keep` record where they are.
        let kept: Vec<_> = members.iter().map(|member| member.positions.len()).collect();
        assert_eq!(kept, [4, 4, 0]);
        let early = fleet.trajectory(&Winds::Given(&paths), &solver, &[0.2]);
        assert!(early.is_err_and(|error| error.to_string().contains("the release is at 0.25")));
        Ok(())
    }
}
