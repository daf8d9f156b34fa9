//! Maps of where members are and have been, counted while they are followed.
//!
//! Whole numbers are added up, so the counts depend neither on threads nor on chunks nor on the
//! order of the members, and take the same memory however many there are.

use std::sync::{Mutex, PoisonError};

use crate::ensemble::{Member, Status};
use crate::error::{DriftError, finite, positive, product, room};
use crate::field::Vec2;

/// Cells of one length along one axis; a cell holds its lower edge and not its upper one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cells {
    /// Lower edge of the first.
    pub start: f64,
    /// Length, above 0.
    pub size: f64,
    /// Number, above 0.
    pub count: usize,
}

impl Cells {
    /// Place counted in cells from the lower edge of the first.
    fn place(&self, at: f64) -> f64 {
        (at - self.start) / self.size
    }

    /// Cell of a place.
    fn cell(&self, place: f64) -> Option<usize> {
        let cell = place.floor();
        (cell >= 0.0 && cell < self.count as f64).then_some(cell as usize)
    }
}

/// What is mapped: a grid of cells, the times of the maps, and how closely members are watched
/// between them.
#[derive(Debug, Clone)]
pub struct MapGrid {
    x: Cells,
    y: Cells,
    times: Vec<f64>,
    samples: Vec<f64>,
    /// Which sample each map time is.
    sample_of_map: Vec<usize>,
}

impl MapGrid {
    /// Maps at `times`, of members whose positions are sampled at `samples`; both increase, and
    /// each of the times is among the samples.
    pub fn new(x: Cells, y: Cells, times: Vec<f64>, samples: Vec<f64>) -> Result<Self, DriftError> {
        for (name, cells) in [("map x", x), ("map y", y)] {
            positive(name, cells.size)?;
            positive(name, cells.count as f64)?;
            finite(name, &[cells.start])?;
        }
        product("map cells", &[times.len() + 1, y.count, x.count])?;
        for (name, times) in [("map times", &times), ("map samples", &samples)] {
            finite(name, times)?;
            if times.is_empty() || !times.is_sorted_by(|a, b| a < b) {
                return Err(DriftError::invalid(name, format!("{times:?}"), "they must increase"));
            }
        }
        let sample_of_map = (times.iter())
            .map(|t| {
                let place = samples.partition_point(|s| s < t);
                (samples.get(place).filter(|s| *s == t).map(|_| place)).ok_or_else(|| {
                    DriftError::invalid("map time", t, "it is not among the samples")
                })
            })
            .collect::<Result<_, _>>()?;
        Ok(Self { x, y, times, samples, sample_of_map })
    }

    /// Times at which the positions of members are sampled.
    pub fn samples(&self) -> &[f64] {
        &self.samples
    }

    fn cells(&self) -> usize {
        self.x.count * self.y.count
    }

    fn cell(&self, x: Vec2) -> Option<usize> {
        let column = self.x.cell(self.x.place(x.x))?;
        Some(self.y.cell(self.y.place(x.y))? * self.x.count + column)
    }

    /// Calls `visit` for the cells that the line between two positions goes through, in order.
    ///
    /// From cell to cell across the nearer of the edges ahead: Amanatides & Woo (1987), A fast
    /// voxel traversal algorithm for ray tracing. The parameter of an edge is worked out anew from
    /// its index, so that rounding does not add up, and the edges left to cross are counted, so
    /// that the walk ends in the cell of the end point. Through a corner it goes diagonally.
    fn cross(&self, from: Vec2, to: Vec2, mut visit: impl FnMut(usize)) {
        let axes = [self.x, self.y];
        let from = [axes[0].place(from.x), axes[1].place(from.y)];
        let to = [axes[0].place(to.x), axes[1].place(to.y)];
        let length = [to[0] - from[0], to[1] - from[1]];
        // The part of the line within the grid (Liang & Barsky 1984).
        let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
        for k in 0..2 {
            let end = axes[k].count as f64;
            if length[k] == 0.0 {
                if axes[k].cell(from[k]).is_none() {
                    return;
                }
                continue;
            }
            let (a, b) = (-from[k] / length[k], (end - from[k]) / length[k]);
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
        if enter > leave {
            return;
        }
        // Exactly the end points where they lie within.
        let at = |s: f64, k: usize| match s {
            0.0 => from[k],
            1.0 => to[k],
            _ => from[k] + s * length[k],
        };
        let whole =
            |place: f64, k: usize| (place.floor() as i64).clamp(0, axes[k].count as i64 - 1);
        let mut cell = [0, 1].map(|k| whole(at(enter, k), k));
        let end = [0, 1].map(|k| whole(at(leave, k), k));
        let mut left = [0, 1].map(|k| (end[k] - cell[k]).abs());
        loop {
            visit(cell[1] as usize * axes[0].count + cell[0] as usize);
            if left == [0, 0] {
                return;
            }
            let edge = [0, 1].map(|k| {
                let edge = cell[k] + i64::from(length[k] > 0.0);
                if left[k] == 0 { f64::INFINITY } else { (edge as f64 - from[k]) / length[k] }
            });
            let nearer = edge[0].min(edge[1]);
            for k in 0..2 {
                if left[k] > 0 && edge[k] == nearer {
                    cell[k] += if length[k] > 0.0 { 1 } else { -1 };
                    left[k] -= 1;
                }
            }
        }
    }
}

/// Numbers of members.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Counts {
    /// Afloat in each cell at each map time: (time, y, x).
    pub present: Vec<u32>,
    /// Come to each cell for the first time within each interval that ends at a map time, and
    /// after the last of them: (time + 1, y, x).
    pub arrived: Vec<u32>,
    /// Not in the grid at each map time: afloat beyond it or the sea's data, or not yet released.
    pub outside: Vec<u32>,
    /// Stranded by each map time.
    pub stranded: Vec<u32>,
}

impl Counts {
    fn zero(grid: &MapGrid) -> Result<Self, DriftError> {
        let (times, cells) = (grid.times.len(), grid.cells());
        Ok(Self {
            present: zeros(times * cells)?,
            arrived: zeros((times + 1) * cells)?,
            outside: zeros(times)?,
            stranded: zeros(times)?,
        })
    }

    fn add(&mut self, other: &Self) {
        let pairs = [
            (&mut self.present, &other.present),
            (&mut self.arrived, &other.arrived),
            (&mut self.outside, &other.outside),
            (&mut self.stranded, &other.stranded),
        ];
        for (mine, theirs) in pairs {
            mine.iter_mut().zip(theirs).for_each(|(mine, theirs)| *mine += theirs);
        }
    }
}

fn zeros<T: Default + Clone>(count: usize) -> Result<Vec<T>, DriftError> {
    let mut values = room("map cells", count)?;
    values.resize(count, T::default());
    Ok(values)
}

/// What one thread counts, and the cells that the member at hand has been to.
struct Counter {
    counts: Counts,
    been: Vec<bool>,
    visited: Vec<usize>,
}

impl Counter {
    fn count(&mut self, grid: &MapGrid, member: &Member) {
        let Self { counts, been, visited } = self;
        let (cells, track) = (grid.cells(), &member.track);
        let ashore = member.stranding.map_or(f64::INFINITY, |(t, _)| t);
        for (map, (t, sample)) in grid.times.iter().zip(&grid.sample_of_map).enumerate() {
            if ashore <= *t {
                counts.stranded[map] += 1;
                continue;
            }
            match track.get(*sample).and_then(|x| grid.cell(*x)) {
                Some(cell) => counts.present[map * cells + cell] += 1,
                None => counts.outside[map] += 1,
            }
        }
        let stations = grid.samples.iter().copied().zip(track.iter().copied());
        let mut before = None;
        let mut interval = 0;
        // Before its release a member is nowhere.
        for (t, x) in stations.chain(member.stranding).filter(|(_, x)| x.x.is_finite()) {
            while grid.times.get(interval).is_some_and(|end| *end < t) {
                interval += 1;
            }
            grid.cross(before.unwrap_or(x), x, |cell| {
                if !been[cell] {
                    been[cell] = true;
                    visited.push(cell);
                    counts.arrived[interval * cells + cell] += 1;
                }
            });
            before = Some(x);
        }
        for cell in visited.drain(..) {
            been[cell] = false;
        }
    }
}

/// Maps being counted, by each thread for itself.
pub struct Maps {
    grid: MapGrid,
    counters: Vec<Mutex<Counter>>,
}

impl Maps {
    /// Nothing counted yet, for so many threads.
    pub fn new(grid: MapGrid, threads: usize) -> Result<Self, DriftError> {
        let counter = || -> Result<Counter, DriftError> {
            Ok(Counter {
                counts: Counts::zero(&grid)?,
                been: zeros(grid.cells())?,
                visited: Vec::new(),
            })
        };
        let counters =
            (0..threads.max(1)).map(|_| Ok(Mutex::new(counter()?))).collect::<Result<_, _>>()?;
        Ok(Self { grid, counters })
    }

    /// What is mapped.
    pub fn grid(&self) -> &MapGrid {
        &self.grid
    }

    /// Counts a member whose track is known; a failed one is not counted.
    pub fn count(&self, member: &Member) {
        if member.status == Status::Failed {
            return;
        }
        let thread = rayon::current_thread_index().unwrap_or(0) % self.counters.len();
        // Counts are sound at any time: nothing between two of them can panic.
        let mut counter = self.counters[thread].lock().unwrap_or_else(PoisonError::into_inner);
        counter.count(&self.grid, member);
    }

    /// The counts of all threads.
    pub fn total(&self) -> Result<Counts, DriftError> {
        let mut total = Counts::zero(&self.grid)?;
        for counter in &self.counters {
            total.add(&counter.lock().unwrap_or_else(PoisonError::into_inner).counts);
        }
        Ok(total)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four columns and three rows of unit cells from (0, 0).
    fn grid(times: &[f64]) -> Result<MapGrid, DriftError> {
        let cells = |count| Cells { start: 0.0, size: 1.0, count };
        MapGrid::new(cells(4), cells(3), times.to_vec(), vec![0.0, 0.5, 1.0])
    }

    /// (column, row) of the cells that a line goes through.
    fn crossed(from: (f64, f64), to: (f64, f64)) -> Result<Vec<(usize, usize)>, DriftError> {
        let mut cells = Vec::new();
        grid(&[1.0])?.cross(Vec2::new(from.0, from.1), Vec2::new(to.0, to.1), |cell| {
            cells.push((cell % 4, cell / 4));
        });
        Ok(cells)
    }

    #[test]
    fn cells_count_from_their_first_edge() {
        let cells = Cells { start: -3.0, size: 0.5, count: 4 };
        let found = [-3.01, -3.0, -2.6, -2.5, -1.01, -1.0].map(|at| cells.cell(cells.place(at)));
        assert_eq!(found, [None, Some(0), Some(0), Some(1), Some(3), None]);
    }

    #[test]
    fn a_line_goes_through_its_cells_in_order() -> Result<(), DriftError> {
        let through = [(0, 0), (1, 0), (2, 0), (2, 1), (3, 1)];
        assert_eq!(crossed((0.5, 0.25), (3.5, 1.5))?, through);
        assert_eq!(
            crossed((3.5, 1.5), (0.5, 0.25))?,
            through.into_iter().rev().collect::<Vec<_>>()
        );
        assert_eq!(crossed((0.5, 0.5), (0.5, 0.5))?, [(0, 0)]);
        assert_eq!(crossed((1.5, 2.5), (1.5, 0.5))?, [(1, 2), (1, 1), (1, 0)]);
        Ok(())
    }

    #[test]
    fn through_a_corner_it_goes_diagonally() -> Result<(), DriftError> {
        assert_eq!(crossed((0.5, 0.5), (2.5, 2.5))?, [(0, 0), (1, 1), (2, 2)]);
        assert_eq!(crossed((2.5, 0.5), (0.5, 2.5))?, [(2, 0), (1, 1), (0, 2)]);
        Ok(())
    }

    #[test]
    fn edges_belong_to_the_cell_above() -> Result<(), DriftError> {
        assert_eq!(crossed((1.0, 1.0), (1.0, 1.0))?, [(1, 1)]);
        assert_eq!(crossed((1.0, 0.5), (0.5, 0.5))?, [(1, 0), (0, 0)]);
        assert_eq!(crossed((1.5, 0.5), (1.0, 0.5))?, [(1, 0)]);
        assert_eq!(crossed((4.0, 0.5), (4.0, 1.5))?, []);
        assert_eq!(crossed((0.5, 3.0), (1.5, 3.0))?, []);
        Ok(())
    }

    #[test]
    fn what_lies_beyond_the_grid_is_left_out() -> Result<(), DriftError> {
        assert_eq!(crossed((-1e9, 0.5), (1e9, 0.5))?, [(0, 0), (1, 0), (2, 0), (3, 0)]);
        assert_eq!(crossed((-1.0, 1.5), (1.0, 3.5))?, [(0, 2)]);
        assert_eq!(crossed((3.5, 1.5), (9.5, 1.5))?, [(3, 1)]);
        assert_eq!(crossed((-2.0, 1.0), (1.0, -2.0))?, []);
        assert_eq!(crossed((5.0, 0.5), (6.0, 0.5))?, []);
        assert_eq!(crossed((-1.0, 0.5), (0.0, 0.5))?, [(0, 0)]);
        Ok(())
    }

    #[test]
    fn every_cell_sampled_along_a_line_is_crossed() -> Result<(), DriftError> {
        for k in 0..500 {
            let place = |n: usize| {
                let angle = (37 * k + n) as f64;
                (6.0 * angle.sin() + 2.0, 5.0 * (1.7 * angle).cos() + 1.5)
            };
            let (from, to) = (place(0), place(1));
            let cells = crossed(from, to)?;
            let mut sampled = Vec::new();
            for step in 0..=4000 {
                let s = step as f64 / 4000.0;
                let (x, y) = (from.0 + s * (to.0 - from.0), from.1 + s * (to.1 - from.1));
                if (0.0..4.0).contains(&x) && (0.0..3.0).contains(&y) {
                    sampled.push((x as usize, y as usize));
                }
            }
            sampled.dedup();
            // The sampling may miss a corner, the walk may not miss a sample.
            let mut walk = cells.iter();
            assert!(sampled.iter().all(|cell| walk.any(|crossed| crossed == cell)), "{cells:?}");
            let neighbours =
                cells.windows(2).all(|w| w[0].0.abs_diff(w[1].0) + w[0].1.abs_diff(w[1].1) == 1);
            assert!(neighbours, "{cells:?}");
        }
        Ok(())
    }

    fn member(track: &[(f64, f64)], stranding: Option<(f64, (f64, f64))>) -> Member {
        let place = |(x, y): (f64, f64)| Vec2::new(x, y);
        Member {
            status: if stranding.is_some() { Status::Stranded } else { Status::Afloat },
            stranding: stranding.map(|(t, x)| (t, place(x))),
            positions: Vec::new(),
            track: track.iter().copied().map(place).collect(),
            entries: Vec::new(),
            failure: None,
        }
    }

    #[test]
    fn members_are_counted_once_a_cell_and_nowhere_twice_at_a_time() -> Result<(), DriftError> {
        let maps = Maps::new(grid(&[0.0, 0.5])?, 1)?;
        maps.count(&member(&[(0.5, 0.5), (1.5, 0.5), (0.5, 0.5)], None));
        maps.count(&member(&[(0.5, 0.5), (9.0, 0.5), (9.0, 2.5)], None));
        maps.count(&member(&[(0.5, 0.5)], Some((0.25, (0.5, 1.5)))));
        maps.count(&Member { status: Status::Failed, ..member(&[(0.5, 0.5)], None) });
        let counts = maps.total()?;
        let at = |values: &[u32], map: usize, x: usize, y: usize| values[map * 12 + y * 4 + x];
        assert_eq!(at(&counts.present, 0, 0, 0), 3);
        assert_eq!(at(&counts.present, 1, 1, 0), 1);
        assert_eq!(counts.present.iter().sum::<u32>(), 4);
        assert_eq!((counts.outside, counts.stranded), (vec![0, 1], vec![0, 1]));
        assert_eq!(at(&counts.arrived, 0, 0, 0), 3);
        assert_eq!([0, 1, 2, 3].map(|x| at(&counts.arrived, 1, x, 0)), [0, 2, 1, 1]);
        assert_eq!(at(&counts.arrived, 1, 0, 1), 1);
        assert_eq!(counts.arrived.iter().sum::<u32>(), 8);
        Ok(())
    }

    #[test]
    fn refuses_what_is_no_map() {
        let cells = Cells { start: 0.0, size: 1.0, count: 2 };
        let new = |x, times: &[f64]| MapGrid::new(x, cells, times.to_vec(), vec![0.0, 1.0]);
        assert!(new(cells, &[0.0, 1.0]).is_ok());
        assert!(new(cells, &[-0.0, 1.0]).is_ok(), "a zero is a zero");
        assert!(new(cells, &[0.5]).is_err());
        assert!(new(cells, &[]).is_err());
        assert!(new(cells, &[1.0, 0.0]).is_err());
        assert!(new(Cells { size: 0.0, ..cells }, &[0.0]).is_err());
        assert!(new(Cells { count: 0, ..cells }, &[0.0]).is_err());
    }
}
