//! driftcore: where will something adrift on the sea be, weeks to months ahead?
//!
//! A floating body at `X`, with velocity `V`, in a sea of velocity `m` under a wind `W` moves by
//!
//! ```text
//! dX/dt = V,    dV/dt = d/dt[m(t, X)] + Λ(W − V)
//! ```
//!
//! (Ailliot, Frénod & Monbet 2006). The tide makes `m` oscillate some two hundred times in three
//! months; averaging removes the oscillation from what is integrated and puts it back where it is
//! needed: at a coast, or at an output time. Numbered equations stand in `docs/equations.md`.
//!
//! | module | what it is |
//! | --- | --- |
//! | [`field`] | velocity of the sea, as such and by its tidal harmonics |
//! | [`wind`] | resampled winds and their exact integrals |
//! | [`dopri5`] | adaptive Dormand–Prince stepping with dense output |
//! | [`model`] | the full system, the paper's averaged system, the mean-flow expansion |
//! | [`coast`] | first crossing of a trajectory with a coast |
//! | [`geometry`] | plane and sphere |
//! | [`lanes`] | numbers of several members side by side, for vector instructions |
//! | [`logbook`] | what is written down of one member |
//! | [`ensemble`] | members followed in parallel: the paper's body |
//! | [`fleet`] | the same for bodies of any kind, each with its own release |
//! | [`statistics`] | maps counted meanwhile |

pub mod coast;
pub mod dopri5;
pub mod ensemble;
pub mod error;
pub mod field;
pub mod fleet;
pub mod geometry;
pub mod lanes;
pub mod logbook;
pub mod model;
pub mod particles;
#[cfg(feature = "python")]
mod python;
pub mod statistics;
pub mod wind;
