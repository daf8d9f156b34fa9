//! Local Grid Bootstrap of a wind record: Monbet & Marteau (2006); docs/equations.md (18)–(20).
//!
//! The catalogue holds one row per state of the record that has a successor. Given the present
//! state `z*` (whitened), a row `J` is drawn with weight `exp(−|z* − z_J|²/2h²)`, and
//! `next = c + A y* + target_J + B ξ`: with `A = 0`, `target` the successor and `B = bL` this is
//! the paper's `lgb`; with `A` the least-squares predictor, `target` its standardised residual and
//! `B = 0` it is the residual bootstrap.
//!
//! The weights need not be computed for all rows. The rows stand in the leaves of a k-d tree, and
//! the box of a leaf bounds the weights in it: a leaf is drawn by these bounds, a row of the leaf
//! evenly, and accepted with the ratio of its weight to the bound. The law is that of the weights
//! (up to rounding in single precision of the bounds, 10⁻⁷). At a wide bandwidth all leaves are
//! bounded in one go; at a narrow one the tree is searched for those that count.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::error::{DriftError, finite, positive, room};
use crate::field::Vec2;
use crate::lanes::{Kernel, dispatch};

/// How many leaves are best is decided by so many states of a simulation, so many steps apart.
const VISITS: usize = 64;
const STEPS_BETWEEN: usize = 4;
/// Largest Markov order.
pub const MAX_ORDER: usize = 8;
const MAX_DIMENSION: usize = 2 * MAX_ORDER;
/// After so many trials all rows are weighed instead. A trial accepts by the law of the weights
/// whatever went before it, so the law stays exact.
const MAX_TRIALS: usize = 200;
/// Least sum of the bounds, of which the nearest is about 1 as a rule.
const LEAST_TOTAL: f32 = 1e-18;
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

impl Chain {
    /// Row of the record whose successor gave the chain its present value; none if it was handed.
    pub fn predecessor(&self) -> Option<usize> {
        self.predecessor
    }
}

/// The present state of a simulation.
#[derive(Debug, Clone)]
pub struct Chain {
    state: State,
    /// Row of the record whose successor gave the present value, if one did.
    predecessor: Option<usize>,
    phase: usize,
}

/// A fitted bootstrap, ready to simulate.
#[derive(Debug, Clone)]
pub struct Bootstrap {
    catalogue: Catalogue,
    /// Whitened states, component by component.
    columns: Vec<f64>,
    leaves: Leaves,
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
            columns: Vec::with_capacity(n * d),
            leaves: Leaves::default(),
            starts,
        };
        let whitened: Vec<f64> =
            (0..n).flat_map(|i| bootstrap.whiten(&bootstrap.state(i))[..d].to_vec()).collect();
        for k in 0..d {
            bootstrap.columns.extend(whitened.iter().skip(k).step_by(d));
        }
        let visited = bootstrap.visited()?;
        bootstrap.leaves = Leaves::cheapest(&whitened, d, bootstrap.catalogue.bandwidth, &visited);
        Ok(bootstrap)
    }

    /// Some whitened states that a simulation comes to.
    fn visited(&self) -> Result<Vec<State>, DriftError> {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let mut chain = self.start(None, &mut rng)?;
        let mut visited = Vec::new();
        for step in 0..VISITS * STEPS_BETWEEN {
            let z = self.whiten(&chain.state);
            if step % STEPS_BETWEEN == 0 {
                visited.push(z);
            }
            let drawn = self.weigh_all(&z[..self.dimension()], &mut rng);
            self.move_on(&mut chain, drawn, &mut rng);
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

    /// Draws a row with weight `exp(−|z − z_i|²/2h²)`.
    fn draw<R: Rng>(&self, z: &State, rng: &mut R, scratch: &mut Scratch) -> usize {
        let z = &z[..self.dimension()];
        let drawn = self.leaves.draw(z, self.catalogue.bandwidth, rng, scratch);
        drawn.unwrap_or_else(|| self.weigh_all(z, rng))
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

    /// Moves the chain by one step of the record, to an anomaly that is given.
    pub(crate) fn hand(&self, chain: &mut Chain, anomaly: Vec2) {
        chain.state = self.shifted(&chain.state, anomaly);
        chain.predecessor = None;
        chain.phase = (chain.phase + 1) % self.phases();
    }

    /// Wind [m/s] of the chain's present state, mean cycle included.
    pub fn wind(&self, chain: &Chain) -> Vec2 {
        let mean = &self.catalogue.cycle[2 * chain.phase..2 * chain.phase + 2];
        Vec2::new(chain.state[0] + mean[0], chain.state[1] + mean[1])
    }

    /// Moves the chain by one step of the record.
    pub(crate) fn advance<R: Rng>(&self, chain: &mut Chain, rng: &mut R, scratch: &mut Scratch) {
        let drawn = self.draw(&self.whiten(&chain.state), rng, scratch);
        self.move_on(chain, drawn, rng);
    }

    /// Moves the chain to the successor of the row that was drawn.
    #[inline]
    fn move_on<R: Rng>(&self, chain: &mut Chain, drawn: usize, rng: &mut R) {
        let noise = if self.catalogue.noise.iter().all(|b| *b == 0.0) {
            Vec2::zeros()
        } else {
            Vec2::new(StandardNormal.sample(rng), StandardNormal.sample(rng))
        };
        let next = self.next(&chain.state, drawn, noise);
        chain.state = self.shifted(&chain.state, next);
        chain.predecessor = Some(self.catalogue.row[drawn]);
        chain.phase = (chain.phase + 1) % self.phases();
    }

    /// `count` independent draws of a record row at a fixed state, by the leaves or by weighing all
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
        let z = self.whiten(&y);
        let mut scratch = Scratch::default();
        let mut draw = || {
            if weigh_all { self.weigh_all(&z[..d], rng) } else { self.draw(&z, rng, &mut scratch) }
        };
        let mut rows = room("count", count)?;
        rows.extend((0..count).map(|_| self.catalogue.row[draw()]));
        Ok(rows)
    }
}

/// Leaves whose bounds are worked out together.
const ABREAST: usize = 16;
/// Most leaves that are all bounded for each draw, and most of a tree.
const MAX_LEAVES: usize = 2048;
const MAX_LEAVES_OF_TREE: usize = 1 << 14;
/// What a leaf's bound costs as a share of a trial, about, where all are worked out, and what a
/// block's where it is looked up in a tree: decides which it is, and how many leaves are made.
const COST_OF_BOUND: f64 = 0.005;
const COST_OF_BLOCK: f64 = 0.8;
/// Blocks are opened until what the closed ones bound is no more than this share of the leaves'.
const CLOSED: f32 = 0.3;

/// One number for each of so many leaves.
type Abreast = [f32; ABREAST];

/// The rows of a catalogue in the leaves of a k-d tree, of about as many rows each. Neighbours make
/// a block. Where few of many leaves count, blocks are taken as leaves of their own and make blocks
/// of the next level: those that bound little are left closed.
#[derive(Debug, Clone, Default)]
struct Leaves {
    /// Lowest and highest whitened state of each leaf, block by block and component by component.
    boxes: Vec<[Abreast; 2]>,
    /// Number of rows of each leaf, block by block; none in spare places.
    sizes: Vec<Abreast>,
    /// Place of each leaf's first row in `rows` and `states`, block by block.
    first: Vec<[u32; ABREAST]>,
    /// The first of the blocks that a block's places stand for, of those from `inner` on.
    children: Vec<u32>,
    inner: usize,
    /// First block of the highest level.
    top: usize,
    /// Catalogue rows, leaf by leaf, and their whitened states.
    rows: Vec<u32>,
    states: Vec<f64>,
}

impl Leaves {
    /// As many leaves as make a draw cheapest at some states of the catalogue; under a tree where
    /// that is cheaper at the states that simulations come to.
    fn cheapest(whitened: &[f64], d: usize, bandwidth: f64, visited: &[State]) -> Self {
        let n = whitened.len() / d;
        let of_catalogue: Vec<&[f64]> = whitened.chunks_exact(d).step_by((n / 64).max(1)).collect();
        let visited: Vec<&[f64]> = visited.iter().map(|z| &z[..d]).collect();
        let cost = |leaves: &Self, states: &[&[f64]], of_block: f64| -> f64 {
            let costs = states.iter().map(|z| {
                let (trials, blocks) = leaves.trials(z, bandwidth);
                trials + of_block * blocks as f64
            });
            costs.sum()
        };
        // Twice as many leaves, until that is no cheaper.
        let search = |tree: bool, most: usize, states: &[&[f64]], of_block: f64| {
            let mut count = ABREAST;
            let mut best = Self::new(whitened, d, count, tree);
            let mut least = cost(&best, states, of_block);
            while 2 * count <= most {
                count *= 2;
                let leaves = Self::new(whitened, d, count, tree);
                let cost = cost(&leaves, states, of_block);
                if least <= cost {
                    break;
                }
                (least, best) = (cost, leaves);
            }
            best
        };
        let in_line = COST_OF_BOUND * ABREAST as f64;
        let flat = search(false, MAX_LEAVES.min(n / 2), &of_catalogue, in_line);
        let tree = search(true, MAX_LEAVES_OF_TREE.min(2 * n), &visited, COST_OF_BLOCK);
        let cheaper = cost(&tree, &visited, COST_OF_BLOCK) < cost(&flat, &visited, in_line);
        if cheaper { tree } else { flat }
    }

    /// Halves the rows until there are `count` parts, each at the median of its most varied
    /// component; under a tree, or not.
    fn new(whitened: &[f64], d: usize, count: usize, tree: bool) -> Self {
        let mut parts = vec![(0..(whitened.len() / d) as u32).collect::<Vec<u32>>()];
        while parts.len() < count {
            parts = (parts.into_iter()).flat_map(|rows| halves(rows, whitened, d)).collect();
        }
        let rows = parts.concat();
        let states =
            rows.iter().flat_map(|row| &whitened[*row as usize * d..][..d]).copied().collect();
        let mut leaves = Self { rows, states, ..Self::default() };
        let mut sizes: Vec<usize> = parts.iter().map(Vec::len).collect();
        leaves.push(&sizes, d, 0);
        leaves.inner = leaves.sizes.len();
        while tree && sizes.len() > 2 * ABREAST {
            sizes = sizes.chunks(ABREAST).map(|sizes| sizes.iter().sum()).collect();
            let below = leaves.top;
            leaves.top = leaves.sizes.len();
            leaves.push(&sizes, d, below);
        }
        leaves
    }

    /// Adds the blocks of leaves that follow each other with so many rows; they stand for blocks
    /// from `below` on.
    fn push(&mut self, sizes: &[usize], d: usize, below: usize) {
        let mut at = 0;
        for (number, block) in sizes.chunks(ABREAST).enumerate() {
            self.children.push((below + number * ABREAST) as u32);
            let (mut size, mut first) = ([0.0; ABREAST], [0; ABREAST]);
            // Spare places lie beyond everything.
            let mut boxes = vec![[[f32::INFINITY; ABREAST]; 2]; d];
            for (place, rows) in block.iter().enumerate() {
                (size[place], first[place]) = (*rows as f32, at as u32);
                for (k, [low, high]) in boxes.iter_mut().enumerate() {
                    let of = self.states[at * d..(at + rows) * d].iter().skip(k).step_by(d);
                    let (least, most) = of.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| {
                        (a.min(*x), b.max(*x))
                    });
                    // Beyond what rounding to single precision can move a state.
                    low[place] = (least - 1e-5 * (1.0 + least.abs())) as f32;
                    high[place] = (most + 1e-5 * (1.0 + most.abs())) as f32;
                }
                at += rows;
            }
            self.sizes.push(size);
            self.first.push(first);
            self.boxes.extend(boxes);
        }
    }

    /// Expected number of trials of a draw at the whitened state `z`, and number of blocks that
    /// are bounded for it.
    fn trials(&self, z: &[f64], bandwidth: f64) -> (f64, usize) {
        let mut scratch = Scratch::default();
        let Bounded { nearest, totals, count } = self.bounds(z, bandwidth, &mut scratch);
        let weights: f64 = (self.states.chunks_exact(z.len()))
            .map(|state| log2_weight(state, z, nearest, scale(bandwidth)).exp2())
            .sum();
        let total: f64 = totals.iter().map(|total| f64::from(*total)).sum();
        (total / weights.max(f64::MIN_POSITIVE), count)
    }

    /// What work at the whitened state `z` needs.
    fn at<'a>(&'a self, z: &'a [f64], bandwidth: f64, scratch: &'a mut Scratch) -> At<'a> {
        scratch.bound.resize(self.sizes.len(), [0.0; ABREAST]);
        scratch.sum.resize(self.sizes.len(), [0.0; ABREAST]);
        scratch.block.resize(self.sizes.len(), 0);
        At { leaves: self, z, scale: scale(bandwidth), scratch }
    }

    /// Works out the bounds of the leaves at `z`.
    fn bounds(&self, z: &[f64], bandwidth: f64, scratch: &mut Scratch) -> Bounded {
        dispatch(Bounds(self.at(z, bandwidth, scratch)))
    }

    /// Draws a row, or gives up after many trials.
    fn draw<R: Rng>(
        &self,
        z: &[f64],
        bandwidth: f64,
        rng: &mut R,
        scratch: &mut Scratch,
    ) -> Option<usize> {
        dispatch(Draw(self.at(z, bandwidth, scratch), rng))
    }
}

/// Room for the bounds of the leaves at one state.
#[derive(Debug, Clone, Default)]
pub(crate) struct Scratch {
    /// Which blocks have been bounded: those of blocks, and those that were opened.
    block: Vec<u32>,
    /// Bound of the weight of one row, block by block.
    bound: Vec<Abreast>,
    /// Sums over the blocks, up to each, of the bounds of all rows of a leaf.
    sum: Vec<Abreast>,
}

/// What bounds come to.
struct Bounded {
    /// The squared distance that the weights are relative to.
    nearest: f64,
    /// Totals of each place over the blocks.
    totals: Abreast,
    /// How many blocks there are.
    count: usize,
}

/// Squared distances of a place from the boxes of a block.
#[inline(always)]
fn distance2(boxes: &[[Abreast; 2]], place: &[f32]) -> Abreast {
    let mut distance2 = [0.0; ABREAST];
    for ([low, high], z) in boxes.iter().zip(place) {
        for k in 0..ABREAST {
            let beyond = z - lesser(greater(*z, low[k]), high[k]);
            distance2[k] += beyond * beyond;
        }
    }
    distance2
}

/// `−1/(2h² ln 2)`: turns a squared distance into the binary logarithm of the kernel.
fn scale(bandwidth: f64) -> f64 {
    -std::f64::consts::LOG2_E / (2.0 * bandwidth * bandwidth)
}

/// Binary logarithm of a row's weight relative to that of the squared distance `nearest`; see
/// [`scale`].
#[inline(always)]
fn log2_weight(state: &[f64], z: &[f64], nearest: f64, scale: f64) -> f64 {
    let distance2: f64 = state.iter().zip(z).map(|(a, b)| (a - b) * (a - b)).sum();
    (distance2 - nearest) * scale
}

/// The two halves of some rows, split at the median of the component that varies most.
fn halves(mut rows: Vec<u32>, whitened: &[f64], d: usize) -> [Vec<u32>; 2] {
    let value = |row: &u32, k: usize| whitened[*row as usize * d + k];
    let range = |k: usize| {
        let of = rows.iter().map(|row| value(row, k));
        let bounds = of.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)));
        bounds.1 - bounds.0
    };
    let widest = (0..d).max_by(|a, b| range(*a).total_cmp(&range(*b))).unwrap_or(0);
    let middle = rows.len() / 2;
    if middle > 0 {
        rows.select_nth_unstable_by(middle, |a, b| {
            value(a, widest).total_cmp(&value(b, widest)).then(a.cmp(b))
        });
    }
    let second = rows.split_off(middle);
    [rows, second]
}

/// The greater of two numbers: [`f32::max`] would look out for NaN.
#[inline(always)]
fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The lesser of two numbers.
#[inline(always)]
fn lesser(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// A number above `2^t`, for `t ≤ 0`, by at most 6.4 %. Between powers of two the bits of a float
/// grow along the exponential's chord, which lies above it; a thousandth covers the rounding.
#[inline(always)]
fn power_above(t: f32) -> f32 {
    // The sum has 14 bits after the point; the shift makes its integer part the exponent.
    let fixed = greater(t, -126.0) + (127.0 + 512.0);
    f32::from_bits((fixed.to_bits() - 512.0_f32.to_bits()) << 9) * 1.001
}

/// [`power_above`] is no more than so many times `2^t`.
const LOOSEST: f64 = 1.064;

/// The leaves, at a state.
struct At<'a> {
    leaves: &'a Leaves,
    z: &'a [f64],
    scale: f64,
    scratch: &'a mut Scratch,
}

/// Works out the bounds of the leaves that count.
struct Bounds<'a>(At<'a>);

/// Draws a row by them.
struct Draw<'a, R>(At<'a>, &'a mut R);

// The usual order has code of its own.

impl Kernel for Bounds<'_> {
    type Output = Bounded;

    #[inline(always)]
    fn run(mut self) -> Bounded {
        let d = self.0.z.len();
        if d == 4 { self.0.bounds(4) } else { self.0.bounds(d) }
    }
}

impl<R: Rng> Kernel for Draw<'_, R> {
    type Output = Option<usize>;

    #[inline(always)]
    fn run(mut self) -> Option<usize> {
        let d = self.0.z.len();
        if d == 4 { self.0.draw(4, self.1) } else { self.0.draw(d, self.1) }
    }
}

impl At<'_> {
    #[inline(always)]
    fn bounds(&mut self, d: usize) -> Bounded {
        let Self { leaves, z, scale, scratch: Scratch { block, bound, sum } } = self;
        let mut place = [0.0; MAX_DIMENSION];
        for (place, z) in place.iter_mut().zip(&z[..d]) {
            *place = *z as f32;
        }
        let scale = *scale as f32;
        let top = leaves.top..leaves.sizes.len();
        let mut count = top.len();
        let mut least = [f32::INFINITY; ABREAST];
        let boxes = leaves.boxes[top.start * d..].chunks_exact(d);
        for (boxes, bound) in boxes.zip(bound.iter_mut()) {
            *bound = distance2(boxes, &place[..d]);
            for k in 0..ABREAST {
                least[k] = lesser(bound[k], least[k]);
            }
        }
        let nearest = least.into_iter().fold(f32::INFINITY, lesser);
        let mut total = [0.0; ABREAST];
        let sizes = &leaves.sizes[top.clone()];
        for ((bound, sum), sizes) in bound.iter_mut().zip(sum.iter_mut()).zip(sizes) {
            for k in 0..ABREAST {
                bound[k] = power_above((bound[k] - nearest) * scale);
                total[k] += bound[k] * sizes[k];
                sum[k] = total[k];
            }
        }
        for (block, id) in block.iter_mut().zip(top) {
            *block = id as u32;
        }
        if leaves.top == 0 {
            return Bounded { nearest: f64::from(nearest), totals: total, count };
        }
        // Where bounds of blocks count for much they are replaced by closer ones.
        let mut closed_blocks = count;
        loop {
            // Of the leaves, and of the blocks that are closed.
            let mut totals = [[0.0; ABREAST]; 2];
            for (id, bound) in block[..count].iter().zip(bound.iter()) {
                let id = *id as usize;
                let total = &mut totals[usize::from(id >= leaves.inner)];
                for k in 0..ABREAST {
                    total[k] += bound[k] * leaves.sizes[id][k];
                }
            }
            let [open, closed] = totals.map(|total| total.iter().sum::<f32>());
            if closed <= CLOSED * open {
                break;
            }
            // Below their mean, so that one is opened at least.
            let threshold = CLOSED / 2.0 * (open + closed) / (ABREAST * closed_blocks) as f32;
            let from = count;
            for at in 0..from {
                let id = block[at] as usize;
                if id < leaves.inner {
                    continue;
                }
                let (bound, sizes) = (&mut bound[at], &leaves.sizes[id]);
                let mut opened = 0_u32;
                for k in 0..ABREAST {
                    opened |= u32::from(bound[k] * sizes[k] > threshold) << k;
                }
                while opened > 0 {
                    let k = opened.trailing_zeros() as usize;
                    opened &= opened - 1;
                    bound[k] = 0.0;
                    let child = leaves.children[id] as usize + k;
                    closed_blocks += usize::from(child >= leaves.inner);
                    block[count] = child as u32;
                    count += 1;
                }
            }
            // Nothing is opened where the sums are no numbers.
            if count == from {
                break;
            }
            for at in from..count {
                let boxes = &leaves.boxes[block[at] as usize * d..][..d];
                let mut bounds = distance2(boxes, &place[..d]);
                for bound in &mut bounds {
                    *bound = power_above((*bound - nearest) * scale);
                }
                bound[at] = bounds;
            }
        }
        let mut total = [0.0; ABREAST];
        for ((id, bound), sum) in block[..count].iter().zip(bound.iter()).zip(sum.iter_mut()) {
            let sizes = &leaves.sizes[*id as usize];
            for k in 0..ABREAST {
                total[k] += bound[k] * sizes[k];
            }
            *sum = total;
        }
        Bounded { nearest: f64::from(nearest), totals: total, count }
    }

    #[inline(always)]
    fn draw<R: Rng>(&mut self, d: usize, rng: &mut R) -> Option<usize> {
        let Bounded { nearest, totals, count } = self.bounds(d);
        let Self { leaves, z, scale, scratch } = self;
        let z = &z[..d];
        let Scratch { block, bound, sum } = scratch;
        let mut sums = [0.0; ABREAST];
        let mut total = 0.0;
        for (sum, of_place) in sums.iter_mut().zip(totals) {
            total += of_place;
            *sum = total;
        }
        // All rows are so far that single precision does not tell their weights apart.
        if total < LEAST_TOTAL {
            return None;
        }
        for _ in 0..MAX_TRIALS {
            // 24 bits choose the leaf, the other 40 the row in it.
            let bits: u64 = rng.random();
            let at = (bits >> 40) as f32 / (1_u32 << 24) as f32 * total;
            let place = sums.iter().map(|sum| u32::from(*sum <= at)).sum::<u32>() as usize;
            let before = place.checked_sub(1).map_or(0.0, |k| sums[k]);
            let place = place.min(ABREAST - 1);
            let inside = at - before;
            let found = sum[..count].partition_point(|sum| sum[place] <= inside);
            // Rounding of the sums may lead beyond the last leaf: then the trial is void.
            let Some(id) = block[..count].get(found) else { continue };
            let size = leaves.sizes[*id as usize][place] as u64;
            if size == 0 {
                continue;
            }
            let row = ((bits & 0xff_ffff_ffff) * size) >> 40;
            let at = leaves.first[*id as usize][place] as usize + row as usize;
            let threshold = rng.random::<f64>() * f64::from(bound[found][place]);
            let exponent = log2_weight(&leaves.states[at * d..][..d], z, nearest, *scale);
            // The power itself decides only where its bounds do not.
            let above = f64::from(power_above(exponent as f32));
            if threshold < above && (threshold * LOOSEST < above || threshold < exponent.exp2()) {
                return Some(leaves.rows[at] as usize);
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leaves_hold_every_row_once() {
        let whitened: Vec<f64> = (0..4 * 333).map(|k| (0.7 * k as f64).sin()).collect();
        let leaves = Leaves::new(&whitened, 4, 64, true);
        let mut rows = leaves.rows.clone();
        rows.sort_unstable();
        assert!(rows.into_iter().eq(0..333));
        assert_eq!((leaves.top, leaves.children.last()), (4, Some(&0)));
        let (of_leaves, of_blocks) = leaves.sizes.split_at(leaves.top);
        for sizes in [of_leaves, of_blocks] {
            assert_eq!(sizes.iter().flatten().sum::<f32>(), 333.0);
        }
    }

    #[test]
    fn power_above_is_a_close_bound() {
        for k in 0..1_250_000 {
            let t = -1e-4 * k as f32;
            let (power, above) = (f64::from(t).exp2(), f64::from(power_above(t)));
            assert!(power <= above && above <= LOOSEST * power, "{t}: {power} {above}");
        }
    }

    /// The bound of a leaf is above the weight of each row in it, and every row has one.
    #[test]
    fn bounds_hold() {
        let whitened: Vec<f64> = (0..4 * 500).map(|k| 2.0 * (0.7 * k as f64).sin()).collect();
        let leaves = [(64, false), (64, true), (512, true)];
        for (count, tree) in leaves {
            let leaves = Leaves::new(&whitened, 4, count, tree);
            for (bandwidth, z) in [
                (0.02, [0.3, -0.2, 1.0, 0.0]),
                (0.1, [0.3, -0.2, 1.0, 0.0]),
                (0.5, [9.0, 8.0, -7.0, 6.0]),
            ] {
                let mut scratch = Scratch::default();
                let Bounded { nearest, totals, count } = leaves.bounds(&z, bandwidth, &mut scratch);
                assert_eq!(scratch.sum[count - 1], totals);
                let mut bounded = vec![0; 500];
                for (block, bounds) in scratch.block[..count].iter().zip(&scratch.bound) {
                    let block = *block as usize;
                    for (place, bound) in
                        bounds.iter().enumerate().filter(|(_, bound)| **bound > 0.0)
                    {
                        let size = leaves.sizes[block][place] as usize;
                        let first = leaves.first[block][place] as usize;
                        let rows = leaves.states.chunks_exact(4).zip(&mut bounded);
                        for (state, times) in rows.skip(first).take(size) {
                            let weight = log2_weight(state, &z, nearest, scale(bandwidth)).exp2();
                            assert!(weight <= f64::from(*bound));
                            *times += 1;
                        }
                    }
                }
                assert_eq!(bounded, [1; 500]);
            }
        }
    }

    /// Of many leaves a tree bounds few, and closely.
    #[test]
    fn a_tree_opens_what_counts() {
        let whitened: Vec<f64> = (0..4 * 4096).map(|k| 3.0 * (0.7 * k as f64).sin()).collect();
        let place = &whitened[400..404];
        let (of_all, all) = Leaves::new(&whitened, 4, 4096, false).trials(place, 0.05);
        let (of_tree, opened) = Leaves::new(&whitened, 4, 4096, true).trials(place, 0.05);
        assert!(of_tree < 2.0 * of_all, "{of_tree} {of_all}");
        assert!(4 * opened < all, "{opened} {all}");
        // Where the nearest row is a thousand bandwidths away, none of them is drawn for another.
        let tree = Leaves::new(&whitened, 4, 8192, true);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let aside: Vec<f64> = place.iter().map(|z| z + 0.01).collect();
        let drawn = tree.draw(&aside, 1e-5, &mut rng, &mut Scratch::default());
        assert!(drawn.is_none_or(|row| row == 100), "{drawn:?}");
        // The search ends even where the state is no number.
        let tree = Leaves::new(&whitened, 4, 4096, true);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let drawn = tree.draw(&[f64::NAN; 4], 0.05, &mut rng, &mut Scratch::default());
        assert!(drawn.is_none_or(|row| row < 4096));
    }
}
