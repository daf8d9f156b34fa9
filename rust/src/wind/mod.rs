//! Wind paths for the members of an ensemble: a resampled synoptic part and a small-scale part.
//!
//! One (seed, member) is one wind, whatever model asks for it and however finely: the synoptic
//! states, the small scale at the synoptic steps and its fine path are three separate random
//! streams, each read in the order of time.

pub mod bootstrap;
pub mod path;
pub mod small_scale;

use std::sync::Arc;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::error::{DriftError, positive};
use crate::field::Vec2;
use bootstrap::Bootstrap;
use path::WindPath;
use small_scale::SmallScale;

/// What a random stream is used for.
#[derive(Debug, Clone, Copy)]
enum Stream {
    Synoptic = 0,
    SmallScale = 1,
    FinePath = 2,
}

/// Generator keyed by (seed, member, stream): no member's numbers depend on another's.
fn stream(seed: u64, member: u64, stream: Stream) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(4 * member + stream as u64);
    rng
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
    /// Record row whose successor gave each value, members × steps.
    pub predecessor: Vec<usize>,
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
    /// Phase of the mean cycle at the first step; any, if none is given.
    phase: Option<usize>,
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
        Ok(Self { bootstrap, small_scale, step, unit, lead_in, phase })
    }

    /// The path of one member from `−lead_in` steps to `end`.
    pub fn path(
        &self,
        seed: u64,
        member: u64,
        end: f64,
        sampling: Sampling,
    ) -> Result<WindPath, DriftError> {
        let steps = self.lead_in + (end / self.step - 1e-9).ceil().max(1.0) as usize;
        let mut synoptic = stream(seed, member, Stream::Synoptic);
        let mut coarse = stream(seed, member, Stream::SmallScale);
        let mut fine = stream(seed, member, Stream::FinePath);
        let start = -(self.lead_in as f64) * self.step;

        let mut chain = self.bootstrap.start(self.phase, &mut synoptic)?;
        let mut slow = self.bootstrap.wind(&chain) / self.unit;
        let mut fast = self.small_scale.start(&mut coarse);
        let substeps = match sampling {
            Sampling::Coarse => 1,
            Sampling::Fine => self.small_scale.substeps(),
        };
        let mut velocity = Vec::with_capacity(steps * substeps + 1);
        let mut integrals = Vec::with_capacity(steps);
        let mut inside = Vec::with_capacity(substeps);
        for _ in 0..steps {
            velocity.push(slow + fast);
            self.bootstrap.advance(&mut chain, &mut synoptic);
            let slow_next = self.bootstrap.wind(&chain) / self.unit;
            let (fast_next, fast_integral) = self.small_scale.advance(fast, &mut coarse);
            match sampling {
                Sampling::Coarse => {
                    integrals.push((slow + slow_next) * (self.step / 2.0) + fast_integral);
                }
                Sampling::Fine => {
                    inside.clear();
                    self.small_scale.fill(fast, (fast_next, fast_integral), &mut fine, &mut inside);
                    velocity.extend(
                        inside.iter().enumerate().map(|(k, w)| {
                            w + slow.lerp(&slow_next, (k + 1) as f64 / substeps as f64)
                        }),
                    );
                }
            }
            (slow, fast) = (slow_next, fast_next);
        }
        velocity.push(slow + fast);
        match sampling {
            Sampling::Coarse => WindPath::from_coarse(start, self.step, velocity, &integrals),
            Sampling::Fine => {
                let fine_step = self.step / substeps as f64;
                let times = (0..velocity.len()).map(|k| start + k as f64 * fine_step).collect();
                WindPath::new(times, velocity)
            }
        }
    }
}

/// The synoptic part alone, in m/s: what [`WindGenerator::path`] draws for these members.
pub fn sample(
    bootstrap: &Bootstrap,
    seed: u64,
    members: std::ops::Range<u64>,
    steps: usize,
    phase: Option<usize>,
) -> Result<SynopticSample, DriftError> {
    let mut sample = SynopticSample::default();
    for member in members {
        let mut rng = stream(seed, member, Stream::Synoptic);
        let mut chain = bootstrap.start(phase, &mut rng)?;
        for step in 0..steps {
            if step > 0 {
                bootstrap.advance(&mut chain, &mut rng);
            }
            sample.wind.push(bootstrap.wind(&chain));
            sample.predecessor.push(chain.predecessor());
        }
    }
    Ok(sample)
}
