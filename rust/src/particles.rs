//! Members that may be branched, and what is kept of them for branches to go on from.

use std::sync::{Arc, OnceLock};

use crate::error::DriftError;
use crate::field::Vec2;
use crate::wind::Lineage;
use crate::wind::lanes::LaneMark;

/// A member at a step of the common grid.
#[derive(Debug)]
pub(crate) struct Snapshot {
    /// The step that it is about to take, and its time.
    pub(crate) step: usize,
    pub(crate) time: f64,
    /// As of [`crate::model::lanes::State::place`].
    pub(crate) body: [Vec2; 2],
    pub(crate) wind: LaneMark,
}

/// What following a particle left behind.
#[derive(Debug)]
struct Trail {
    snapshots: Vec<Arc<Snapshot>>,
    share: f64,
}

/// A member that may be branched. A branch has its parent's past: the random numbers up to a
/// synoptic step, so that it goes on from the last snapshot whose wind is drawn no further than
/// that. Without one it is followed from the release, which gives the same bits.
#[derive(Debug)]
pub struct Particle {
    lineage: Lineage,
    start: Option<Arc<Snapshot>>,
    trail: OnceLock<Trail>,
}

impl From<u64> for Particle {
    fn from(member: u64) -> Self {
        Self { lineage: member.into(), start: None, trail: OnceLock::new() }
    }
}

impl Particle {
    /// A branch that takes the random numbers of `member` from a synoptic step on.
    pub fn branched(&self, step: usize, member: u64) -> Result<Self, DriftError> {
        let mut lineage = self.lineage.clone();
        if let Some((last, _)) = lineage.branches.last().filter(|(last, _)| *last > step) {
            let accepted = format!("branches of a branch begin where it does, at {last}, or later");
            return Err(DriftError::invalid("branch step", step, accepted));
        }
        lineage.branches.push((step, member));
        let passed = self.trail.get().map_or(&[][..], |trail| &trail.snapshots);
        let start = (self.start.iter().chain(passed).rev())
            .find(|snapshot| snapshot.wind.known() <= step)
            .cloned();
        Ok(Self { lineage, start, trail: OnceLock::new() })
    }

    /// Whose random numbers its wind is drawn from.
    pub(crate) fn lineage(&self) -> &Lineage {
        &self.lineage
    }

    /// Where it begins; none at the release.
    pub(crate) fn start(&self) -> Option<&Snapshot> {
        self.start.as_deref()
    }

    /// Keeps what following it left behind; a second time leaves the same.
    pub(crate) fn leave(&self, snapshots: Vec<Arc<Snapshot>>, share: f64) {
        self.trail.get_or_init(|| Trail { snapshots, share });
    }

    /// Steps that it was followed for, as a share of those of a whole run.
    pub fn share(&self) -> f64 {
        self.trail.get().map_or(1.0, |trail| trail.share)
    }
}
