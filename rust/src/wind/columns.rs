//! Draws of catalogue rows where many of them have weight: in two stages, for several states at
//! once.
//!
//! In units of `h √(2 ln 2)` the kernel of two whitened states a distance `r` apart is `2^(−r²)`. A
//! state is `(u, v)`: `v` its last two components, `u` the others, and the kernel the product of
//! one in `u` and one in `v`. The rows are parted into columns, each a box of `u`, and the weight
//! of a column is bounded by the product of
//!
//! * the kernel from `u` to its box, and
//! * the sum of the kernels from `v` to its rows. At the nodes of a lattice that sum is known. Its
//!   logarithm, plus `|v|²`, is convex and so, between nodes, below the bilinear interpolation.
//!   Beyond the lattice, which spans the rows, all kernels are below those from its nearest point
//!   times the kernel from there.
//!
//! A column is drawn by its bound. Then one of its rows is drawn by their weights, or none by what
//! the bound is above their sum, and the next trial begins: docs/equations.md (20).

use std::ops::Range;

use pulp::{Simd, WithSimd};
use rand::{Rng, RngExt};

use super::abreast::{
    ABREAST, Abreast, LEAST_TOTAL, MAX_DIMENSION, MAX_TRIALS, ROUNDED, State, States, chord,
    less_distance2, part, power,
};
use crate::lanes::dispatch;

/// Components whose kernels are summed in a table.
const TABLED: usize = 2;
/// Widest spacing of the lattice.
const SPACING: f64 = 0.76;
/// Farthest components, in units of the kernel: single precision tells them to 10⁻⁴ of it.
const FARTHEST: f64 = 1e3;
/// Most numbers of the table.
const MAX_TABLE: usize = 1 << 23;
/// Most rows of a column, as many times [`ABREAST`].
const DEPTH: usize = 2;
/// Added to the binary logarithm of each sum: more than single precision can lack.
const MARGIN: f64 = 5e-4 + ROUNDED as f64;
/// Binary logarithm of what is as good as nothing.
const NOTHING: f64 = -1e4;
/// What the bounds of a block of columns cost, and what a trial costs [ns], about.
const COST_OF_BLOCK: f64 = 4.0;
const COST_OF_TRIAL: f64 = 35.0;

/// The rows of a catalogue in columns; states are in units of the kernel.
#[derive(Debug, Clone)]
pub(super) struct Columns {
    /// Components of a state, and how many of them the boxes bound.
    dimension: usize,
    boxed: usize,
    /// Turns whitened components into those in units of the kernel.
    unit: f64,
    /// Lowest and highest state of each column, block by block and component by component.
    boxes: Vec<[Abreast; 2]>,
    lattice: [Axis; TABLED],
    /// Binary logarithm of the sum over each column's rows, node by node and block by block.
    sums: Vec<Abreast>,
    /// Blocks of columns.
    blocks: usize,
    /// States of the rows, column by column, `DEPTH` blocks each, component by component.
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
    fn spanning(values: impl Iterator<Item = f64>) -> Self {
        let (low, high) =
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)));
        let range = (high - low).max(SPACING);
        let intervals = (range / SPACING).ceil();
        // A little more than the rows need, for rounding.
        let (low, spacing) = (low - 1e-6 * range, (1.0 + 4e-6) * range / intervals);
        Self { low: low as f32, spacing: spacing as f32, nodes: intervals as usize + 1 }
    }

    /// The kernel from a value to each node.
    fn kernels(&self, value: f64) -> Vec<f64> {
        let (low, spacing) = (f64::from(self.low), f64::from(self.spacing));
        let kernel = |node| -> f64 { (-(value - low - node as f64 * spacing).powi(2)).exp2() };
        (0..self.nodes).map(kernel).collect()
    }

    /// The node before a value, the place between it and the next, and how far the value is beyond
    /// the lattice.
    #[inline(always)]
    fn locate(&self, value: f32) -> (usize, f32, f32) {
        let place = (value - self.low) / self.spacing;
        let inside = place.max(0.0).min((self.nodes - 1) as f32);
        let node = (inside as u32 as usize).min(self.nodes - 2);
        (node, inside - node as f32, (place - inside) * self.spacing)
    }
}

impl Columns {
    /// Parts rows of the whitened states `n × d`; none where they are too far apart, or the table
    /// would be too large.
    pub(super) fn new(whitened: &[f64], d: usize, bandwidth: f64) -> Option<Self> {
        let boxed = if d > TABLED { d - TABLED } else { d };
        let unit = (std::f64::consts::LOG2_E / 2.0).sqrt() / bandwidth;
        let states: Vec<f64> = whitened.iter().map(|z| z * unit).collect();
        if !states.iter().all(|z| z.abs() <= FARTHEST) {
            return None;
        }
        let rows = states.len() / d;
        let count = rows.div_ceil(DEPTH * ABREAST);
        let blocks = count.div_ceil(ABREAST);
        // Where no component is left to be tabled, all rows are at the first node.
        let tabled =
            |k: usize| states.chunks_exact(d).map(move |state| *state.get(k).unwrap_or(&0.0));
        let lattice = std::array::from_fn(|k| Axis::spanning(tabled(boxed + k)));
        let [first, second]: &[Axis; TABLED] = &lattice;
        let nodes = first.nodes * second.nodes;
        if nodes.checked_mul(blocks * ABREAST)? > MAX_TABLE {
            return None;
        }
        let mut columns = Self {
            dimension: d,
            boxed,
            unit,
            boxes: vec![[Abreast::splat(0.0); 2]; blocks * boxed],
            lattice,
            sums: vec![Abreast::splat(NOTHING as f32); nodes * blocks],
            blocks,
            // Spare places lie beyond everything.
            states: vec![Abreast::splat(f32::INFINITY); blocks * ABREAST * DEPTH * d],
            rows: vec![0; blocks * ABREAST * DEPTH * ABREAST],
        };
        columns.fill(0..count, (0..rows as u32).collect(), &states);
        Some(columns)
    }

    /// Parts some rows among columns of a range.
    fn fill(&mut self, range: Range<usize>, rows: Vec<u32>, states: &[f64]) {
        let (d, boxed) = (self.dimension, self.boxed);
        if range.len() > 1 {
            let half = range.len() / 2;
            let middle = rows.len() * half / range.len();
            let [first, second] = part(rows, middle, states, d, boxed);
            self.fill(range.start..range.start + half, first, states);
            self.fill(range.start + half..range.end, second, states);
            return;
        }
        let column = range.start;
        let state = |row: &u32| &states[*row as usize * d..][..d];
        let slots = &mut self.rows[column * DEPTH * ABREAST..][..DEPTH * ABREAST];
        // Where rounding leads to a spare place, it is the last row's.
        slots.fill(rows.last().copied().unwrap_or_default());
        for (slot, row) in rows.iter().enumerate() {
            slots[slot] = *row;
            let block = column * DEPTH + slot / ABREAST;
            for (k, value) in state(row).iter().enumerate() {
                self.states[block * d + k][slot % ABREAST] = *value as f32;
            }
        }
        let (block, place) = (column / ABREAST, column % ABREAST);
        for (k, [low, high]) in self.boxes[block * boxed..][..boxed].iter_mut().enumerate() {
            let of = rows.iter().map(|row| state(row)[k] as f32);
            (low[place], high[place]) =
                of.fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)));
        }
        // The kernel from each row to the nodes of both axes.
        let kernels = rows.iter().map(|row| {
            let tabled = |k: usize| state(row).get(boxed + k).copied().unwrap_or_default();
            std::array::from_fn(|k| self.lattice[k].kernels(tabled(k)))
        });
        let kernels: Vec<[Vec<f64>; TABLED]> = kernels.collect();
        let nodes = self.lattice[1].nodes;
        for (node, sums) in self.sums.chunks_exact_mut(self.blocks).enumerate() {
            let of = kernels.iter().map(|[a, b]| a[node / nodes] * b[node % nodes]);
            // What is lost below the least number is as good as nothing at the next nodes, too.
            sums[block][place] = (of.sum::<f64>().log2() + MARGIN).max(NOTHING) as f32;
        }
    }

    /// What draws at some states cost [ns], about.
    pub(super) fn cost(&self, states: &[State]) -> f64 {
        let costs = states.iter().map(|z| {
            let [bounded, weighed] = self.compare(z);
            let trials = bounded / weighed.max(f64::MIN_POSITIVE);
            COST_OF_BLOCK * self.blocks as f64 + COST_OF_TRIAL * trials
        });
        costs.sum()
    }

    /// Sums of all bounds and of all weights at a state, in common units.
    fn compare(&self, state: &State) -> [f64; 2] {
        let mut sums = vec![Abreast::splat(0.0); self.blocks + 1];
        let Look { place, shift, upto, .. } =
            dispatch(Bounds { columns: self, state, sums: &mut sums });
        let weighed = self.states.chunks_exact(self.dimension).map(|states| {
            let weigh = |k: usize| {
                let apart = states.iter().zip(place).map(|(of, z)| f64::from(of[k] - z).powi(2));
                (f64::from(shift) - apart.sum::<f64>()).exp2()
            };
            (0..ABREAST).map(weigh).sum::<f64>()
        });
        [f64::from(upto[ABREAST - 1]), weighed.sum()]
    }

    /// Draws a row for each of the first states, as many as there are random streams, by the
    /// weights there; none after too many trials.
    pub(super) fn draw<R: Rng>(
        &self,
        states: &States,
        rngs: &mut [&mut R],
        scratch: &mut Scratch,
        drawn: &mut [Option<usize>; ABREAST],
    ) {
        dispatch(Draw { columns: self, states, rngs, scratch, drawn });
    }
}

/// Room for what is looked up at some states.
#[derive(Debug, Clone, Default)]
pub(super) struct Scratch {
    /// Sums of the bounds over the blocks before each, and over all, state by state.
    sums: Vec<Abreast>,
    looks: Vec<Look>,
}

/// What there is to draw from at a state.
#[derive(Debug, Clone, Copy, Default)]
struct Look {
    place: [f32; MAX_DIMENSION],
    /// Added to the binary logarithm of a row's kernel, to compare it with the bounds.
    shift: f32,
    /// Sums of the bounds in all blocks over the places before each, and up to each.
    before: Abreast,
    upto: Abreast,
}

/// Works out the bounds at a state.
struct Bounds<'a> {
    columns: &'a Columns,
    state: &'a State,
    sums: &'a mut [Abreast],
}

impl WithSimd for Bounds<'_> {
    type Output = Look;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Look {
        let Columns { dimension, boxed, .. } = *self.columns;
        self.columns.look(simd, |k| self.state[k], dimension, boxed, self.sums)
    }
}

/// Draws rows at some states.
struct Draw<'a, 'b, R> {
    columns: &'a Columns,
    states: &'a States,
    rngs: &'a mut [&'b mut R],
    scratch: &'a mut Scratch,
    drawn: &'a mut [Option<usize>; ABREAST],
}

impl<R: Rng> WithSimd for Draw<'_, '_, R> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Columns { dimension, boxed, .. } = *self.columns;
        // The usual order has code of its own.
        if dimension == 4 { self.draw(simd, 4, 2) } else { self.draw(simd, dimension, boxed) }
    }
}

impl<R: Rng> Draw<'_, '_, R> {
    #[inline(always)]
    fn draw<S: Simd>(self, simd: S, d: usize, boxed: usize) {
        let Self { columns, states, rngs, scratch: Scratch { sums, looks }, drawn } = self;
        let room = columns.blocks + 1;
        sums.resize(room * ABREAST, Abreast::splat(0.0));
        looks.resize(ABREAST, Look::default());
        let mut waiting = [0; ABREAST];
        let mut count = 0;
        for number in 0..rngs.len() {
            let sums = &mut sums[number * room..][..room];
            looks[number] = columns.look(simd, |k| states[k][number], d, boxed, sums);
            // Single precision does not tell bounds apart that are next to nothing.
            waiting[count] = number;
            count += usize::from(looks[number].upto[ABREAST - 1] >= LEAST_TOTAL);
        }
        let mut slots = [usize::MAX; ABREAST];
        let mut trials = [Trial::default(); ABREAST];
        let mut weights = [[Abreast::splat(0.0); DEPTH]; ABREAST];
        for _ in 0..MAX_TRIALS {
            if count == 0 {
                break;
            }
            // Each step is taken for all that wait before the next is, and none depends on what
            // was drawn: the processor takes several at the same time.
            let waits = &waiting[..count];
            for (trial, number) in trials.iter_mut().zip(waits) {
                *trial = Trial::begin(simd, &looks[*number], rngs[*number].random());
            }
            for (trial, number) in trials.iter_mut().zip(waits) {
                trial.find_block(&sums[number * room..][..room]);
            }
            for ((trial, number), weights) in trials.iter().zip(waits).zip(&mut weights) {
                *weights = columns.exponents(trial, &looks[*number], d);
            }
            for weights in weights[..count].iter_mut().flatten() {
                *weights = Abreast::of(|k| power(weights[k]));
            }
            let mut left = 0;
            for at in 0..count {
                let number = waiting[at];
                let row = trials[at].row(simd, &weights[at]);
                slots[number] = trials[at].column() * DEPTH * ABREAST + row.unwrap_or(0);
                waiting[left] = number;
                left += usize::from(row.is_none());
            }
            count = left;
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
    /// Where the column is that is drawn.
    block: usize,
    place: usize,
    /// What of the sums over the blocks is left for it.
    inside: f32,
    /// What of its bound draws the row; at first the share of it.
    left: f32,
}

impl Trial {
    /// 24 random bits choose the column, the other 40 the row in it.
    #[inline(always)]
    fn begin<S: Simd>(simd: S, look: &Look, bits: u64) -> Self {
        let share = (bits >> 40) as u32 as f32 / (1_u64 << 24) as f32;
        let at = share * look.upto[ABREAST - 1];
        let place = look.upto.first_above(simd, at).min(ABREAST - 1);
        let left = (bits & 0xff_ffff_ffff) as f32 / (1_u64 << 40) as f32;
        Self { block: 0, place, inside: at - look.before[place], left }
    }

    #[inline(always)]
    fn find_block(&mut self, sums: &[Abreast]) {
        let (place, inside, last) = (self.place, self.inside, sums.len() - 2);
        self.block = sums[1..].partition_point(|sum| sum[place] <= inside).min(last);
        // What the column was drawn with, rounding included.
        self.left *= sums[self.block + 1][place] - sums[self.block][place];
    }

    #[inline(always)]
    fn column(&self) -> usize {
        self.block * ABREAST + self.place
    }

    /// The row that is drawn, counted in its column.
    #[inline(always)]
    fn row<S: Simd>(&self, simd: S, weights: &[Abreast; DEPTH]) -> Option<usize> {
        let mut sum = weights[0];
        for weights in &weights[1..] {
            sum = Abreast::of(|k| sum[k] + weights[k]);
        }
        let upto = sum.running(simd);
        let found = upto.first_above(simd, self.left);
        let place = found.min(ABREAST - 1);
        let mut left = self.left - upto.before(simd)[place];
        let mut depth = 0;
        for weights in &weights[..DEPTH - 1] {
            left -= weights[place];
            depth += usize::from(left >= 0.0);
        }
        (found < ABREAST).then_some(depth * ABREAST + place)
    }
}

impl Columns {
    /// Works out the bounds at a state, and their sums over the blocks.
    #[inline(always)]
    fn look<S: Simd>(
        &self,
        simd: S,
        state: impl Fn(usize) -> f64,
        d: usize,
        boxed: usize,
        sums: &mut [Abreast],
    ) -> Look {
        let mut place = [0.0; MAX_DIMENSION];
        for (k, place) in place[..d].iter_mut().enumerate() {
            *place = (state(k) * self.unit) as f32;
        }
        let mut shift = 0.0;
        let mut node = [0; TABLED];
        let mut share = [[1.0, 0.0]; TABLED];
        if boxed < d {
            for (k, axis) in self.lattice.iter().enumerate() {
                let (before, f, beyond) = axis.locate(place[boxed + k]);
                (node[k], share[k]) = (before, [1.0 - f, f]);
                shift += beyond * beyond - axis.spacing * axis.spacing * f * (1.0 - f);
            }
        }
        let corner = |i: usize, j: usize| {
            let number = (node[0] + i) * self.lattice[1].nodes + node[1] + j;
            (&self.sums[number * self.blocks..][..self.blocks], share[0][i] * share[1][j])
        };
        let [(a, of_a), (b, of_b), (c, of_c), (e, of_e)] =
            [corner(0, 0), corner(0, 1), corner(1, 0), corner(1, 1)];
        let boxes = &self.boxes[..self.blocks * boxed];
        let sums = &mut sums[..self.blocks + 1];
        let mut totals = Abreast::splat(0.0);
        sums[0] = totals;
        for block in 0..self.blocks {
            let (a, b, c, e) = (&a[block], &b[block], &c[block], &e[block]);
            let log2 = Abreast::of(|k| {
                a[k].mul_add(of_a, b[k].mul_add(of_b, c[k].mul_add(of_c, e[k] * of_e)))
            });
            let boxes = &boxes[block * boxed..][..boxed];
            let log2 = less_distance2(log2, boxes, &place[..boxed]);
            totals = Abreast::of(|k| totals[k] + chord(log2[k]));
            sums[block + 1] = totals;
        }
        let upto = totals.running(simd);
        Look { place, shift, before: upto.before(simd), upto }
    }

    /// Binary logarithms of the weights of a column's rows.
    #[inline(always)]
    fn exponents(&self, trial: &Trial, look: &Look, d: usize) -> [Abreast; DEPTH] {
        let mut exponents = [Abreast::splat(look.shift); DEPTH];
        let states = &self.states[trial.column() * DEPTH * d..][..DEPTH * d];
        for (exponents, states) in exponents.iter_mut().zip(states.chunks_exact(d)) {
            let mut log2 = *exponents;
            for (of, z) in states.iter().zip(&look.place) {
                log2 = Abreast::of(|k| (-(of[k] - z)).mul_add(of[k] - z, log2[k]));
            }
            *exponents = log2;
        }
        exponents
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
        let axis = Axis::spanning(values.into_iter());
        let last = axis.low + (axis.nodes - 1) as f32 * axis.spacing;
        assert!((-3.001..=-3.0).contains(&axis.low) && (4.0..4.001).contains(&last));
        assert!(f64::from(axis.spacing) < 1.001 * SPACING);
        for value in [-3.0, 0.1, 4.0_f32] {
            let (node, f, beyond) = axis.locate(value);
            assert!(node + 1 < axis.nodes && (0.0..=1.0).contains(&f) && beyond == 0.0);
            let there = axis.low + (node as f32 + f) * axis.spacing;
            assert!((there - value).abs() < 1e-5, "{there} {value}");
            let kernels = axis.kernels(f64::from(value));
            let apart = f64::from(value) - f64::from(axis.low);
            assert!((kernels[0] / (-apart * apart).exp2() - 1.0).abs() < 1e-9);
        }
        let (node, f, beyond) = axis.locate(5.0);
        assert!((node, f) == (axis.nodes - 2, 1.0) && (beyond - 1.0).abs() < 1e-3);
        let (node, f, beyond) = axis.locate(-5.0);
        assert!((node, f) == (0, 0.0) && (beyond + 2.0).abs() < 1e-3);
    }

    #[test]
    fn what_is_too_far_has_none() {
        assert!(Columns::new(&states(333, 4), 4, 1e-3).is_none());
        assert!(Columns::new(&[1e300, 0.0, -1e300, 0.0], 2, 0.3).is_none());
        assert!(Columns::new(&states(100_000, 4), 4, 0.01).is_none());
    }

    /// The bound of each column is above the sum of its rows' weights, beyond the lattice, too; and
    /// not by much where the bandwidth is wide.
    #[test]
    fn bounds_hold() -> Result<(), &'static str> {
        for d in [2, 4, 6] {
            let whitened = states(700, d);
            for (bandwidth, reach) in [(0.3, 1.4), (1.0, 4.0), (1.0, 1.0)] {
                let columns = Columns::new(&whitened, d, bandwidth).ok_or("too many nodes")?;
                let mut sums = vec![Abreast::splat(0.0); columns.blocks + 1];
                for number in 0..50 {
                    let mut state = [0.0; MAX_DIMENSION];
                    for (k, value) in state[..d].iter_mut().enumerate() {
                        *value = 2.0 * reach * (1.3 * (7 * number + k) as f64).sin();
                    }
                    let kernel = Bounds { columns: &columns, state: &state, sums: &mut sums };
                    let Look { place, shift, .. } = dispatch(kernel);
                    let (mut bounded, mut weighed) = (0.0, 0.0);
                    for column in 0..columns.blocks * ABREAST {
                        let (block, at) = (column / ABREAST, column % ABREAST);
                        let bound = f64::from(sums[block + 1][at]) - f64::from(sums[block][at]);
                        let of = &columns.states[column * DEPTH * d..][..DEPTH * d];
                        let weights = of.chunks_exact(d).flat_map(|states| {
                            (0..ABREAST).map(move |k| {
                                let apart = states.iter().zip(place).map(|(of, z)| of[k] - z);
                                let distance2: f64 = apart.map(|a| f64::from(a).powi(2)).sum();
                                (f64::from(shift) - distance2).exp2()
                            })
                        });
                        let weight: f64 = weights.sum();
                        let rounding = 2e-7 * f64::from(sums[block + 1][at]);
                        assert!(weight <= bound + rounding, "{weight} {bound}");
                        (bounded, weighed) = (bounded + bound, weighed + weight);
                    }
                    assert!(reach > 1.0 || bounded < 12.0 * weighed, "{d}: {bounded} {weighed}");
                    let [all_bounds, all_weights] = columns.compare(&state);
                    assert!((all_bounds / bounded - 1.0).abs() < 1e-5);
                    assert!((all_weights / weighed - 1.0).abs() < 1e-9);
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
        let places: Vec<[f64; ABREAST]> =
            (0..4).map(|k| std::array::from_fn(|at| whitened[4 * (40 * at) + k] + 0.1)).collect();
        let draw = |chosen: &[usize], wide: bool| {
            let of = |component: &[f64; ABREAST]| {
                std::array::from_fn(|at| component[chosen[at.min(chosen.len() - 1)]])
            };
            let states: Vec<[f64; ABREAST]> = places.iter().map(of).collect();
            let seeded = |at: &usize| ChaCha8Rng::seed_from_u64(*at as u64);
            let mut rngs: Vec<ChaCha8Rng> = chosen.iter().map(seeded).collect();
            let rngs_of: &mut [&mut ChaCha8Rng] = &mut rngs.iter_mut().collect::<Vec<_>>();
            let (scratch, drawn) = (&mut Scratch::default(), &mut [None; ABREAST]);
            if wide {
                columns.draw(&states, rngs_of, scratch, drawn);
            } else {
                let draw = Draw { columns, states: &states, rngs: rngs_of, scratch, drawn };
                draw.with_simd(pulp::Scalar::new());
            }
            let next: Vec<u64> = rngs.iter_mut().map(|rng| rng.random()).collect();
            (*drawn, next)
        };
        let all = std::array::from_fn::<_, ABREAST, _>(|at| at);
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
