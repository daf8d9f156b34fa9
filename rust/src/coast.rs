//! Coasts, and the first time a trajectory meets one.

use rstar::primitives::Line;
use rstar::{AABB, PointDistance, RTree};

use crate::error::{DriftError, positive};
use crate::field::Vec2;
use crate::model::Piece;

/// Side of the coast line that the body floats on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// It floats inside and strands on leaving.
    Inside,
    /// It floats outside and strands on entering.
    Outside,
}

/// A closed coast line: a circle, or the rings of polygons (islands and holes by parity).
#[derive(Debug, Clone)]
pub struct Coast {
    shape: Shape,
    side: Side,
}

#[derive(Debug, Clone)]
enum Shape {
    Circle { center: Vec2, radius: f64 },
    Polygons { segments: RTree<Line<[f64; 2]>>, east: f64 },
}

/// Shortest stretch of time between two looks at the coast, as a share of the tide period `T`. At
/// a tidal speed `v`, a contact shorter than this and less than `5e-5·vT` deep may be passed over:
/// equations.md (7).
const RESOLUTION: f64 = 1.0 / 128.0;

/// What share of the longest stride that may be safe is tried.
const HOPE: f64 = 0.9;

impl Coast {
    /// A circular coast.
    pub fn circle(center: Vec2, radius: f64, side: Side) -> Result<Self, DriftError> {
        positive("coast radius", radius)?;
        if !(center.x.is_finite() && center.y.is_finite()) {
            return Err(DriftError::invalid("coast center", center, "it must be finite"));
        }
        Ok(Self { shape: Shape::Circle { center, radius }, side })
    }

    /// Coasts from rings of at least three different points; each ring is closed here.
    pub fn polygons(rings: &[Vec<Vec2>], side: Side) -> Result<Self, DriftError> {
        let mut segments = Vec::new();
        let mut east = f64::NEG_INFINITY;
        for ring in rings {
            let mut points: Vec<[f64; 2]> = ring.iter().map(|x| [x.x, x.y]).collect();
            points.dedup();
            if points.len() > 1 && points.first() == points.last() {
                points.pop();
            }
            if points.len() < 3 || points.iter().flatten().any(|c| !c.is_finite()) {
                return Err(DriftError::invalid(
                    "coast ring",
                    format!("{points:?}"),
                    "it needs at least 3 different finite points",
                ));
            }
            for (k, from) in points.iter().enumerate() {
                east = east.max(from[0]);
                segments.push(Line::new(*from, points[(k + 1) % points.len()]));
            }
        }
        if segments.is_empty() {
            return Err(DriftError::invalid("coast", "no ring", "it needs at least one ring"));
        }
        Ok(Self { shape: Shape::Polygons { segments: RTree::bulk_load(segments), east }, side })
    }

    /// Distance to the coast line, above 0 where the body floats; NaN of no place.
    pub fn clearance(&self, x: Vec2) -> f64 {
        if !(x.x.is_finite() && x.y.is_finite()) {
            return f64::NAN;
        }
        let outside = match &self.shape {
            Shape::Circle { center, radius } => (x - center).norm() - radius,
            Shape::Polygons { segments, east } => {
                let point = [x.x, x.y];
                let distance = (segments.nearest_neighbor(point))
                    .map_or(f64::INFINITY, |line| line.distance_2(&point).sqrt());
                if within(segments, *east, point) { -distance } else { distance }
            }
        };
        match self.side {
            Side::Inside => -outside,
            Side::Outside => outside,
        }
    }

    /// First time and place at which the reconstructed trajectory meets the coast in this piece.
    ///
    /// A piece whose reach does not touch the coast is passed over. Otherwise the trajectory is
    /// followed in strides that cannot jump over the coast: at no time is it nearer than the
    /// clearance at one end less the distance that the speed allows from there, so that a stride
    /// is safe while speed times length is below the sum of the clearances at its ends. One is
    /// tried that would be, if the clearance went on as it did; then one that is whatever it does.
    /// None is shorter than the resolution, and a change of sign is refined to rounding.
    pub fn first_crossing(
        &self,
        piece: &dyn Piece,
        period: f64,
    ) -> Result<Option<(f64, Vec2)>, DriftError> {
        let reach = piece.reach();
        if self.clearance(reach.center) > reach.radius {
            return Ok(None);
        }
        let (start, end) = piece.span();
        let mut t = start;
        let mut clearance = self.clearance(piece.position(t)?);
        if clearance <= 0.0 {
            return Ok(Some((t, piece.position(t)?)));
        }
        // What is no number is on neither side.
        let lost = |t| DriftError::Integration { t, reason: "the state is not finite" };
        if clearance.is_nan() {
            return Err(lost(t));
        }
        // How fast the coast came nearer in the stride before.
        let mut approach = reach.speed;
        while t < end {
            let safe = (clearance / reach.speed).max(RESOLUTION * period);
            let hopeful = HOPE * 2.0 * clearance / (reach.speed + approach);
            let mut next = end.min(t + hopeful.max(safe));
            let mut ahead = self.clearance(piece.position(next)?);
            if next > t + safe && reach.speed * (next - t) >= clearance + ahead {
                next = t + safe;
                ahead = self.clearance(piece.position(next)?);
            }
            if ahead.is_nan() {
                return Err(lost(next));
            }
            if ahead <= 0.0 {
                let crossing = self.root(piece, (t, clearance), (next, ahead))?;
                if !crossing.is_finite() {
                    return Err(lost(t));
                }
                return Ok(Some((crossing, piece.position(crossing)?)));
            }
            approach = ((clearance - ahead) / (next - t)).max(0.0);
            (t, clearance) = (next, ahead);
        }
        Ok(None)
    }

    /// Root of the clearance between two times of different sign: Illinois' false position.
    fn root(
        &self,
        piece: &dyn Piece,
        (mut a, mut fa): (f64, f64),
        (mut b, mut fb): (f64, f64),
    ) -> Result<f64, DriftError> {
        let tolerance = 4.0 * f64::EPSILON * b.abs();
        for _ in 0..200 {
            if fb == 0.0 || (b - a).abs() <= tolerance {
                break;
            }
            let c = b - fb * (b - a) / (fb - fa);
            let fc = self.clearance(piece.position(c)?);
            if fc * fb < 0.0 {
                (a, fa) = (b, fb);
            } else {
                fa /= 2.0;
            }
            (b, fb) = (c, fc);
        }
        Ok(b)
    }
}

/// Whether a point lies within the rings, by the parity of crossings of a ray to the east.
fn within(segments: &RTree<Line<[f64; 2]>>, east: f64, [x, y]: [f64; 2]) -> bool {
    if x > east {
        return false;
    }
    let ray = AABB::from_corners([x, y], [east, y]);
    let crossings = segments.locate_in_envelope_intersecting(ray).filter(|line| {
        let ([x0, y0], [x1, y1]) = (line.from, line.to);
        (y0 > y) != (y1 > y) && x < x0 + (y - y0) / (y1 - y0) * (x1 - x0)
    });
    crossings.count() % 2 == 1
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::f64::consts::{PI, TAU};

    use super::*;

    fn square_with_lake() -> Result<Coast, DriftError> {
        let ring = |half: f64| -> Vec<Vec2> {
            [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
                .map(|(x, y)| Vec2::new(half * x, half * y))
                .to_vec()
        };
        Coast::polygons(&[ring(2.0), ring(1.0)], Side::Outside)
    }

    #[test]
    fn clearance_has_the_sign_of_the_side() -> Result<(), DriftError> {
        let coast = square_with_lake()?;
        for (x, y, expected) in [
            (3.0, 0.0, 1.0),
            (1.5, 0.0, -0.5),
            (0.0, 0.25, 0.75),
            (-3.0, -3.0, 2f64.sqrt()),
            (0.0, -1.75, -0.25),
            // A ray through vertices counts each of them once.
            (-2.5, 2.0, 0.5),
            (-2.5, 1.0, 0.5),
        ] {
            let found = coast.clearance(Vec2::new(x, y));
            assert!((found - expected).abs() < 1e-12, "({x}, {y}): {found}");
        }
        let circle = Coast::circle(Vec2::new(1.0, 1.0), 0.3, Side::Inside)?;
        assert!((circle.clearance(Vec2::new(1.0, 1.1)) - 0.2).abs() < 1e-15);
        Ok(())
    }

    #[test]
    fn refuses_bad_rings() {
        assert!(Coast::polygons(&[], Side::Outside).is_err());
        let flat = vec![Vec2::zeros(), Vec2::new(1.0, 0.0), Vec2::zeros()];
        assert!(Coast::polygons(&[flat], Side::Outside).is_err());
        assert!(Coast::circle(Vec2::zeros(), 0.0, Side::Inside).is_err());
    }

    #[test]
    fn no_place_has_no_clearance() -> Result<(), DriftError> {
        for side in [Side::Inside, Side::Outside] {
            let circle = Coast::circle(Vec2::zeros(), 1.0, side)?;
            for x in [Vec2::new(f64::NAN, 0.0), Vec2::new(0.0, f64::INFINITY)] {
                assert!(circle.clearance(x).is_nan());
            }
        }
        Ok(())
    }

    /// A straight passage through a circle, as a piece of trajectory.
    struct Passage {
        offset: f64,
    }

    impl Piece for Passage {
        fn span(&self) -> (f64, f64) {
            (0.0, 4.0)
        }
        fn position(&self, t: f64) -> Result<Vec2, DriftError> {
            Ok(Vec2::new(t - 2.0, self.offset))
        }
        fn velocity(&self, _: f64) -> Result<Vec2, DriftError> {
            Ok(Vec2::new(1.0, 0.0))
        }
        fn mean(&self, _: f64) -> Result<Option<(Vec2, Vec2)>, DriftError> {
            Ok(None)
        }
        fn reach(&self) -> crate::model::Reach {
            crate::model::Reach { center: Vec2::new(0.0, self.offset), radius: 2.0, speed: 1.0 }
        }
    }

    #[test]
    fn first_crossing_is_the_first() -> Result<(), DriftError> {
        let circle = Coast::circle(Vec2::zeros(), 1.0, Side::Outside)?;
        let crossing = circle.first_crossing(&Passage { offset: 0.6 }, 0.1)?;
        assert!(
            crossing
                .is_some_and(|(t, x)| (t - 1.2).abs() < 1e-14 && (x.norm() - 1.0).abs() < 1e-14)
        );
        assert!(circle.first_crossing(&Passage { offset: 1.001 }, 0.1)?.is_none());
        let grazing = circle.first_crossing(&Passage { offset: 0.9999 }, 0.1)?;
        assert!(grazing.is_some_and(|(t, _)| t < 2.0));
        // What is lost on its way to the coast has not met it.
        for offset in [f64::NAN, f64::INFINITY] {
            let lost = circle.first_crossing(&Passage { offset }, 0.1);
            assert!(lost.is_err_and(|error| error.to_string().contains("state is not finite")));
        }
        Ok(())
    }

    /// To and fro along a line, and on; how often it was asked.
    struct Swing {
        from: f64,
        drift: f64,
        size: f64,
        phase: f64,
        /// How many times the speed that it has is its bound; of 1 it turns at once, else smoothly.
        bound: f64,
        asked: Cell<usize>,
    }

    impl Swing {
        const OMEGA: f64 = 7.0;

        fn at(&self, t: f64) -> f64 {
            let angle = Self::OMEGA * t + self.phase;
            let turn = angle / TAU;
            let zigzag = PI / 2.0 * (4.0 * (turn - (turn + 0.5).floor()).abs() - 1.0);
            let wave = if self.bound > 1.0 { angle.sin() } else { zigzag };
            self.from + self.drift * t + self.size * wave
        }

        fn speed(&self) -> f64 {
            self.bound * (self.drift.abs() + self.size * Self::OMEGA)
        }
    }

    impl Piece for Swing {
        fn span(&self) -> (f64, f64) {
            (0.0, 2.0)
        }
        fn position(&self, t: f64) -> Result<Vec2, DriftError> {
            self.asked.set(self.asked.get() + 1);
            Ok(Vec2::new(self.at(t), 0.0))
        }
        fn velocity(&self, _: f64) -> Result<Vec2, DriftError> {
            Ok(Vec2::zeros())
        }
        fn mean(&self, _: f64) -> Result<Option<(Vec2, Vec2)>, DriftError> {
            Ok(None)
        }
        fn reach(&self) -> crate::model::Reach {
            let center = Vec2::new(self.from, 0.0);
            crate::model::Reach { center, radius: 9.0, speed: self.speed() }
        }
    }

    /// A fine scan finds no earlier contact, and strides are fewer than those that are safe whatever
    /// comes.
    #[test]
    fn long_strides_jump_over_nothing() -> Result<(), DriftError> {
        let circle = Coast::circle(Vec2::zeros(), 1.0, Side::Outside)?;
        let (mut met, mut asked, mut plain) = (0, 0, 0);
        for k in 0..2000 {
            let wave = |factor: f64| 0.5 + 0.5 * (factor * f64::from(k)).sin();
            let size = 0.02 + 0.3 * wave(1.3);
            let swing = Swing {
                from: 1.01 + size + 0.6 * size * wave(0.7),
                drift: -0.3 * wave(2.1),
                size,
                phase: 6.0 * wave(3.3),
                bound: f64::from(1 + k % 2),
                asked: Cell::new(0),
            };
            let found = circle.first_crossing(&swing, 0.9)?;
            let until = found.map_or(2.0, |(t, _)| t - 1e-9);
            // A contact shorter than the resolution may be passed over.
            let below = |t: f64| swing.at(t) <= 1.0 && swing.at(t + 0.9 * RESOLUTION) <= 1.0;
            let scanned = (0..20_000).map(|n| 1e-4 * f64::from(n)).find(|t| below(*t));
            assert!(scanned.is_none_or(|t| t > until - 1e-4), "{k}: {scanned:?} {found:?}");
            if let Some((t, x)) = found {
                met += 1;
                assert!(
                    x.x == swing.at(t) && (t == 0.0 && x.x <= 1.0 || (x.x - 1.0).abs() < 1e-12)
                );
                continue;
            }
            asked += swing.asked.get();
            let mut t = 0.0;
            while t < 2.0 {
                t += ((swing.at(t) - 1.0) / swing.speed()).max(0.9 * RESOLUTION);
                plain += 1;
            }
        }
        assert!((200..1800).contains(&met), "{met}");
        assert!(asked < plain * 9 / 10, "{asked} {plain}");
        Ok(())
    }
}
