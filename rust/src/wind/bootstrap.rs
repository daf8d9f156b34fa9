//! Local Grid Bootstrap of a wind record: Monbet & Marteau (2006); docs/equations.md (18)–(20).
//!
//! The catalogue holds one row per state of the record that has a successor. Given the present
//! state `z*` (whitened), a row `J` is drawn with weight `exp(−|z* − z_J|²/2h²)`, and
//! `next = c + A y* + target_J + B ξ`: with `A = 0`, `target` the successor and `B = bL` this is
//! the paper's `lgb`; with `A` the least-squares predictor, `target` its standardised residual and
//! `B = 0` it is the residual bootstrap.
//!
//! The weights need not be computed for all rows. The state after row `J` lies close to the
//! state that followed `J` in the record (its *centre*), so a row is proposed from a table made
//! once for that centre at a wider bandwidth, and accepted with the ratio of the two kernels. The
//! ratio of two Gaussians is bounded in closed form, so the law is exactly that of the weights.
//! A table lists the heaviest rows one by one; all rows together carry the weight of the lightest
//! listed one once more, which covers those not listed.

use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use crate::error::{DriftError, positive};
use crate::field::Vec2;

/// Largest Markov order.
pub const MAX_ORDER: usize = 8;
const MAX_DIMENSION: usize = 2 * MAX_ORDER;
/// Square of the ratio of the proposal's bandwidth to the kernel's.
const WIDENING: f64 = 2.0;
/// Rows around the expected state among which a closer centre is looked for.
const SEARCHED: usize = 32;
/// Most rows that a proposal table lists one by one.
const MAX_LISTED: usize = 256;
/// Where the log of the acceptance bound exceeds this, or after so many trials, all rows are
/// weighed instead. A trial accepts by the law of the weights whatever went before it, so the law
/// stays exact.
const MAX_LOG_BOUND: f64 = 5.0;
const MAX_TRIALS: usize = 200;
/// A row whose weight relative to the nearest row's has a log below this counts as nothing.
const NEGLIGIBLE: f64 = -36.0;

/// Whitened or raw state; only the first `2·order` entries are used.
type State = [f64; MAX_DIMENSION];

/// The arrays of a fitted bootstrap, all row-major.
#[derive(Debug, Clone, Default)]
pub struct Catalogue {
    /// Markov order `p`.
    pub order: usize,
    /// States `(X_j, X_{j−1}, …)` [m/s], `n × 2p`.
    pub states: Vec<f64>,
    /// Whitening matrix, `2p × 2p`.
    pub whitening: Vec<f64>,
    /// `target_j`, `n × 2`.
    pub target: Vec<f64>,
    /// `[c, A]`, `2 × (2p + 1)`.
    pub predictor: Vec<f64>,
    /// `B`, `2 × 2`.
    pub noise: Vec<f64>,
    /// Row of the record that each state ends at.
    pub row: Vec<usize>,
    /// Phase of that row in the cycle.
    pub phase: Vec<usize>,
    /// Whether a simulation may start there.
    pub start: Vec<bool>,
    /// Mean cycle that was subtracted [m/s], `phases × 2`.
    pub cycle: Vec<f64>,
    /// Bandwidth `h` in whitened space.
    pub bandwidth: f64,
}

/// One slot of an alias table.
#[derive(Debug, Clone, Copy)]
struct Slot {
    threshold: f64,
    own: u32,
    other: u32,
}

/// Proposal for one centre: the heaviest rows, and an even tail over all rows that covers the
/// others.
#[derive(Debug, Clone)]
struct Proposal {
    slots: Vec<Slot>,
    /// Squared distance to the centre, and number, of the last row listed.
    cut: (f64, usize),
}

impl Chain {
    /// Row of the record whose successor gave the chain its present value.
    pub fn predecessor(&self) -> usize {
        self.predecessor
    }
}

/// Marks the tail in a [`Slot`].
const TAIL: u32 = u32::MAX;

/// The present state of a simulation.
#[derive(Debug, Clone)]
pub struct Chain {
    state: State,
    /// Row of the record whose successor gave the present value.
    predecessor: usize,
    /// The same row in the catalogue: the state is expected near its centre.
    near: Option<usize>,
    phase: usize,
}

/// A fitted bootstrap, ready to simulate.
#[derive(Debug, Clone)]
pub struct Bootstrap {
    catalogue: Catalogue,
    /// Whitened states, row by row; `columns` holds them component by component.
    whitened: Vec<f64>,
    columns: Vec<f64>,
    centers: Vec<f64>,
    proposals: Vec<Proposal>,
    starts: Vec<Vec<usize>>,
    /// For each catalogue row, the catalogue row just before it in the record, if there is one.
    predecessors: Vec<Option<usize>>,
}

impl Bootstrap {
    /// Checks the arrays and prepares the proposal tables.
    pub fn new(catalogue: Catalogue) -> Result<Self, DriftError> {
        let n = catalogue.row.len();
        let d = 2 * catalogue.order;
        if catalogue.order == 0 || catalogue.order > MAX_ORDER {
            return Err(DriftError::invalid(
                "order",
                catalogue.order,
                format!("it must be from 1 to {MAX_ORDER}"),
            ));
        }
        positive("bandwidth h", catalogue.bandwidth)?;
        let phases = catalogue.cycle.len() / 2;
        let lengths = [
            ("states", catalogue.states.len(), n * d),
            ("whitening", catalogue.whitening.len(), d * d),
            ("target", catalogue.target.len(), n * 2),
            ("predictor", catalogue.predictor.len(), 2 * (d + 1)),
            ("noise", catalogue.noise.len(), 4),
            ("phase", catalogue.phase.len(), n),
            ("start", catalogue.start.len(), n),
            ("cycle", catalogue.cycle.len(), 2 * phases.max(1)),
        ];
        for (field, length, expected) in lengths {
            if length != expected {
                return Err(DriftError::invalid(
                    field,
                    format!("{length} values"),
                    format!("{n} catalogue rows of order {} need {expected}", catalogue.order),
                ));
            }
        }
        let numbers = [
            ("states", &catalogue.states),
            ("whitening", &catalogue.whitening),
            ("target", &catalogue.target),
            ("predictor", &catalogue.predictor),
            ("noise", &catalogue.noise),
            ("cycle", &catalogue.cycle),
        ];
        for (field, values) in numbers {
            if let Some(bad) = values.iter().find(|value| !value.is_finite()) {
                return Err(DriftError::invalid(field, bad, "every value must be finite"));
            }
        }
        if let Some(bad) = catalogue.phase.iter().find(|phase| **phase >= phases) {
            return Err(DriftError::invalid(
                "phase",
                bad,
                format!("the cycle has {phases} phases"),
            ));
        }
        if n >= TAIL as usize || catalogue.row.windows(2).any(|pair| pair[0] >= pair[1]) {
            return Err(DriftError::invalid("row", n, "rows must increase, fewer than 2³² − 1"));
        }
        let mut starts = vec![Vec::new(); phases];
        for i in (0..n).filter(|i| catalogue.start[*i] && catalogue.row[*i] > 0) {
            starts[catalogue.phase[i]].push(i);
        }
        if starts.iter().all(Vec::is_empty) {
            return Err(DriftError::invalid("start", "no row", "at least one row must be a start"));
        }
        let predecessors = (0..n)
            .map(|i| i.checked_sub(1).filter(|j| catalogue.row[*j] + 1 == catalogue.row[i]))
            .collect();
        let mut bootstrap = Self {
            catalogue,
            predecessors,
            whitened: Vec::with_capacity(n * d),
            columns: Vec::with_capacity(n * d),
            centers: Vec::with_capacity(n * d),
            proposals: Vec::new(),
            starts,
        };
        for i in 0..n {
            let state = bootstrap.state(i);
            let next = bootstrap.next(&state, i, Vec2::zeros());
            let following = bootstrap.shifted(&state, next);
            let (here, center) = (bootstrap.whiten(&state), bootstrap.whiten(&following));
            bootstrap.whitened.extend(&here[..d]);
            bootstrap.centers.extend(&center[..d]);
        }
        for k in 0..d {
            bootstrap.columns.extend(bootstrap.whitened.iter().skip(k).step_by(d));
        }
        bootstrap.proposals = (0..n).into_par_iter().map(|i| bootstrap.proposal(i)).collect();
        Ok(bootstrap)
    }

    /// The fitted arrays.
    pub fn catalogue(&self) -> &Catalogue {
        &self.catalogue
    }

    /// Number of phases in the mean cycle.
    pub fn phases(&self) -> usize {
        self.starts.len()
    }

    fn dimension(&self) -> usize {
        2 * self.catalogue.order
    }

    fn state(&self, i: usize) -> State {
        let d = self.dimension();
        let mut state = [0.0; MAX_DIMENSION];
        state[..d].copy_from_slice(&self.catalogue.states[i * d..(i + 1) * d]);
        state
    }

    fn whiten(&self, state: &State) -> State {
        let d = self.dimension();
        let mut z = [0.0; MAX_DIMENSION];
        for (z, row) in z.iter_mut().zip(self.catalogue.whitening.chunks_exact(d)) {
            *z = row.iter().zip(state).map(|(a, y)| a * y).sum();
        }
        z
    }

    fn next(&self, state: &State, drawn: usize, noise: Vec2) -> Vec2 {
        let d = self.dimension();
        let b = &self.catalogue.noise;
        let component = |k: usize| {
            let row = &self.catalogue.predictor[k * (d + 1)..(k + 1) * (d + 1)];
            let predicted: f64 = row[1..].iter().zip(state).map(|(a, y)| a * y).sum();
            let noise = b[2 * k] * noise.x + b[2 * k + 1] * noise.y;
            row[0] + predicted + self.catalogue.target[2 * drawn + k] + noise
        };
        Vec2::new(component(0), component(1))
    }

    fn shifted(&self, state: &State, next: Vec2) -> State {
        let d = self.dimension();
        let mut shifted = [0.0; MAX_DIMENSION];
        shifted[2..d].copy_from_slice(&state[..d - 2]);
        shifted[..2].copy_from_slice(next.as_slice());
        shifted
    }

    fn distance2(&self, z: &[f64], i: usize) -> f64 {
        let d = self.dimension();
        let row = &self.whitened[i * d..(i + 1) * d];
        row.iter().zip(z).map(|(a, b)| (a - b) * (a - b)).sum()
    }

    /// Draws a row with weight `exp(−|z − z_i|²/2h²)` by weighing all of them.
    fn weigh_all<R: Rng>(&self, z: &[f64], rng: &mut R) -> usize {
        let n = self.catalogue.row.len();
        let mut weights = vec![0.0; n];
        for (column, z) in self.columns.chunks_exact(n).zip(z) {
            for (sum, place) in weights.iter_mut().zip(column) {
                *sum += (place - z) * (place - z);
            }
        }
        let nearest = weights.iter().copied().fold(f64::INFINITY, f64::min);
        let mut total = 0.0;
        for weight in &mut weights {
            let exponent = (nearest - *weight) / (2.0 * self.catalogue.bandwidth.powi(2));
            *weight = if exponent < NEGLIGIBLE { 0.0 } else { exponent.exp() };
            total += *weight;
        }
        let mut left = rng.random::<f64>() * total;
        let chosen = weights.iter().position(|weight| {
            left -= weight;
            left < 0.0
        });
        // Rounding may leave a trifle at the end: the last row with a weight takes it.
        chosen.or_else(|| weights.iter().rposition(|weight| *weight > 0.0)).unwrap_or(0)
    }

    fn center(&self, i: usize) -> &[f64] {
        let d = self.dimension();
        &self.centers[i * d..(i + 1) * d]
    }

    fn proposal(&self, near: usize) -> Proposal {
        let n = self.catalogue.row.len();
        let mut ranked: Vec<(f64, usize)> =
            (0..n).map(|i| (self.distance2(self.center(near), i), i)).collect();
        let last = MAX_LISTED.min(n) - 1;
        ranked.select_nth_unstable_by(last, closer);
        ranked.truncate(last + 1);
        ranked.sort_unstable_by(closer);
        let (cut, nearest) = (ranked[last], ranked[0].0);
        let weight = |distance2: f64| {
            ((nearest - distance2) / (2.0 * WIDENING * self.catalogue.bandwidth.powi(2))).exp()
        };
        let mut entries: Vec<(f64, u32)> =
            ranked.iter().map(|(distance2, i)| (weight(*distance2), *i as u32)).collect();
        entries.push((weight(cut.0) * n as f64, TAIL));
        Proposal { slots: alias_table(&entries), cut }
    }

    /// Proposes a row and its squared distance to the centre of `near`, in proportion to the
    /// widened kernel there; nothing where the tail proposes what it must not.
    fn propose<R: Rng>(&self, near: usize, rng: &mut R) -> Option<(usize, f64)> {
        let Proposal { slots, cut } = &self.proposals[near];
        let place = rng.random::<f64>() * slots.len() as f64;
        let slot = slots[place as usize];
        let drawn = if place.fract() < slot.threshold { slot.own } else { slot.other };
        if drawn != TAIL {
            return Some((drawn as usize, self.distance2(self.center(near), drawn as usize)));
        }
        let i = (rng.random::<f64>() * self.catalogue.row.len() as f64) as usize;
        let distance2 = self.distance2(self.center(near), i);
        let kept =
            ((cut.0 - distance2) / (2.0 * WIDENING * self.catalogue.bandwidth.powi(2))).exp();
        let listed = closer(&(distance2, i), cut).is_le();
        (!listed && rng.random::<f64>() < kept).then_some((i, distance2))
    }

    /// The centre closest to `z` among that of `near` and those that are rows around it, with the
    /// squared distance: the closer the centre, the fewer trials.
    fn closest_center(&self, near: usize, z: &State) -> (usize, f64) {
        let shift = |j: usize| self.center(j).iter().zip(z).map(|(a, b)| (a - b) * (a - b)).sum();
        let around = self.proposals[near].slots.iter().take(SEARCHED);
        let centers =
            around.filter_map(|slot| self.predecessors.get(slot.own as usize)?.to_owned());
        centers.map(|j| (j, shift(j))).fold((near, shift(near)), |best, candidate| {
            if candidate.1 < best.1 { candidate } else { best }
        })
    }

    /// Draws a row with weight `exp(−|z − z_i|²/2h²)`; `near` is the row drawn last, if any.
    fn draw<R: Rng>(&self, z: &State, near: Option<usize>, rng: &mut R) -> usize {
        let variance = self.catalogue.bandwidth.powi(2);
        let d = self.dimension();
        if let Some((near, shift)) = near.map(|near| self.closest_center(near, z)) {
            let log_bound = shift / (2.0 * (WIDENING - 1.0) * variance);
            if log_bound <= MAX_LOG_BOUND {
                for _ in 0..MAX_TRIALS {
                    let Some((i, distance2)) = self.propose(near, rng) else { continue };
                    let log_ratio = distance2 / (2.0 * WIDENING * variance)
                        - self.distance2(&z[..d], i) / (2.0 * variance);
                    if rng.random::<f64>() < (log_ratio - log_bound).exp() {
                        return i;
                    }
                }
            }
        }
        self.weigh_all(&z[..d], rng)
    }

    /// A chain at a random row of the record, of the given phase if one is given.
    pub fn start<R: Rng>(&self, phase: Option<usize>, rng: &mut R) -> Result<Chain, DriftError> {
        let count = match phase {
            Some(phase) => self.starts.get(phase).map_or(0, Vec::len),
            None => self.starts.iter().map(Vec::len).sum(),
        };
        if count == 0 {
            return Err(DriftError::invalid(
                "start phase",
                phase.map_or(String::from("any"), |phase| phase.to_string()),
                format!("the record has {} phases, each with rows of its own", self.phases()),
            ));
        }
        let mut place = (rng.random::<f64>() * count as f64) as usize;
        let phases = phase.map_or(0..self.phases(), |phase| phase..phase + 1);
        let mut chosen = 0;
        for rows in &self.starts[phases] {
            if let Some(row) = rows.get(place) {
                chosen = *row;
                break;
            }
            place -= rows.len();
        }
        let predecessor = self.catalogue.row[chosen] - 1;
        Ok(Chain {
            state: self.state(chosen),
            predecessor,
            near: self.predecessors[chosen],
            phase: self.catalogue.phase[chosen],
        })
    }

    /// Wind [m/s] of the chain's present state, mean cycle included.
    pub fn wind(&self, chain: &Chain) -> Vec2 {
        let mean = &self.catalogue.cycle[2 * chain.phase..2 * chain.phase + 2];
        Vec2::new(chain.state[0] + mean[0], chain.state[1] + mean[1])
    }

    /// Moves the chain by one step of the record.
    pub fn advance<R: Rng>(&self, chain: &mut Chain, rng: &mut R) {
        let drawn = self.draw(&self.whiten(&chain.state), chain.near, rng);
        let noise = if self.catalogue.noise.iter().all(|b| *b == 0.0) {
            Vec2::zeros()
        } else {
            Vec2::new(StandardNormal.sample(rng), StandardNormal.sample(rng))
        };
        let next = self.next(&chain.state, drawn, noise);
        chain.state = self.shifted(&chain.state, next);
        chain.predecessor = self.catalogue.row[drawn];
        chain.near = Some(drawn);
        chain.phase = (chain.phase + 1) % self.phases();
    }

    /// `count` independent draws of a record row at a fixed state, from the proposal of the row
    /// `near` or, without it, from the weights of all rows: shows that both have one law.
    pub fn draws_at<R: Rng>(
        &self,
        state: &[f64],
        near: Option<usize>,
        count: usize,
        rng: &mut R,
    ) -> Result<Vec<usize>, DriftError> {
        let d = self.dimension();
        if state.len() != d || near.is_some_and(|near| near >= self.catalogue.row.len()) {
            return Err(DriftError::invalid(
                "state",
                format!("{} values near row {near:?}", state.len()),
                format!("it needs {d} values and a row of the catalogue"),
            ));
        }
        let mut y = [0.0; MAX_DIMENSION];
        y[..d].copy_from_slice(state);
        let z = self.whiten(&y);
        Ok((0..count).map(|_| self.catalogue.row[self.draw(&z, near, rng)]).collect())
    }
}

/// Order of rows by squared distance, then by number.
fn closer(a: &(f64, usize), b: &(f64, usize)) -> std::cmp::Ordering {
    a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))
}

/// Vose's alias method: one uniform number draws an entry with its weight.
fn alias_table(entries: &[(f64, u32)]) -> Vec<Slot> {
    let n = entries.len();
    let total: f64 = entries.iter().map(|(weight, _)| weight).sum();
    let mut share: Vec<f64> = entries.iter().map(|(w, _)| w / total * n as f64).collect();
    let mut slots: Vec<Slot> =
        entries.iter().map(|(_, id)| Slot { threshold: 1.0, own: *id, other: *id }).collect();
    let (mut small, mut large): (Vec<usize>, Vec<usize>) = (0..n).partition(|i| share[*i] < 1.0);
    while let (Some(s), Some(l)) = (small.pop(), large.last().copied()) {
        slots[s].threshold = share[s];
        slots[s].other = slots[l].own;
        share[l] -= 1.0 - share[s];
        if share[l] < 1.0 {
            large.pop();
            small.push(l);
        }
    }
    slots
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alias_table_keeps_the_weights() {
        let entries: Vec<(f64, u32)> = (0..17).map(|k| ((k * k) as f64 + 0.3, k as u32)).collect();
        let total: f64 = entries.iter().map(|(w, _)| w).sum();
        let slots = alias_table(&entries);
        let mut mass = [0.0; 17];
        for slot in &slots {
            mass[slot.own as usize] += slot.threshold / 17.0;
            mass[slot.other as usize] += (1.0 - slot.threshold) / 17.0;
        }
        for (weight, id) in &entries {
            assert!((mass[*id as usize] - weight / total).abs() < 1e-14);
        }
    }
}
