//! Local Grid Bootstrap of a wind record: Monbet & Marteau (2006); docs/equations.md (18)–(20).
//!
//! The catalogue holds one row per state of the record that has a successor. Given the present
//! state `z*` (whitened), a row `J` is drawn with weight `exp(−|z* − z_J|²/2h²)`, and
//! `next = c + A y* + target_J + B ξ`: with `A = 0`, `target` the successor and `B = bL` this is
//! the paper's `lgb`; with `A` the least-squares predictor, `target` its standardised residual and
//! `B = 0` it is the residual bootstrap.
//!
//! The weights need not be computed for all rows. Parts of the catalogue are drawn by bounds of
//! their weight, and then a row, or none, so that the law is that of the weights, up to rounding in
//! single precision. Where many rows have weight the parts are `columns`, where few have it the
//! leaves of a `tree`.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::abreast::{Each, MAX_DIMENSION, State, States};
use super::columns::{self, Columns};
use super::tree::{self, Tree};
use crate::error::{DriftError, finite, positive, room};
use crate::field::Vec2;
use crate::lanes::WIDTH;

/// How rows are drawn is decided by so many states of a simulation, so many steps apart.
const VISITS: usize = 64;
const STEPS_BETWEEN: usize = 4;
/// Largest Markov order.
pub const MAX_ORDER: usize = MAX_DIMENSION / 2;
/// A row whose weight relative to the nearest row's has a log below this counts as nothing.
const NEGLIGIBLE: f64 = -36.0;

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

/// The present state of a simulation.
#[derive(Debug, Clone)]
pub struct Chain {
    state: State,
    /// Row of the record whose successor gave the present value, if one did.
    predecessor: Option<usize>,
    phase: usize,
}

/// The present states of several simulations, side by side.
#[derive(Debug, Clone)]
pub(crate) struct Chains {
    /// Component by component, as many as a state has.
    states: Vec<Each<f64>>,
    predecessor: Each<Option<usize>>,
    phase: Each<usize>,
}

impl Chains {
    /// One of them.
    pub(crate) fn get(&self, at: usize) -> Chain {
        let (predecessor, phase) = (self.predecessor[at], self.phase[at]);
        Chain { state: one(&self.states, at), predecessor, phase }
    }

    /// Puts one in its place.
    pub(crate) fn set(&mut self, at: usize, chain: &Chain) {
        for (component, value) in self.states.iter_mut().zip(&chain.state) {
            component[at] = *value;
        }
        (self.predecessor[at], self.phase[at]) = (chain.predecessor, chain.phase);
    }

    /// Row of the record whose successor gave one its present value; none if it was handed.
    pub(crate) fn predecessor(&self, at: usize) -> Option<usize> {
        self.predecessor[at]
    }

    /// The next value of some of them.
    fn push(&mut self, numbers: &[usize], [x, y]: &[Each<f64>; 2], phases: usize) {
        for k in (2..self.states.len()).rev() {
            let earlier = self.states[k - 2];
            for at in numbers {
                self.states[k][*at] = earlier[*at];
            }
        }
        for at in numbers {
            (self.states[0][*at], self.states[1][*at]) = (x[*at], y[*at]);
            let next = self.phase[*at] + 1;
            self.phase[*at] = if next == phases { 0 } else { next };
        }
    }
}

/// A fitted bootstrap, ready to simulate.
#[derive(Debug, Clone)]
pub struct Bootstrap {
    catalogue: Catalogue,
    /// Whitened states, component by component.
    components: Vec<f64>,
    proposals: Proposals,
    starts: Vec<Vec<usize>>,
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
        if n >= u32::MAX as usize || catalogue.row.windows(2).any(|pair| pair[0] >= pair[1]) {
            return Err(DriftError::invalid("row", n, "rows must increase, fewer than 2³² − 1"));
        }
        let mut starts = vec![Vec::new(); phases];
        for i in (0..n).filter(|i| catalogue.start[*i] && catalogue.row[*i] > 0) {
            starts[catalogue.phase[i]].push(i);
        }
        if starts.iter().all(Vec::is_empty) {
            return Err(DriftError::invalid("start", "no row", "at least one row must be a start"));
        }
        let mut bootstrap = Self {
            catalogue,
            components: Vec::with_capacity(n * d),
            proposals: Proposals::None,
            starts,
        };
        let mut whitened = Vec::with_capacity(n * d);
        let mut scratch = Scratch::default();
        for i in 0..n {
            bootstrap.whiten(&beside(&bootstrap.state(i), d), &mut scratch);
            whitened.extend(scratch.whitened.iter().map(|z| z[0]));
        }
        for k in 0..d {
            bootstrap.components.extend(whitened.iter().skip(k).step_by(d));
        }
        let visited = bootstrap.visited()?;
        let bandwidth = bootstrap.catalogue.bandwidth;
        bootstrap.proposals = Proposals::cheapest(&whitened, d, bandwidth, &visited);
        Ok(bootstrap)
    }

    /// Some whitened states that a simulation comes to.
    fn visited(&self) -> Result<Vec<State>, DriftError> {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let mut chains = self.chains();
        chains.set(0, &self.start(None, &mut rng)?);
        let mut scratch = Scratch::default();
        let mut visited = Vec::new();
        for step in 0..VISITS * STEPS_BETWEEN {
            if step % STEPS_BETWEEN == 0 {
                self.whiten(&chains.states, &mut scratch);
                visited.push(one(&scratch.whitened, 0));
            }
            self.step(&mut chains, &[0], std::slice::from_mut(&mut rng), &mut scratch);
        }
        Ok(visited)
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

    /// Whitens states.
    fn whiten(&self, states: &States, scratch: &mut Scratch) {
        let d = self.dimension();
        scratch.whitened.resize(d, [0.0; WIDTH]);
        let rows = self.catalogue.whitening.chunks_exact(d);
        for (z, row) in scratch.whitened.iter_mut().zip(rows) {
            *z = combined(row, states, 0.0);
        }
    }

    /// Draws a row with weight `exp(−|z − z_i|²/2h²)` by weighing all of them.
    fn weigh_all<R: Rng>(&self, z: &[f64], rng: &mut R) -> usize {
        let n = self.catalogue.row.len();
        let mut weights = vec![0.0; n];
        for (column, z) in self.components.chunks_exact(n).zip(z) {
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

    /// Draws a row with weight `exp(−|z − z_i|²/2h²)` for some of the whitened states, each of which
    /// has a random stream of its own.
    fn draw<R: Rng>(
        &self,
        numbers: &[usize],
        rngs: &mut [R],
        scratch: &mut Scratch,
    ) -> Each<usize> {
        let Scratch { whitened, columns, tree } = scratch;
        let (bandwidth, d) = (self.catalogue.bandwidth, self.dimension());
        let mut drawn = [None; WIDTH];
        match &self.proposals {
            Proposals::None => {}
            Proposals::Columns(of) => of.draw(whitened, numbers, rngs, columns, &mut drawn),
            Proposals::Tree(of) => {
                for at in numbers {
                    let z = &one(whitened, *at)[..d];
                    drawn[*at] = of.draw(z, bandwidth, &mut rngs[*at], tree);
                }
            }
        }
        let mut rows = [0; WIDTH];
        for at in numbers {
            let weigh_all = || self.weigh_all(&one(whitened, *at)[..d], &mut rngs[*at]);
            rows[*at] = drawn[*at].unwrap_or_else(weigh_all);
        }
        rows
    }

    /// Room for chains, all at nothing.
    pub(crate) fn chains(&self) -> Chains {
        Chains {
            states: vec![[0.0; WIDTH]; self.dimension()],
            predecessor: [None; WIDTH],
            phase: [0; WIDTH],
        }
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
        let predecessor = Some(self.catalogue.row[chosen] - 1);
        Ok(Chain { state: self.state(chosen), predecessor, phase: self.catalogue.phase[chosen] })
    }

    /// A chain that has no values yet: as many as the order are to be handed to it, the first of
    /// them at the given phase.
    pub(crate) fn empty(&self, phase: usize) -> Chain {
        let phase = (phase + self.phases() - 1) % self.phases();
        Chain { state: [0.0; MAX_DIMENSION], predecessor: None, phase }
    }

    /// Moves one of the chains by one step of the record, to an anomaly that is given.
    pub(crate) fn hand(&self, chains: &mut Chains, at: usize, anomaly: Vec2) {
        chains.push(&[at], &[[anomaly.x; WIDTH], [anomaly.y; WIDTH]], self.phases());
        chains.predecessor[at] = None;
    }

    /// Wind [m/s] of the present state of one of the chains, mean cycle included.
    #[inline]
    pub(crate) fn wind(&self, chains: &Chains, at: usize) -> Vec2 {
        let mean = &self.catalogue.cycle[2 * chains.phase[at]..][..2];
        Vec2::new(chains.states[0][at] + mean[0], chains.states[1][at] + mean[1])
    }

    /// Moves some of the chains by one step of the record, to the successors of the rows that are
    /// drawn; each has a random stream of its own.
    pub(crate) fn step<R: Rng>(
        &self,
        chains: &mut Chains,
        numbers: &[usize],
        rngs: &mut [R],
        scratch: &mut Scratch,
    ) {
        let Catalogue { predictor, target, noise: b, row, .. } = &self.catalogue;
        let d = self.dimension();
        self.whiten(&chains.states, scratch);
        let mut next: [_; 2] = std::array::from_fn(|k| {
            let of = &predictor[k * (d + 1)..][..d + 1];
            combined(&of[1..], &chains.states, of[0])
        });
        let drawn = self.draw(numbers, rngs, scratch);
        let noisy = b.iter().any(|b| *b != 0.0);
        for at in numbers {
            for (k, next) in next.iter_mut().enumerate() {
                next[*at] += target[2 * drawn[*at] + k];
            }
            if noisy {
                let xi: [f64; 2] = std::array::from_fn(|_| StandardNormal.sample(&mut rngs[*at]));
                for (k, next) in next.iter_mut().enumerate() {
                    next[*at] += b[2 * k] * xi[0] + b[2 * k + 1] * xi[1];
                }
            }
            chains.predecessor[*at] = Some(row[drawn[*at]]);
        }
        chains.push(numbers, &next, self.phases());
    }

    /// `count` independent draws of a record row at a fixed state, by proposals or by weighing all
    /// rows: shows that both have one law.
    pub fn draws_at<R: Rng>(
        &self,
        state: &[f64],
        weigh_all: bool,
        count: usize,
        rng: &mut R,
    ) -> Result<Vec<usize>, DriftError> {
        let d = self.dimension();
        if state.len() != d {
            return Err(DriftError::invalid(
                "state",
                format!("{} values", state.len()),
                format!("it needs {d} values"),
            ));
        }
        finite("state", state)?;
        let mut y = [0.0; MAX_DIMENSION];
        y[..d].copy_from_slice(state);
        let mut scratch = Scratch::default();
        self.whiten(&beside(&y, d), &mut scratch);
        let mut draw = || {
            if weigh_all {
                self.weigh_all(&one(&scratch.whitened, 0)[..d], rng)
            } else {
                self.draw(&[0], std::slice::from_mut(rng), &mut scratch)[0]
            }
        };
        let mut rows = room("count", count)?;
        rows.extend((0..count).map(|_| self.catalogue.row[draw()]));
        Ok(rows)
    }
}

/// A state in every place.
fn beside(state: &State, d: usize) -> Vec<Each<f64>> {
    state[..d].iter().map(|value| [*value; WIDTH]).collect()
}

/// One of some states.
fn one(states: &States, at: usize) -> State {
    let mut state = [0.0; MAX_DIMENSION];
    for (value, component) in state.iter_mut().zip(states) {
        *value = component[at];
    }
    state
}

/// A linear function of the states.
fn combined(factors: &[f64], states: &States, constant: f64) -> Each<f64> {
    let mut sums = [constant; WIDTH];
    for (factor, component) in factors.iter().zip(states) {
        for (sum, value) in sums.iter_mut().zip(component) {
            *sum += factor * value;
        }
    }
    sums
}

/// How rows are drawn without weighing all of them.
#[derive(Debug, Clone, Default)]
enum Proposals {
    #[default]
    None,
    Columns(Columns),
    Tree(Tree),
}

impl Proposals {
    /// What draws cheapest at some whitened states.
    fn cheapest(whitened: &[f64], d: usize, bandwidth: f64, states: &[State]) -> Self {
        let (tree, cost) = Tree::cheapest(whitened, d, bandwidth, states);
        match Columns::new(whitened, d, bandwidth) {
            Some(columns) if columns.cost(states) < cost => Self::Columns(columns),
            _ => Self::Tree(tree),
        }
    }
}

/// Room that draws need.
#[derive(Debug, Clone, Default)]
pub(crate) struct Scratch {
    /// States that are moved on, whitened.
    whitened: Vec<Each<f64>>,
    columns: columns::Scratch,
    tree: tree::Scratch,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Columns where many rows have weight, a tree where all are far apart.
    #[test]
    fn what_draws_cheapest_is_chosen() {
        let whitened: Vec<f64> =
            (0..4 * 4096).map(|k| 2.0 * (0.7 * (k * k % 8209) as f64).sin()).collect();
        let states: Vec<State> = (0..8)
            .map(|number| {
                let mut state = [0.0; MAX_DIMENSION];
                state[..4].copy_from_slice(&whitened[4 * 400 * number..][..4]);
                state
            })
            .collect();
        let chosen = |bandwidth| Proposals::cheapest(&whitened, 4, bandwidth, &states);
        assert!(matches!(chosen(0.8), Proposals::Columns(_)));
        assert!(matches!(chosen(1e-4), Proposals::Tree(_)));
    }
}
