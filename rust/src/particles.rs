//! Members that may be branched, and what is kept of them for branches to go on from.
//!
//! Their run has parts of equal length, about a tide each, and they may be branched between them.

use std::sync::OnceLock;

use crate::error::DriftError;
use crate::field::Vec2;
use crate::wind::lanes::LaneMark;
use crate::wind::{Lineage, numbered};

/// A member at a step of the common grid.
#[derive(Debug, Clone)]
pub(crate) struct Snapshot {
    /// The step that it is about to take, and its time.
    pub(crate) step: usize,
    pub(crate) time: f64,
    /// As of [`crate::model::lanes::State::place`].
    pub(crate) body: [Vec2; 2],
    pub(crate) wind: LaneMark,
}

/// Where a member is at the end of a part: its position (without the tidal oscillation, where the
/// model is an expansion and the member was not followed alone), `∫W`, and the wind at the last
/// synoptic step drawn.
pub type Seen = [Vec2; 3];

/// What following a particle leaves behind.
#[derive(Debug, Default)]
pub(crate) struct Trail {
    pub(crate) snapshots: Vec<Snapshot>,
    /// At the ends of the parts it was adrift at, from the place of the first of them on.
    pub(crate) seen: Vec<Seen>,
    pub(crate) first: usize,
    /// Steps it was followed for, as a share of those of a whole run.
    pub(crate) share: f64,
}

/// A member that may be branched. A branch has its parent's past: the random numbers up to a
/// synoptic step, so that it goes on from the last snapshot whose wind is drawn no further than
/// that. Without one it is followed from the release, which gives the same bits.
#[derive(Debug)]
pub struct Particle {
    lineage: Lineage,
    start: Option<Box<Snapshot>>,
    trail: OnceLock<Trail>,
}

impl Particle {
    /// A member that begins at the release.
    pub fn new(member: u64) -> Result<Self, DriftError> {
        numbered(member)?;
        Ok(Self { lineage: member.into(), start: None, trail: OnceLock::new() })
    }

    /// A branch that takes the random numbers of `member` from a synoptic step on.
    pub fn branched(&self, step: usize, member: u64) -> Result<Self, DriftError> {
        numbered(member)?;
        let mut lineage = self.lineage.clone();
        if let Some((last, _)) = lineage.branches.last().filter(|(last, _)| *last > step) {
            let accepted = format!("branches of a branch begin where it does, at {last}, or later");
            return Err(DriftError::invalid("branch step", step, accepted));
        }
        lineage.branches.push((step, member));
        let passed = self.trail.get().map_or(&[][..], |trail| &trail.snapshots);
        let start = (self.start.as_deref().into_iter().chain(passed).rev())
            .find(|snapshot| snapshot.wind.known() <= step)
            .map(|snapshot| Box::new(snapshot.clone()));
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
    pub(crate) fn leave(&self, trail: Trail) {
        self.trail.get_or_init(|| trail);
    }

    /// Steps that it was followed for, as a share of those of a whole run.
    pub fn share(&self) -> f64 {
        self.trail.get().map_or(1.0, |trail| trail.share)
    }

    /// Where it was at the ends of parts, from the place of the first of them on.
    pub fn seen(&self) -> (usize, &[Seen]) {
        self.trail.get().map_or((0, &[]), |trail| (trail.first, &trail.seen))
    }
}
