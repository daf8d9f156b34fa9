//! Draws of catalogue rows where many of them have weight: in three stages, for several states at
//! once.
//!
//! In units of `h √(2 ln 2)` the kernel of two whitened states a distance `r` apart is `2^(−r²)`. A
//! state is `(u, v)`: `v` its last three components, `u` the others, and the kernel the product of
//! one in `u` and one in `v`. The rows are parted into columns, each a box of `u`, and the columns
//! into bundles. The weight of a column is bounded by the product of
//!
//! * the kernel from `u` to its box, and
//! * the sum of the kernels from `v` to its rows. At the nodes of a lattice that sum is known. Its
//!   logarithm, plus `|v|²`, is convex and so, between nodes, below the linear interpolation.
//!   Beyond the lattice, which spans the rows, all kernels are below those from its nearest point
//!   times the kernel from there.
//!
//! The sum of a bundle's bounds is itself bounded in that way: it is known at the nodes of the
//! lattice in the last four components.
//!
//! A bundle is drawn by its bound. Then one of its columns is drawn by theirs, or none by what the
//! bundle's is above their sum; then one of the column's rows by their weights, or none in the same
//! way. Where there was none the next trial begins: docs/equations.md (20).

use std::ops::Range;

use pulp::{Simd, WithSimd};
use rand::{Rng, RngExt};

use super::abreast::{
    ABREAST, Abreast, Each, JUST_ABOVE, LEAST_TOTAL, MAX_DIMENSION, MAX_TRIALS, State, States,
    each, greater, less_distance2, lesser, part,
};
use crate::lanes::{WIDTH, dispatch_narrow};

/// Most of the last components, whose kernels are summed in the table of the columns, and in that of
/// the bundles.
const TABLED: usize = 3;
const LATTICED: usize = 4;
/// Widest spacing of the lattice where there is room for its nodes, and where there is not: beyond,
/// bounds are too loose.
const SPACING: f64 = 1.0;
const WIDEST: f64 = 2.0;
/// Farthest components, in units of the kernel: single precision tells them to 10⁻⁴ of it.
const FARTHEST: f64 = 1e3;
/// Most numbers of each table.
const MAX_TABLE: usize = 1 << 23;
/// Columns of a bundle.
const BUNDLE: usize = ABREAST;
/// Rows of a column, and how many times [`ABREAST`] they are.
const ROWS: usize = DEEP * ABREAST;
const DEEP: usize = 2;
/// Added to the binary logarithm of each sum: more than single precision can lack.
const MARGIN: f64 = 5e-4;
/// Binary logarithm of what is as good as nothing.
const NOTHING: f64 = -1e4;
/// What a draw costs, and what a trial of it costs [ns], about.
const COST_OF_DRAW: f64 = 30.0;
const COST_OF_TRIAL: f64 = 35.0;

/// The rows of a catalogue in columns; states are in units of the kernel.
#[derive(Debug, Clone)]
pub(super) struct Columns {
    /// Components of a state.
    dimension: usize,
    /// Turns whitened components into those in units of the kernel.
    unit: f64,
    /// The lattice in each of the last components.
    lattice: Vec<Axis>,
    /// Bundles, as many times [`ABREAST`].
    registers: usize,
    /// Lowest and highest state of each bundle, in the components before the lattice's.
    bundle_boxes: Vec<[Abreast; 2]>,
    /// Binary logarithm of the sum of each bundle's bounds, node by node.
    bundle_sums: Vec<Abreast>,
    /// Lowest and highest state of each column, in the components before the table's.
    boxes: Vec<[Abreast; 2]>,
    /// Binary logarithm of the sum over each column's rows, node by node.
    sums: Vec<Abreast>,
    /// States of the rows, column by column, component by component.
    states: Vec<Abreast>,
    /// Rows, in the same order.
    rows: Vec<u32>,
}

/// Nodes of the lattice in one component.
#[derive(Debug, Clone, Copy)]
struct Axis {
    low: f32,
    spacing: f32,
    nodes: usize,
}

impl Axis {
    /// Spans some values.
    fn spanning(values: impl Iterator<Item = f64>, widest: f64) -> Self {
        let (low, high) =
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)));
        let range = (high - low).max(widest);
        let intervals = (range / widest).ceil();
        // A little more than the rows need, for rounding.
        let (low, spacing) = (low - 1e-6 * range, (1.0 + 4e-6) * range / intervals);
        Self { low: low as f32, spacing: spacing as f32, nodes: intervals as usize + 1 }
    }

    /// Where a node is.
    fn at(&self, node: usize) -> f64 {
        f64::from(self.low) + f64::from(self.spacing) * node as f64
    }

    /// Places of some values, in spacings, and how far they are beyond the lattice.
    #[inline(always)]
    fn locate(&self, values: &Each<f32>) -> (Each<f32>, Each<f32>) {
        let (low, per_spacing, last) = (self.low, 1.0 / self.spacing, (self.nodes - 1) as f32);
        let place = each(|k| (values[k] - low) * per_spacing);
        let inside = each(|k| lesser(greater(place[k], 0.0), last));
        (inside, each(|k| (place[k] - inside[k]) * self.spacing))
    }
}

/// The simplices of a lattice that some places are in: from node to node, one step along each
/// component, those first in which a place is farthest from the node before.
struct Simplices<const K: usize> {
    first: Each<u32>,
    /// From each node to the next.
    steps: [Each<u32>; K],
    /// Shares of the first node, and of the others, in the interpolation.
    of_first: Each<f32>,
    shares: [Each<f32>; K],
    /// `Σ share·x²` of the nodes less that of the place, for each component `x` in spacings.
    above: [Each<f32>; K],
}

impl<const K: usize> Simplices<K> {
    /// Of places in spacings, in a lattice with so many nodes in each component.
    #[inline(always)]
    fn around(places: &[Each<f32>; K], nodes: [usize; K]) -> Self {
        // Numbers of nodes are whole, and small enough for single precision.
        let mut first = [0.0; WIDTH];
        let mut steps = [[0.0; WIDTH]; K];
        let mut fractions = [[0.0; WIDTH]; K];
        let mut above = [[0.0; WIDTH]; K];
        let mut stride = 1.0;
        for k in (0..K).rev() {
            let last = nodes[k] as f32 - 2.0;
            let node = each(|at| lesser(places[k][at].floor(), last));
            let f = each(|at| places[k][at] - node[at]);
            first = each(|at| node[at].mul_add(stride, first[at]));
            above[k] = each(|at| f[at] * (1.0 - f[at]));
            fractions[k] = f;
            steps[k] = [stride; WIDTH];
            stride *= nodes[k] as f32;
        }
        for end in (1..K).rev() {
            for k in 0..end {
                let [f, g, a, b] = [fractions[k], fractions[k + 1], steps[k], steps[k + 1]];
                fractions[k] = each(|at| greater(f[at], g[at]));
                fractions[k + 1] = each(|at| lesser(f[at], g[at]));
                steps[k] = each(|at| if f[at] < g[at] { b[at] } else { a[at] });
                steps[k + 1] = each(|at| if f[at] < g[at] { a[at] } else { b[at] });
            }
        }
        let of_first = each(|at| 1.0 - fractions[0][at]);
        let mut shares = fractions;
        for k in 1..K {
            shares[k - 1] = each(|at| fractions[k - 1][at] - fractions[k][at]);
        }
        let mut whole_steps = [[0; WIDTH]; K];
        for (whole_step, step) in whole_steps.iter_mut().zip(&steps) {
            *whole_step = whole(step);
        }
        Self { first: whole(&first), steps: whole_steps, of_first, shares, above }
    }
}

/// Whole numbers.
#[inline(always)]
fn whole(numbers: &Each<f32>) -> Each<u32> {
    let mut whole = [0; WIDTH];
    for (at, whole) in whole.iter_mut().enumerate() {
        // The sum has no bits after the point.
        *whole = (numbers[at] + 8_388_608.0).to_bits() & 0x7f_ffff;
    }
    whole
}

impl Columns {
    /// Parts rows of the whitened states `n × d`; none where they are too far apart, or the tables
    /// would be too large.
    pub(super) fn new(whitened: &[f64], d: usize, bandwidth: f64) -> Option<Self> {
        let unit = (std::f64::consts::LOG2_E / 2.0).sqrt() / bandwidth;
        let states: Vec<f64> = whitened.iter().map(|z| z * unit).collect();
        if !states.iter().all(|z| z.abs() <= FARTHEST) {
            return None;
        }
        let rows = states.len() / d;
        let bundles = rows.div_ceil(BUNDLE * ROWS);
        let registers = bundles.div_ceil(ABREAST);
        let columns = registers * ABREAST * BUNDLE;
        let lattice = Self::lattice(&states, d, registers)?;
        let nodes: usize = tabled(&lattice).iter().map(|axis| axis.nodes).product();
        let (boxed, beyond) = (boxed(d), d - lattice.len());
        let empty = [Abreast::splat(f32::INFINITY), Abreast::splat(f32::NEG_INFINITY)];
        let mut new = Self {
            dimension: d,
            unit,
            registers,
            bundle_boxes: vec![empty; registers * beyond],
            bundle_sums: Vec::new(),
            boxes: vec![empty; columns / ABREAST * boxed],
            sums: vec![Abreast::splat(NOTHING as f32); columns / ABREAST * nodes],
            // Spare places lie beyond everything.
            states: vec![Abreast::splat(f32::INFINITY); columns * DEEP * d],
            rows: vec![0; columns * ROWS],
            lattice,
        };
        new.fill(0..bundles * BUNDLE, (0..rows as u32).collect(), &states);
        new.sum_bundles();
        Some(new)
    }

    /// The lattice, as narrow as both tables have room for.
    fn lattice(states: &[f64], d: usize, registers: usize) -> Option<Vec<Axis>> {
        let mut spacing = SPACING;
        while spacing <= WIDEST {
            let component = |k: usize| states.iter().skip(k).step_by(d).copied();
            let axes = (d - LATTICED.min(d)..d).map(|k| Axis::spanning(component(k), spacing));
            let axes: Vec<Axis> = axes.collect();
            let nodes = |axes: &[Axis]| axes.iter().map(|axis| axis.nodes as f64).product::<f64>();
            let largest = nodes(&axes).max(nodes(tabled(&axes)) * BUNDLE as f64);
            if largest * (registers * ABREAST) as f64 <= MAX_TABLE as f64 {
                return Some(axes);
            }
            spacing *= 1.05;
        }
        None
    }

    /// Parts some rows among columns of a range.
    fn fill(&mut self, range: Range<usize>, rows: Vec<u32>, states: &[f64]) {
        let (d, boxed) = (self.dimension, boxed(self.dimension));
        if range.len() > 1 {
            // Bundles are parted first, by the components that their boxes alone bound.
            let bundles = range.len() > BUNDLE;
            let unit = if bundles { BUNDLE } else { 1 };
            let half = range.len() / unit / 2 * unit;
            let middle = rows.len() * half / range.len();
            let among = match (d - self.lattice.len(), boxed) {
                (beyond, _) if bundles && beyond > 0 => beyond,
                (_, 0) => d,
                _ => boxed,
            };
            let [first, second] = part(rows, middle, states, d, among);
            self.fill(range.start..range.start + half, first, states);
            self.fill(range.start + half..range.end, second, states);
            return;
        }
        let column = range.start;
        let state = |row: &u32| &states[*row as usize * d..][..d];
        let slots = &mut self.rows[column * ROWS..][..ROWS];
        // Where rounding leads to a spare place, it is the last row's.
        slots.fill(rows.last().copied().unwrap_or_default());
        for (slot, row) in rows.iter().enumerate() {
            slots[slot] = *row;
            for (k, value) in state(row).iter().enumerate() {
                let register = (column * DEEP + slot / ABREAST) * d + k;
                self.states[register][slot % ABREAST] = *value as f32;
            }
        }
        let (boxed_alone, bundle) = (d - self.lattice.len(), column / BUNDLE);
        for (boxes, boxed, at) in
            [(&mut self.boxes, boxed, column), (&mut self.bundle_boxes, boxed_alone, bundle)]
        {
            let boxes = &mut boxes[at / ABREAST * boxed..][..boxed];
            for (k, [low, high]) in boxes.iter_mut().enumerate() {
                let (low, high) = (&mut low[at % ABREAST], &mut high[at % ABREAST]);
                for value in rows.iter().map(|row| state(row)[k] as f32) {
                    (*low, *high) = (low.min(value), high.max(value));
                }
            }
        }
        // The kernels from the rows to the nodes, one component after the other.
        let registers = self.registers * BUNDLE;
        let mut of_nodes = vec![0.0; self.sums.len() / registers];
        for row in &rows {
            let mut kernels = vec![1.0];
            for (axis, value) in tabled(&self.lattice).iter().zip(&state(row)[boxed..]) {
                let kernel = |node| (-(value - axis.at(node)).powi(2)).exp2();
                let of_axis: Vec<f64> = (0..axis.nodes).map(kernel).collect();
                let products = kernels.iter().flat_map(|a| of_axis.iter().map(move |b| a * b));
                kernels = products.collect();
            }
            for (sum, kernel) in of_nodes.iter_mut().zip(kernels) {
                *sum += kernel;
            }
        }
        for (sums, sum) in self.sums.chunks_exact_mut(registers).zip(of_nodes) {
            // What is lost below the least number is as good as nothing at the next nodes, too.
            sums[column / ABREAST][column % ABREAST] = log2_above(sum);
        }
    }

    /// Sums the bounds of each bundle's columns at the nodes of the lattice.
    fn sum_bundles(&mut self) {
        let registers = self.registers * BUNDLE;
        let first = &self.lattice[..boxed(self.lattice.len())];
        let nodes = self.sums.chunks_exact(registers).map(|sums| {
            sums.iter().flat_map(|sums| sums.0).map(|sum| f64::from(sum).exp2()).collect()
        });
        let nodes: Vec<Vec<f64>> = nodes.collect();
        let boxed = boxed(self.dimension);
        let combinations: usize = first.iter().map(|axis| axis.nodes).product();
        for combination in 0..combinations {
            // The kernel from a node to each box.
            let mut kernels = vec![1.0; registers * ABREAST];
            let mut rest = combination;
            for (k, axis) in first.iter().enumerate().rev() {
                let z = axis.at(rest % axis.nodes);
                rest /= axis.nodes;
                let of =
                    self.boxes.chunks_exact(boxed).map(|boxes| &boxes[boxed - first.len() + k]);
                let ends = of.flat_map(|[low, high]| low.0.into_iter().zip(high.0));
                for (kernel, (low, high)) in kernels.iter_mut().zip(ends) {
                    let [low, high] = [low, high].map(f64::from);
                    *kernel *= (-(z - z.max(low).min(high)).powi(2)).exp2();
                }
            }
            for sums in &nodes {
                let mut bundles = vec![Abreast::splat(NOTHING as f32); self.registers];
                let of = kernels.chunks_exact(BUNDLE).zip(sums.chunks_exact(BUNDLE));
                for (bundle, (kernels, sums)) in of.enumerate() {
                    let bounds = kernels.iter().zip(sums).map(|(kernel, sum)| kernel * sum);
                    bundles[bundle / ABREAST][bundle % ABREAST] =
                        log2_above(JUST_ABOVE * bounds.sum::<f64>());
                }
                self.bundle_sums.extend(bundles);
            }
        }
    }

    /// What draws at some states cost [ns], about.
    pub(super) fn cost(&self, states: &[State]) -> f64 {
        let costs = states.iter().map(|z| {
            let [bundles, _, rows] =
                self.weigh(z).map(|of| -> f64 { of.into_iter().map(f64::from).sum() });
            COST_OF_DRAW + COST_OF_TRIAL * bundles / rows.max(f64::MIN_POSITIVE)
        });
        costs.sum()
    }

    /// Bounds of all bundles, of all columns, and the weights of all rows at a state, in common
    /// units.
    fn weigh(&self, state: &State) -> [Vec<f32>; 3] {
        dispatch_narrow(Weigh { columns: self, state })
    }

    /// Draws a row for some of the states, each by a random stream of its own, by the weights there;
    /// none after too many trials.
    pub(super) fn draw<R: Rng>(
        &self,
        states: &States,
        numbers: &[usize],
        rngs: &mut [R],
        scratch: &mut Scratch,
        drawn: &mut Each<Option<usize>>,
    ) {
        dispatch_narrow(Draw { columns: self, states, numbers, rngs, scratch, drawn });
    }
}

/// The components of a lattice that the columns' table is of.
fn tabled(lattice: &[Axis]) -> &[Axis] {
    &lattice[boxed(lattice.len())..]
}

/// How many of `d` components are before those.
#[inline(always)]
fn boxed(d: usize) -> usize {
    d.saturating_sub(TABLED)
}

/// A binary logarithm, not below that of what is as good as nothing, and by the margin too much.
fn log2_above(sum: f64) -> f32 {
    (sum.log2() + MARGIN).max(NOTHING) as f32
}

/// Room for what is looked up at some states.
#[derive(Debug, Clone, Default)]
pub(super) struct Scratch {
    /// Sums of the bundles' bounds over the registers before each, and over all, state by state.
    sums: Vec<Abreast>,
    looks: Looks,
}

/// What there is to draw from at some states.
#[derive(Debug, Clone, Default)]
struct Looks {
    /// The states, component by component.
    place: [Each<f32>; MAX_DIMENSION],
    /// Added to the binary logarithm of a column's bound, and of a row's kernel, to compare it with
    /// the bundles' bounds.
    of_columns: Each<f32>,
    of_rows: Each<f32>,
    /// Nodes of the columns' table, and their shares: none of those that a state of two components
    /// does not have.
    nodes: [Each<u32>; TABLED + 1],
    shares: [Each<f32>; TABLED + 1],
    /// Sums of the bounds up to each place of all registers, state by state.
    upto: Each<Abreast>,
}

impl Looks {
    /// Numbers less the squared distances of a state from boxes in its first components.
    #[inline(always)]
    fn less_distance2(
        &self,
        mut numbers: Abreast,
        boxes: &[[Abreast; 2]],
        number: usize,
    ) -> Abreast {
        for (of, place) in boxes.iter().zip(&self.place) {
            numbers = less_distance2(numbers, &[*of], &[place[number]]);
        }
        numbers
    }
}

/// Works out all bounds at a state.
struct Weigh<'a> {
    columns: &'a Columns,
    state: &'a State,
}

impl WithSimd for Weigh<'_> {
    type Output = [Vec<f32>; 3];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { columns, state } = self;
        let states = state.map(|z| [z; WIDTH]);
        let (d, scratch) = (columns.dimension, &mut Scratch::default());
        columns.look_up(simd, &states, &[0], d, scratch);
        let Scratch { sums, looks } = scratch;
        let (first, mut all) = (Trial::default(), [vec![], vec![], vec![]]);
        for pair in sums[..=columns.registers].windows(2) {
            all[0].extend((0..ABREAST).map(|k| pair[1][k] - pair[0][k]));
        }
        for bundle in 0..columns.registers * ABREAST {
            let bounds = columns.of_columns(&Trial { slot: bundle, ..first }, looks, d);
            all[1].extend(bounds.power_just_above(simd).0);
        }
        for column in 0..columns.registers * ABREAST * BUNDLE {
            let weights = columns.of_rows(&Trial { slot: column, ..first }, looks, d);
            all[2].extend(weights.into_iter().flat_map(|of| of.power(simd).0));
        }
        all
    }
}

/// Draws rows at some states.
struct Draw<'a, R> {
    columns: &'a Columns,
    states: &'a States,
    numbers: &'a [usize],
    rngs: &'a mut [R],
    scratch: &'a mut Scratch,
    drawn: &'a mut Each<Option<usize>>,
}

impl<R: Rng> WithSimd for Draw<'_, R> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let d = self.columns.dimension;
        // The usual order has code of its own.
        if d == 4 { self.draw(simd, 4) } else { self.draw(simd, d) }
    }
}

impl<R: Rng> Draw<'_, R> {
    #[inline(always)]
    fn draw<S: Simd>(self, simd: S, d: usize) {
        let Self { columns, states, numbers, rngs, scratch, drawn } = self;
        columns.look_up(simd, states, numbers, d, scratch);
        let Scratch { sums, looks } = scratch;
        let room = columns.registers + 1;
        let mut waiting = [0; WIDTH];
        let mut count = 0;
        for number in numbers {
            // Single precision does not tell bounds apart that are next to nothing.
            waiting[count] = *number;
            count += usize::from(looks.upto[*number][ABREAST - 1] >= LEAST_TOTAL);
        }
        let mut slots = [usize::MAX; WIDTH];
        let mut trials = [Trial::default(); WIDTH];
        let mut of_columns = [Abreast::default(); WIDTH];
        let mut of_rows = [[Abreast::default(); DEEP]; WIDTH];
        for _ in 0..MAX_TRIALS {
            if count == 0 {
                break;
            }
            // Each stage is gone through for all that wait before the next is: the processor takes
            // several at the same time.
            for (trial, number) in trials.iter_mut().zip(&waiting[..count]) {
                let sums = &sums[number * room..][..room];
                *trial = Trial::begin(simd, *number, sums, looks, rngs[*number].random());
            }
            for (trial, exponents) in trials[..count].iter().zip(&mut of_columns) {
                *exponents = columns.of_columns(trial, looks, d);
            }
            for bounds in &mut of_columns[..count] {
                *bounds = bounds.power_just_above(simd);
            }
            let mut left = 0;
            for at in 0..count {
                let mut trial = trials[at];
                let found = trial.narrow(simd, &[of_columns[at]]);
                // Those without a column go to the end.
                trials[at] = trials[left];
                trials[left] = trial;
                left += usize::from(found);
            }
            for (trial, exponents) in trials[..left].iter().zip(&mut of_rows) {
                *exponents = columns.of_rows(trial, looks, d);
            }
            for weights in of_rows[..left].as_flattened_mut() {
                *weights = weights.power(simd);
            }
            let mut again = 0;
            for at in 0..count {
                let mut trial = trials[at];
                let found = at < left && trial.narrow(simd, &of_rows[at]);
                slots[trial.number] = trial.slot;
                waiting[again] = trial.number;
                again += usize::from(!found);
            }
            count = again;
        }
        for number in &waiting[..count] {
            slots[*number] = usize::MAX;
        }
        for (drawn, slot) in drawn.iter_mut().zip(slots) {
            *drawn = columns.rows.get(slot).map(|row| *row as usize);
        }
    }
}

/// A trial to draw a row.
#[derive(Clone, Copy, Default)]
struct Trial {
    /// The state it is at.
    number: usize,
    /// The bundle that is drawn, then the column, then the row.
    slot: usize,
    /// What of its bound draws what is next.
    left: f32,
}

impl Trial {
    /// 24 random bits choose the bundle, the other 40 the column and the row.
    #[inline(always)]
    fn begin<S: Simd>(simd: S, number: usize, sums: &[Abreast], looks: &Looks, bits: u64) -> Self {
        let (upto, last) = (&looks.upto[number], sums.len() - 2);
        let share = (bits >> 40) as u32 as f32 / (1_u64 << 24) as f32;
        let at = share * upto[ABREAST - 1];
        let place = upto.first_above(simd, at).min(ABREAST - 1);
        let inside = at - (upto[place] - sums[last + 1][place]);
        let register = sums[1..].partition_point(|sum| sum[place] <= inside).min(last);
        let left = (bits & 0xff_ffff_ffff) as f32 / (1_u64 << 40) as f32;
        // What the bundle was drawn with, rounding included.
        let bound = sums[register + 1][place] - sums[register][place];
        Self { number, slot: register * ABREAST + place, left: left * bound }
    }

    /// Goes on to one of what is in the slot, by their weights; false if that draws none.
    #[inline(always)]
    fn narrow<S: Simd, const N: usize>(&mut self, simd: S, weights: &[Abreast; N]) -> bool {
        let mut sum = weights[0];
        for weights in &weights[1..] {
            sum = Abreast::of(|k| sum[k] + weights[k]);
        }
        let upto = sum.running(simd);
        let found = upto.first_above(simd, self.left);
        let place = found.min(ABREAST - 1);
        let mut left = greater(self.left - (upto[place] - sum[place]), 0.0);
        let mut depth = 0;
        // All bits, once it is found: to go on either way would be guessed wrong half the time.
        let mut here = 0;
        for weights in &weights[..N - 1] {
            let rest = left - weights[place];
            here |= ((rest.to_bits() as i32) >> 31) as u32;
            left = f32::from_bits(left.to_bits() & here | rest.to_bits() & !here);
            depth += (!here & 1) as usize;
        }
        self.left = left;
        self.slot = (self.slot * N + depth) * ABREAST + place;
        found < ABREAST
    }
}

impl Columns {
    /// Works out the bundles' bounds at some of the states, and what the other bounds need.
    #[inline(always)]
    fn look_up<S: Simd>(
        &self,
        simd: S,
        states: &States,
        numbers: &[usize],
        d: usize,
        scratch: &mut Scratch,
    ) {
        if d == 2 {
            self.look::<S, 2, 2>(simd, states, numbers, d, scratch);
        } else {
            self.look::<S, LATTICED, TABLED>(simd, states, numbers, d, scratch);
        }
    }

    #[inline(always)]
    fn look<S: Simd, const K: usize, const T: usize>(
        &self,
        simd: S,
        states: &States,
        numbers: &[usize],
        d: usize,
        Scratch { sums, looks }: &mut Scratch,
    ) {
        for (place, state) in looks.place[..d].iter_mut().zip(states) {
            *place = each(|at| (state[at] * self.unit) as f32);
        }
        let lattice = &self.lattice[..K];
        let mut inside = [[0.0; WIDTH]; K];
        let mut beyond = [[0.0; WIDTH]; K];
        for (k, axis) in lattice.iter().enumerate() {
            (inside[k], beyond[k]) = axis.locate(&looks.place[d - K + k]);
        }
        let nodes = std::array::from_fn(|k| lattice[k].nodes);
        let simplices = Simplices::around(&inside, nodes);
        let mut shift = [0.0; WIDTH];
        for (k, axis) in lattice.iter().enumerate() {
            if k == K - T {
                looks.of_columns = shift;
            }
            let (square, above, beyond) =
                (axis.spacing * axis.spacing, simplices.above[k], beyond[k]);
            shift = each(|at| (-square).mul_add(above[at], shift[at]));
            shift = each(|at| beyond[at].mul_add(beyond[at], shift[at]));
        }
        looks.of_rows = shift;
        let last: [_; T] = std::array::from_fn(|k| inside[K - T + k]);
        let in_table = Simplices::around(&last, std::array::from_fn(|k| nodes[K - T + k]));
        (looks.nodes[0], looks.shares[0]) = (in_table.first, in_table.of_first);
        for k in 0..T {
            for at in 0..WIDTH {
                looks.nodes[k + 1][at] = looks.nodes[k][at] + in_table.steps[k][at];
            }
            looks.shares[k + 1] = in_table.shares[k];
        }
        looks.shares[T + 1..].fill([0.0; WIDTH]);
        let room = self.registers + 1;
        sums.resize(room * WIDTH, Abreast::default());
        for number in numbers.iter().copied() {
            let mut totals = Abreast::default();
            let sums = &mut sums[number * room..][..room];
            sums[0] = totals;
            for register in 0..self.registers {
                let mut node = simplices.first[number] as usize;
                let line = self.bundle_sums[node * self.registers + register];
                let mut log2 = Abreast::of(|k| line[k] * simplices.of_first[number]);
                for (step, share) in simplices.steps.iter().zip(&simplices.shares) {
                    node += step[number] as usize;
                    let line = self.bundle_sums[node * self.registers + register];
                    log2 = Abreast::of(|k| line[k].mul_add(share[number], log2[k]));
                }
                let boxes = &self.bundle_boxes[register * (d - K)..][..d - K];
                log2 = looks.less_distance2(log2, boxes, number);
                let bounds = log2.power_just_above(simd);
                totals = Abreast::of(|k| totals[k] + bounds[k]);
                sums[register + 1] = totals;
            }
            looks.upto[number] = totals.running(simd);
        }
    }

    /// Binary logarithms of the bounds of a bundle's columns.
    #[inline(always)]
    fn of_columns(&self, trial: &Trial, looks: &Looks, d: usize) -> Abreast {
        let (boxed, number, bundle) = (boxed(d), trial.number, trial.slot);
        let registers = self.registers * BUNDLE;
        let mut exponents = Abreast::splat(looks.of_columns[number]);
        for (node, share) in looks.nodes.iter().zip(&looks.shares) {
            let line = &self.sums[node[number] as usize * registers + bundle];
            exponents = Abreast::of(|k| line[k].mul_add(share[number], exponents[k]));
        }
        looks.less_distance2(exponents, &self.boxes[bundle * boxed..][..boxed], number)
    }

    /// Binary logarithms of the weights of a column's rows.
    #[inline(always)]
    fn of_rows(&self, trial: &Trial, looks: &Looks, d: usize) -> [Abreast; DEEP] {
        let mut all = [Abreast::splat(looks.of_rows[trial.number]); DEEP];
        let states = &self.states[trial.slot * DEEP * d..][..DEEP * d];
        for (n, exponents) in all.iter_mut().enumerate() {
            for (of, place) in states[n * d..][..d].iter().zip(&looks.place) {
                let z = place[trial.number];
                *exponents = Abreast::of(|k| (-(of[k] - z)).mul_add(of[k] - z, exponents[k]));
            }
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn states(count: usize, d: usize) -> Vec<f64> {
        (0..count * d).map(|k| 2.0 * (0.7 * (k * k % 1009) as f64).sin()).collect()
    }

    #[test]
    fn columns_hold_every_row_once() -> Result<(), &'static str> {
        for (count, d) in [(1, 2), (31, 4), (333, 4), (700, 6)] {
            let whitened = states(count, d);
            let columns = Columns::new(&whitened, d, 0.3).ok_or("too many nodes")?;
            let mut held: Vec<u32> =
                (columns.states.chunks_exact(d).zip(columns.rows.chunks(ABREAST)))
                    .flat_map(|(states, rows)| {
                        (0..ABREAST).filter(|k| states[0][*k].is_finite()).map(|k| rows[k])
                    })
                    .collect();
            held.sort_unstable();
            assert!(held.into_iter().eq(0..count as u32));
        }
        Ok(())
    }

    #[test]
    fn an_axis_spans_its_values() {
        let values = [-3.0, 0.1, 4.0];
        let axis = Axis::spanning(values.into_iter(), 0.7);
        let last = axis.at(axis.nodes - 1);
        assert!((-3.001..=-3.0).contains(&axis.at(0)) && (4.0..4.001).contains(&last));
        assert!(f64::from(axis.spacing) < 1.001 * 0.7);
        let (inside, beyond) = axis.locate(&each(|k| [-3.0, 0.1, 4.0, 5.0, -5.0][k % 5]));
        for (k, value) in values.into_iter().enumerate() {
            let there = axis.at(0) + f64::from(inside[k] * axis.spacing);
            assert!((there - value).abs() < 1e-5 && beyond[k].abs() < 1e-5, "{there} {value}");
        }
        assert!((inside[3], inside[4]) == ((axis.nodes - 1) as f32, 0.0));
        assert!((beyond[3] - 1.0).abs() < 1e-3 && (beyond[4] + 2.0).abs() < 1e-3);
    }

    /// Shares are those of a linear interpolation between nodes around, and what it has too much of
    /// the square is told.
    #[test]
    fn simplices_interpolate() {
        let nodes = [7, 5, 9];
        let last = nodes.map(|n| (n - 1) as f32);
        let place = |k: usize, at: usize| last[k] * [0.0, 1.0, 0.5, 0.31, 0.77][(at + k * at) % 5];
        let places: [Each<f32>; 3] = std::array::from_fn(|k| each(|at| place(k, at)));
        let around = Simplices::around(&places, nodes);
        for at in 0..WIDTH {
            let (mut share, mut node) = (around.of_first[at], around.first[at] as usize);
            let mut interpolated = [0.0; 3];
            let mut squares = [0.0; 3];
            let mut shares = 0.0;
            for k in 0..=3 {
                let of = [node / 45, node / 9 % 5, node % 9].map(|of| of as f32);
                for (c, of) in of.into_iter().enumerate() {
                    assert!(share <= 0.0 || (of - places[c][at]).abs() < 1.0 + 1e-6);
                    interpolated[c] += share * of;
                    squares[c] += share * of * of;
                }
                assert!(share >= 0.0 && node < 7 * 45);
                shares += share;
                if k < 3 {
                    (share, node) = (around.shares[k][at], node + around.steps[k][at] as usize);
                }
            }
            assert!((shares - 1.0).abs() < 1e-6);
            for (c, place) in places.iter().map(|of| of[at]).enumerate() {
                assert!((interpolated[c] - place).abs() < 1e-5, "{at} {c}");
                assert!((squares[c] - place * place - around.above[c][at]).abs() < 1e-4);
            }
        }
    }

    /// The lattice is no wider than needed for one of the two tables, and both have room.
    #[test]
    fn tables_have_room() -> Result<(), &'static str> {
        let (mut by_columns, mut by_bundles) = (0, 0);
        for registers in [1, 2, 15, 40, 100] {
            for range in [8.0, 14.0, 20.0, 40.0] {
                let ends = [0.0, 0.0, 0.0, 0.0, range, range, range, range];
                let Some(axes) = Columns::lattice(&ends, 4, registers) else { continue };
                let nodes = |axes: &[Axis]| axes.iter().map(|axis| axis.nodes).product::<usize>();
                let of_bundles = nodes(&axes) * registers * ABREAST;
                let of_columns = nodes(tabled(&axes)) * registers * ABREAST * BUNDLE;
                assert!(of_bundles <= MAX_TABLE && of_columns <= MAX_TABLE, "{registers} {range}");
                let widened = f64::from(axes[0].spacing) > 1.001 * SPACING;
                by_columns += usize::from(widened && of_columns > of_bundles);
                by_bundles += usize::from(widened && of_columns < of_bundles);
            }
        }
        assert!(by_columns > 0 && by_bundles > 0, "{by_columns} {by_bundles}");
        let axes = Columns::lattice(&[0.0, 0.0, 6.0, 6.0], 2, 1).ok_or("no room for 49 nodes")?;
        assert!(axes.iter().all(|axis| axis.nodes == 7));
        Ok(())
    }

    #[test]
    fn what_is_too_far_has_none() {
        assert!(Columns::new(&states(333, 4), 4, 1e-3).is_none());
        assert!(Columns::new(&[1e300, 0.0, -1e300, 0.0], 2, 0.3).is_none());
        assert!(Columns::new(&states(100_000, 4), 4, 0.01).is_none());
        assert!(Columns::new(&states(100_000, 2), 2, 0.003).is_none());
    }

    /// The bound of each bundle is above the sum of its columns', and that of each column above the
    /// sum of its rows' weights, beyond the lattice, too; and not by much where the bandwidth is
    /// wide.
    #[test]
    fn bounds_hold() -> Result<(), &'static str> {
        for (count, d) in [(700, 2), (700, 4), (9000, 4), (700, 6)] {
            let whitened = states(count, d);
            for (bandwidth, reach) in [(0.3, 1.4), (1.0, 4.0), (1.0, 1.0)] {
                let columns = Columns::new(&whitened, d, bandwidth).ok_or("too many nodes")?;
                let states: Vec<f64> = whitened.iter().map(|z| z * columns.unit).collect();
                for number in 0..50 {
                    let mut state = [0.0; MAX_DIMENSION];
                    for (k, value) in state[..d].iter_mut().enumerate() {
                        *value = 2.0 * reach * (1.3 * (7 * number + k) as f64).sin();
                    }
                    let [bundles, of_columns, rows] =
                        columns.weigh(&state).map(|of| of.into_iter().map(f64::from).collect());
                    let all = |of: &Vec<f64>| -> f64 { of.iter().sum() };
                    let rounding = 2e-7 * all(&bundles);
                    let within = |above: &Vec<f64>, below: &Vec<f64>| {
                        let parts = below.chunks_exact(below.len() / above.len());
                        for (bound, parts) in above.iter().zip(parts) {
                            let sum: f64 = parts.iter().sum();
                            assert!(sum <= bound + rounding, "{sum} {bound}");
                        }
                    };
                    within(&bundles, &of_columns);
                    within(&of_columns, &rows);
                    let (bounded, weighed) = (all(&bundles), all(&rows));
                    let loosest = [1.3, 2.2, 20.0][d / 2 - 1];
                    assert!(reach > 1.0 || bounded < loosest * weighed, "{d}: {bounded} {weighed}");
                    // The weights are the kernels, but for a common factor.
                    let of = |row: &[f64]| -> f64 {
                        let apart = row.iter().zip(state).map(|(a, z)| a - z * columns.unit);
                        (-apart.map(|a| a.powi(2)).sum::<f64>()).exp2()
                    };
                    let kernels: f64 = states.chunks_exact(d).map(of).sum();
                    for (slot, weight) in rows.iter().enumerate().step_by(7) {
                        let row = columns.rows[slot] as usize;
                        let kernel = of(&states[row * d..][..d]) / kernels;
                        if columns.states[slot / ABREAST * d][slot % ABREAST].is_finite() {
                            assert!((weight / weighed - kernel).abs() < 1e-4 * kernel + 1e-9);
                        } else {
                            assert_eq!(*weight, 0.0);
                        }
                    }
                }
            }
        }
        Ok(())
    }

    /// What is drawn at a state does not depend on the others, nor on how many there are, nor on the
    /// instruction set.
    #[test]
    fn states_are_on_their_own() -> Result<(), &'static str> {
        let whitened = states(700, 4);
        let columns = &Columns::new(&whitened, 4, 0.3).ok_or("too many nodes")?;
        let places: Vec<[f64; WIDTH]> =
            (0..4).map(|k| std::array::from_fn(|at| whitened[4 * (40 * at) + k] + 0.1)).collect();
        let draw = |chosen: &[usize], wide: bool| {
            let of = |component: &[f64; WIDTH]| {
                std::array::from_fn(|at| component[chosen[at.min(chosen.len() - 1)]])
            };
            let states: Vec<[f64; WIDTH]> = places.iter().map(of).collect();
            let seeded = |at: &usize| ChaCha8Rng::seed_from_u64(*at as u64);
            let mut rngs: Vec<ChaCha8Rng> = chosen.iter().map(seeded).collect();
            let numbers: Vec<usize> = (0..chosen.len()).collect();
            let (scratch, drawn) = (&mut Scratch::default(), &mut [None; WIDTH]);
            if wide {
                columns.draw(&states, &numbers, &mut rngs, scratch, drawn);
            } else {
                let (states, numbers, rngs) = (&states, &numbers, &mut rngs);
                let draw = Draw { columns, states, numbers, rngs, scratch, drawn };
                draw.with_simd(pulp::Scalar::new());
            }
            let next: Vec<u64> = rngs.iter_mut().map(|rng| rng.random()).collect();
            (*drawn, next)
        };
        let all = std::array::from_fn::<_, WIDTH, _>(|at| at);
        let (drawn, next) = draw(&all, true);
        assert_eq!(draw(&all, false), (drawn, next.clone()));
        for at in all {
            assert!(drawn[at].is_some());
            let (alone, next_alone) = draw(&[at], true);
            assert_eq!((alone[0], next_alone[0]), (drawn[at], next[at]));
        }
        Ok(())
    }
}
