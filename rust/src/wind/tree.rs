//! Draws of catalogue rows where few of them have weight: a k-d tree is searched for those.

use pulp::{Simd, WithSimd};
use rand::{Rng, RngExt};

use super::abreast::{
    ABREAST, Abreast, LEAST_TOTAL, LOOSEST, MAX_DIMENSION, MAX_TRIALS, State, greater,
    less_distance2, part, power_above,
};
use crate::lanes::dispatch_narrow;

/// Most leaves.
const MAX_LEAVES: usize = 1 << 14;
/// What a trial costs, and what the bounds of a block [ns], about.
const COST_OF_TRIAL: f64 = 70.0;
const COST_OF_BLOCK: f64 = 56.0;
/// Blocks are opened until what the closed ones bound is no more than this share of the leaves'.
const CLOSED: f32 = 0.3;

/// The rows of a catalogue in the leaves of a k-d tree, of about as many rows each. Neighbours make
/// a block. Where few of many leaves count, blocks are taken as leaves of their own and make blocks
/// of the next level: those that bound little are left closed.
#[derive(Debug, Clone, Default)]
pub(super) struct Tree {
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

impl Tree {
    /// As many leaves as make draws at some states cheapest, and what they cost [ns], about.
    pub(super) fn cheapest(
        whitened: &[f64],
        d: usize,
        bandwidth: f64,
        states: &[State],
    ) -> (Self, f64) {
        let cost = |tree: &Self| -> f64 {
            let costs = states.iter().map(|z| {
                let (trials, blocks) = tree.trials(&z[..d], bandwidth);
                COST_OF_TRIAL * trials + COST_OF_BLOCK * blocks as f64
            });
            costs.sum()
        };
        let mut count = ABREAST;
        let mut best = Self::new(whitened, d, count);
        let mut least = cost(&best);
        // Twice as many, until that is no cheaper.
        while count < MAX_LEAVES.min(whitened.len() / d) {
            count *= 2;
            let tree = Self::new(whitened, d, count);
            let cost = cost(&tree);
            if least <= cost {
                break;
            }
            (least, best) = (cost, tree);
        }
        (best, least)
    }

    /// Halves the rows until there are `count` parts, each at the median of its most varied
    /// component.
    fn new(whitened: &[f64], d: usize, count: usize) -> Self {
        let mut parts = vec![(0..(whitened.len() / d) as u32).collect::<Vec<u32>>()];
        while parts.len() < count {
            let halves = parts.into_iter().flat_map(|rows| {
                let middle = rows.len() / 2;
                part(rows, middle, whitened, d, d)
            });
            parts = halves.collect();
        }
        let rows = parts.concat();
        let states =
            rows.iter().flat_map(|row| &whitened[*row as usize * d..][..d]).copied().collect();
        let mut leaves = Self { rows, states, ..Self::default() };
        let mut sizes: Vec<usize> = parts.iter().map(Vec::len).collect();
        leaves.push(&sizes, d, 0);
        leaves.inner = leaves.sizes.len();
        while sizes.len() > 2 * ABREAST {
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
            let (mut size, mut first) = (Abreast::splat(0.0), [0; ABREAST]);
            // Spare places lie beyond everything.
            let mut boxes = vec![[Abreast::splat(f32::INFINITY); 2]; d];
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
        let total: f64 = totals.0.iter().map(|total| f64::from(*total)).sum();
        (total / weights.max(f64::MIN_POSITIVE), count)
    }

    /// What work at the whitened state `z` needs.
    fn at<'a>(&'a self, z: &'a [f64], bandwidth: f64, scratch: &'a mut Scratch) -> At<'a> {
        scratch.bound.resize(self.sizes.len(), Abreast::splat(0.0));
        scratch.sum.resize(self.sizes.len(), Abreast::splat(0.0));
        scratch.block.resize(self.sizes.len(), 0);
        At { leaves: self, z, scale: scale(bandwidth), scratch }
    }

    /// Works out the bounds of the leaves at `z`.
    fn bounds(&self, z: &[f64], bandwidth: f64, scratch: &mut Scratch) -> Bounded {
        dispatch_narrow(Bounds(self.at(z, bandwidth, scratch)))
    }

    /// Draws a row, or gives up after many trials.
    pub(super) fn draw<R: Rng>(
        &self,
        z: &[f64],
        bandwidth: f64,
        rng: &mut R,
        scratch: &mut Scratch,
    ) -> Option<usize> {
        dispatch_narrow(Draw(self.at(z, bandwidth, scratch), rng))
    }
}

/// Room for the bounds of the leaves at one state.
#[derive(Debug, Clone, Default)]
pub(super) struct Scratch {
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

/// The leaves, at a state.
struct At<'a> {
    leaves: &'a Tree,
    z: &'a [f64],
    scale: f64,
    scratch: &'a mut Scratch,
}

/// Works out the bounds of the leaves that count.
struct Bounds<'a>(At<'a>);

/// Draws a row by them.
struct Draw<'a, R>(At<'a>, &'a mut R);

// The usual order has code of its own.

impl WithSimd for Bounds<'_> {
    type Output = Bounded;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) -> Bounded {
        let d = self.0.z.len();
        if d == 4 { self.0.bounds(4) } else { self.0.bounds(d) }
    }
}

impl<R: Rng> WithSimd for Draw<'_, R> {
    type Output = Option<usize>;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) -> Option<usize> {
        let d = self.0.z.len();
        if d == 4 { self.0.draw(simd, 4, self.1) } else { self.0.draw(simd, d, self.1) }
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
        let zero = Abreast::splat(0.0);
        let mut most = Abreast::splat(f32::NEG_INFINITY);
        let boxes = leaves.boxes[top.start * d..].chunks_exact(d);
        for (boxes, bound) in boxes.zip(bound.iter_mut()) {
            let apart = less_distance2(zero, boxes, &place[..d]);
            most = Abreast::of(|k| greater(apart[k], most[k]));
            *bound = apart;
        }
        let nearest = -most.0.into_iter().fold(f32::NEG_INFINITY, greater);
        for ((bound, block), id) in bound.iter_mut().zip(block.iter_mut()).zip(top) {
            let apart = *bound;
            *bound = Abreast::of(|k| power_above((-apart[k] - nearest) * scale));
            *block = id as u32;
        }
        // Where bounds of blocks count for much they are replaced by closer ones.
        let mut closed_blocks = count;
        loop {
            // Of the leaves, and of the blocks that are closed.
            let mut totals = [Abreast::splat(0.0); 2];
            for (id, bound) in block[..count].iter().zip(bound.iter()) {
                let id = *id as usize;
                let (sizes, total) =
                    (&leaves.sizes[id], &mut totals[usize::from(id >= leaves.inner)]);
                let before = *total;
                *total = Abreast::of(|k| before[k] + bound[k] * sizes[k]);
            }
            let [open, closed] = totals.map(|total| total.0.iter().sum::<f32>());
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
                let apart = less_distance2(zero, boxes, &place[..d]);
                bound[at] = Abreast::of(|k| power_above((-apart[k] - nearest) * scale));
            }
        }
        let mut totals = Abreast::splat(0.0);
        for ((id, bound), sum) in block[..count].iter().zip(bound.iter()).zip(sum.iter_mut()) {
            let sizes = &leaves.sizes[*id as usize];
            totals = Abreast::of(|k| totals[k] + bound[k] * sizes[k]);
            *sum = totals;
        }
        Bounded { nearest: f64::from(nearest), totals, count }
    }

    #[inline(always)]
    fn draw<S: Simd, R: Rng>(&mut self, simd: S, d: usize, rng: &mut R) -> Option<usize> {
        let Bounded { nearest, totals, count } = self.bounds(d);
        let Self { leaves, z, scale, scratch } = self;
        let z = &z[..d];
        let Scratch { block, bound, sum } = scratch;
        let sums = totals.running(simd);
        let total = sums[ABREAST - 1];
        // All rows are so far that single precision does not tell their weights apart.
        if total < LEAST_TOTAL {
            return None;
        }
        for _ in 0..MAX_TRIALS {
            // 24 bits choose the leaf, the other 40 the row in it.
            let bits: u64 = rng.random();
            let at = (bits >> 40) as f32 / (1_u32 << 24) as f32 * total;
            let place = sums.first_above(simd, at);
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
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn leaves_hold_every_row_once() {
        let whitened: Vec<f64> = (0..4 * 333).map(|k| (0.7 * k as f64).sin()).collect();
        let leaves = Tree::new(&whitened, 4, 64);
        let mut rows = leaves.rows.clone();
        rows.sort_unstable();
        assert!(rows.into_iter().eq(0..333));
        assert_eq!((leaves.top, leaves.children.last()), (4, Some(&0)));
        let (of_leaves, of_blocks) = leaves.sizes.split_at(leaves.top);
        for sizes in [of_leaves, of_blocks] {
            assert_eq!(sizes.iter().flat_map(|sizes| sizes.0).sum::<f32>(), 333.0);
        }
    }

    /// The bound of a leaf is above the weight of each row in it, and every row has one.
    #[test]
    fn bounds_hold() {
        let whitened: Vec<f64> = (0..4 * 500).map(|k| 2.0 * (0.7 * k as f64).sin()).collect();
        for count in [16, 64, 512] {
            let leaves = Tree::new(&whitened, 4, count);
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
                        bounds.0.iter().enumerate().filter(|(_, bound)| **bound > 0.0)
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
        let tree = Tree::new(&whitened, 4, 4096);
        let (trials, blocks) = tree.trials(place, 0.05);
        assert!(trials < 4.0, "{trials}");
        assert!(blocks < 64, "{blocks}");
        // As many it takes: each reads four words of random bits.
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..1000 {
            assert!(tree.draw(place, 0.05, &mut rng, &mut Scratch::default()).is_some());
        }
        let taken = rng.get_word_pos() as f64 / 4000.0;
        assert!((taken / trials - 1.0).abs() < 0.1, "{taken} {trials}");
        // Where the nearest row is a thousand bandwidths away, none of them is drawn for another.
        let tree = Tree::new(&whitened, 4, 8192);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let aside: Vec<f64> = place.iter().map(|z| z + 0.01).collect();
        let drawn = tree.draw(&aside, 1e-5, &mut rng, &mut Scratch::default());
        assert!(drawn.is_none_or(|row| row == 100), "{drawn:?}");
        // The search ends even where the state is no number.
        let tree = Tree::new(&whitened, 4, 4096);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let drawn = tree.draw(&[f64::NAN; 4], 0.05, &mut rng, &mut Scratch::default());
        assert!(drawn.is_none_or(|row| row < 4096));
    }
}
