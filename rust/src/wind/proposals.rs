//! Tables from which rows near a state are proposed: docs/equations.md (20).
//!
//! The space of states is cut into boxes. In the table of a box the rows stand in bins, by the
//! greatest weight that they have for any state in the box: a bin is drawn by these bounds, a row
//! of the bin evenly, and accepted with the ratio of its weight to the bound. Nothing is worked out
//! for the state but the weights of the few rows tried.

use std::array;
use std::ops::Range;

use rand::{Rng, RngExt};
use rand_distr::{Distribution, Exp1};
use rayon::prelude::*;

/// Most components that a state may have: with more, too many trials are needed.
const COMPONENTS: usize = 4;
/// Most rows: tables would be large.
const MAX_ROWS: usize = 1 << 16;
/// A whitened state in units of `√2·h`, so that weights are `exp(−|z − z_j|²)`; zeros beyond its
/// components.
type Scaled = [f32; COMPONENTS];

/// Side of the smallest boxes: one and a half bandwidths.
const SIDE: f32 = 1.5 * std::f32::consts::FRAC_1_SQRT_2;
/// Most cells of the grid of smallest boxes: a wider one has larger cells.
const MAX_CELLS: usize = 1 << 20;
/// A box is halved if so many states of the catalogue are in it.
const MANY: usize = 8;
/// Most rows that all tables may list, about: more need larger boxes.
const MAX_LISTED: usize = 1 << 25;
/// Trials that go on at a time, so that their memory is fetched together.
const AT_ONCE: usize = 4;
/// After so many of them another way to draw is taken. A trial accepts by the law of the weights
/// whatever went before it, so the law stays exact.
const MAX_ROUNDS: usize = 80;

/// The whole space near the catalogue, in boxes.
#[derive(Debug, Clone)]
pub(super) struct Proposals {
    states: Vec<Scaled>,
    /// The grid of smallest boxes: its corner, its cells along each component, a cell's side.
    low: Scaled,
    counts: [usize; COMPONENTS],
    side: f32,
    /// Table of each cell: a box is a block of cells.
    table: Vec<u32>,
    tables: Vec<Table>,
    /// Rows listed, table by table, in one piece of memory.
    rows: Vec<u16>,
}

impl Proposals {
    /// Cuts boxes in halves down to the cells of a grid, or until few states are in them: so they
    /// are small where states are met often.
    /// None for states of many components, or where there are too many of them.
    pub(super) fn new(whitened: &[f64], d: usize, bandwidth: f64) -> Option<Self> {
        if d > COMPONENTS || whitened.len() / d > MAX_ROWS {
            return None;
        }
        let states: Vec<_> = whitened.chunks_exact(d).map(|z| scaled(z, bandwidth)).collect();
        let fold = |k: usize, of: fn(f32, f32) -> f32| {
            states.iter().map(|z: &Scaled| z[k]).reduce(of).unwrap_or(0.0)
        };
        let low: Scaled = array::from_fn(|k| fold(k, f32::min));
        let high: Scaled = array::from_fn(|k| fold(k, f32::max));
        let mut side = SIDE;
        let counts = loop {
            // One cell more at either end.
            let counts = array::from_fn(|k| ((high[k] - low[k]) / side) as usize + 3);
            if counts.iter().map(|count| *count as f64).product::<f64>() <= MAX_CELLS as f64 {
                break counts;
            }
            side *= 1.1;
        };
        let mut proposals = Self {
            low: low.map(|low| low - side),
            counts,
            side,
            table: vec![0; counts.iter().product()],
            states,
            tables: Vec::new(),
            rows: Vec::new(),
        };
        let boxes = proposals.boxes();
        let made: Vec<_> = (boxes.into_par_iter())
            .map(|cells| {
                let edge = |k: usize, cell: usize| proposals.low[k] + cell as f32 * side;
                let low = array::from_fn(|k| edge(k, cells[k].start));
                let high = array::from_fn(|k| edge(k, cells[k].end));
                Table::new([low, high], &proposals.states)
            })
            .collect();
        for (mut table, rows) in made {
            table.first = table.first.map(|first| first + proposals.rows.len() as u32);
            proposals.rows.extend(rows);
            proposals.tables.push(table);
        }
        Some(proposals)
    }

    /// The boxes, each as its cells along the components; puts them down for the cells.
    fn boxes(&mut self) -> Vec<[Range<usize>; COMPONENTS]> {
        let n = self.states.len();
        let many = MANY.max(n.saturating_mul(n) / MAX_LISTED);
        let mut boxes = Vec::new();
        let mut uncut = vec![(self.counts.map(|count| 0..count), (0..n).collect::<Vec<_>>())];
        while let Some((cells, inside)) = uncut.pop() {
            let widest = (0..COMPONENTS).max_by_key(|k| cells[*k].len()).unwrap_or(0);
            let Range { start, end } = cells[widest];
            if inside.len() < many || end - start == 1 {
                self.put_down(&cells, boxes.len() as u32);
                boxes.push(cells);
                continue;
            }
            let middle = usize::midpoint(start, end);
            let halves: (Vec<_>, Vec<_>) = (inside.into_iter())
                .partition(|j| self.place(&self.states[*j], widest) < middle as f32);
            for (range, inside) in [(start..middle, halves.0), (middle..end, halves.1)] {
                let mut half = cells.clone();
                half[widest] = range;
                uncut.push((half, inside));
            }
        }
        boxes
    }

    fn put_down(&mut self, cells: &[Range<usize>; COMPONENTS], table: u32) {
        for mut nth in 0..cells.iter().map(Range::len).product() {
            let mut at = 0;
            for (range, count) in cells.iter().zip(self.counts) {
                at = at * count + range.start + nth % range.len();
                nth /= range.len();
            }
            self.table[at] = table;
        }
    }

    /// Where a state stands along one component of the grid.
    fn place(&self, z: &Scaled, k: usize) -> f32 {
        (z[k] - self.low[k]) / self.side
    }

    fn table(&self, z: &Scaled) -> Option<u32> {
        let mut at = 0;
        for (k, count) in self.counts.into_iter().enumerate() {
            let place = self.place(z, k);
            if !(place >= 0.0 && place < count as f32) {
                return None;
            }
            at = at * count + place as usize;
        }
        Some(self.table[at])
    }

    /// The first trials of a draw for the whitened state `z`; none beyond the boxes.
    pub(super) fn begin<R: Rng>(&self, z: &[f64], bandwidth: f64, rng: &mut R) -> Option<Trials> {
        let z = scaled(z, bandwidth);
        Some(self.trials(z, self.table(&z)?, rng))
    }

    fn trials<R: Rng>(&self, z: Scaled, table: u32, rng: &mut R) -> Trials {
        let of = &self.tables[table as usize];
        let rows = array::from_fn(|_| self.propose(of, rng.random()));
        let exponents =
            rows.map(|(bin, row)| distance2(&self.states[row as usize], &z) - of.bound(bin));
        Trials { z, table, rows, exponents }
    }

    /// A bin of a table and a row of it, from so many random bits.
    fn propose(&self, table: &Table, bits: u64) -> (u32, u32) {
        // 5 bits choose the slot, 27 the bin, the other 32 the row.
        let slot = &table.slots[(bits >> 59) as usize];
        let bin = slot.bins[usize::from((bits >> 32) as u32 % SHARES >= slot.share)];
        let place = |count: u64| (((bits & 0xffff_ffff) * count) >> 32) as u32;
        if u32::from(bin) == table.listed {
            return (table.listed, place(self.states.len() as u64));
        }
        let [first, beyond] = [0, 1].map(|k| table.first[usize::from(bin) + k]);
        (bin.into(), self.rows[(first + place(u64::from(beyond - first))) as usize].into())
    }

    /// The row that a draw ends with; none after many trials.
    pub(super) fn end<R: Rng>(&self, mut trials: Trials, rng: &mut R) -> Option<usize> {
        let table = &self.tables[trials.table as usize];
        for _ in 0..MAX_ROUNDS {
            for ((bin, row), exponent) in trials.rows.into_iter().zip(trials.exponents) {
                let least: f32 = Exp1.sample(rng);
                let row = row as usize;
                let is_listed = || table.bin(table.exponent(&self.states[row])) < table.listed;
                if exponent <= least && (bin < table.listed || !is_listed()) {
                    return Some(row);
                }
            }
            trials = self.trials(trials.z, trials.table, rng);
        }
        None
    }
}

/// Trials of one draw: rows proposed, and by what their weights fall short of the bounds.
#[derive(Debug, Clone)]
pub(super) struct Trials {
    z: Scaled,
    table: u32,
    /// Bin and row.
    rows: [(u32, u32); AT_ONCE],
    exponents: [f32; AT_ONCE],
}

fn scaled(z: &[f64], bandwidth: f64) -> Scaled {
    let unit = std::f64::consts::SQRT_2 * bandwidth;
    array::from_fn(|k| z.get(k).map_or(0.0, |z| (z / unit) as f32))
}

fn distance2(a: &Scaled, b: &Scaled) -> f32 {
    let [x, y, z, w] = array::from_fn(|k| (a[k] - b[k]) * (a[k] - b[k]));
    (x + y) + (z + w)
}

/// Bins of a table, and how far apart the exponents of their bounds are.
const BINS: usize = 32;
const STEP: f32 = 0.375;
/// Rows that are not listed are proposed with up to this probability.
const UNLISTED: f64 = 0.1;

/// Rows by the greatest weight that they have anywhere in a box.
#[derive(Debug, Clone)]
struct Table {
    /// Draws a bin.
    slots: [Slot; BINS],
    /// First of each bin's rows among those listed, and one beyond the last.
    first: [u32; BINS + 1],
    /// Bins whose rows are listed; the next one stands for any row that is not.
    listed: u32,
    /// Exponent of the first bin.
    least: f32,
    /// Lowest and highest corner of the box.
    corners: [Scaled; 2],
}

/// One of the equally likely slots of the alias method (Walker 1977): which of two bins.
#[derive(Debug, Clone, Copy, Default)]
struct Slot {
    /// Share of the first, of [`SHARES`].
    share: u32,
    bins: [u8; 2],
}

const SHARES: u32 = 1 << 27;

impl Table {
    fn new(corners: [Scaled; 2], states: &[Scaled]) -> (Self, Vec<u16>) {
        let mut table = Self {
            slots: [Slot::default(); BINS],
            first: [0; BINS + 1],
            listed: 0,
            least: 0.0,
            corners,
        };
        let exponents: Vec<_> = states.iter().map(|state| table.exponent(state)).collect();
        table.least = exponents.iter().copied().fold(f32::INFINITY, f32::min);
        let bins: Vec<_> = exponents.into_iter().map(|exponent| table.bin(exponent)).collect();
        let mut counts = [0; BINS];
        for bin in &bins {
            counts[*bin as usize] += 1;
        }
        let mut masses = [0.0; BINS];
        let mut total = 0.0;
        for (bin, count) in counts.into_iter().enumerate() {
            let bound = f64::from(-(bin as f32) * STEP).exp();
            table.listed = bin as u32;
            masses[bin] = states.len() as f64 * bound;
            if masses[bin] < UNLISTED * total || bin == BINS - 1 {
                break;
            }
            masses[bin] = f64::from(count) * bound;
            total += masses[bin];
            table.first[bin + 1] = table.first[bin] + count;
        }
        let mut next = table.first;
        let mut rows = vec![0; table.first[table.listed as usize] as usize];
        for (row, bin) in (0..=u16::MAX).zip(bins).filter(|(_, bin)| *bin < table.listed) {
            let next = &mut next[bin as usize];
            rows[*next as usize] = row;
            *next += 1;
        }
        table.slots = alias(masses);
        (table, rows)
    }

    /// A little less than the least `|z − state|²` in the box.
    fn exponent(&self, state: &Scaled) -> f32 {
        let [low, high] = &self.corners;
        let nearest = array::from_fn(|k| state[k].max(low[k]).min(high[k]));
        // Beyond what rounding can do.
        distance2(state, &nearest) * (1.0 - 1e-5) - 1e-5
    }

    fn bin(&self, exponent: f32) -> u32 {
        (((exponent - self.least) / STEP) as u32).min(BINS as u32 - 1)
    }

    /// Exponent of the bound of a bin's weights.
    fn bound(&self, bin: u32) -> f32 {
        self.least + bin as f32 * STEP
    }
}

/// Slots that together give each bin its share of the masses: Vose (1991).
fn alias(masses: [f64; BINS]) -> [Slot; BINS] {
    let mean = masses.iter().sum::<f64>() / BINS as f64;
    let mut left = masses.map(|mass| mass / mean);
    let mut slots = [Slot::default(); BINS];
    let (mut poor, mut rich): (Vec<usize>, Vec<usize>) = (0..BINS).partition(|k| left[*k] < 1.0);
    while let Some(k) = poor.pop().or_else(|| rich.pop()) {
        let giver = rich.last().copied().unwrap_or(k);
        let share = left[k].min(1.0);
        slots[k] = Slot {
            share: (share * f64::from(SHARES)).round() as u32,
            bins: [k as u8, giver as u8],
        };
        left[giver] -= 1.0 - share;
        if giver != k && left[giver] < 1.0 {
            poor.extend(rich.pop());
        }
    }
    slots
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    fn proposals() -> Option<Proposals> {
        let whitened: Vec<f64> = (0..4 * 900).map(|k| 2.0 * (0.7 * k as f64).sin()).collect();
        Proposals::new(&whitened, 4, 0.5)
    }

    /// Slots give each bin its share of the masses, and none to a bin without mass.
    #[test]
    fn slots_hold_the_masses() {
        let masses: [f64; BINS] = array::from_fn(|k| ((k * 7) % 5) as f64 * 0.9_f64.powi(k as i32));
        let mut shares = [0.0; BINS];
        for slot in alias(masses) {
            let share = f64::from(slot.share) / f64::from(SHARES) / BINS as f64;
            shares[usize::from(slot.bins[0])] += share;
            shares[usize::from(slot.bins[1])] += 1.0 / BINS as f64 - share;
        }
        let total: f64 = masses.iter().sum();
        for (share, mass) in shares.into_iter().zip(masses) {
            assert!((share - mass / total).abs() < 1e-8, "{share} {mass}");
        }
    }

    /// Every state is in the box of its table, and there no row weighs more than its bin's bound:
    /// neither the rows listed, nor any other.
    #[test]
    fn bounds_hold() {
        assert!(proposals().is_some());
        if let Some(proposals) = proposals() {
            assert!(proposals.tables.len() > 10);
            for z in &proposals.states {
                let Some(table) = proposals.table(z) else { continue };
                let table = &proposals.tables[table as usize];
                assert!(table.exponent(z) <= 0.0);
                for bin in 0..table.listed {
                    let [first, beyond] = [0, 1].map(|k| table.first[bin as usize + k] as usize);
                    for row in &proposals.rows[first..beyond] {
                        let state = &proposals.states[usize::from(*row)];
                        assert_eq!(table.bin(table.exponent(state)), bin);
                        assert!(distance2(state, z) >= table.bound(bin));
                    }
                }
                for state in &proposals.states {
                    assert!(distance2(state, z) >= table.bound(table.bin(table.exponent(state))));
                }
            }
        }
    }

    /// Far from the catalogue, of many components or many rows: there are no proposals.
    #[test]
    fn proposals_end_somewhere() {
        let mut rng = rand_chacha::ChaCha8Rng::from_seed([1; 32]);
        assert!(proposals().is_some());
        if let Some(proposals) = proposals() {
            assert!(proposals.begin(&[0.5; 4], 0.5, &mut rng).is_some());
            assert!(proposals.begin(&[0.5, 0.5, 9.0, 0.5], 0.5, &mut rng).is_none());
        }
        assert!(Proposals::new(&[0.0; 60], 6, 0.5).is_none());
        assert!(Proposals::new(&vec![0.0; MAX_ROWS + 1], 1, 0.5).is_none());
    }
}
