//! What a unit of speed is in the coordinates of a run: equations.md (42).

use crate::error::DriftError;
use crate::field::Vec2;

/// Mean radius of the earth [m] (IUGG).
const EARTH_RADIUS: f64 = 6_371_008.8;
const SECONDS_PER_DAY: f64 = 86_400.0;
/// The poles are singular in longitude.
const HIGHEST_LATITUDE: f64 = 89.0;

/// Coordinates of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Geometry {
    /// The plane, in any consistent units.
    Plane,
    /// Degrees east and north of a reference point of this latitude, and days; speeds in m/s.
    Sphere {
        /// Latitude of the reference point [degrees].
        latitude: f64,
    },
}

impl Geometry {
    /// Rate of the coordinates at `x` for each unit of speed toward east and north.
    pub fn metric(self, x: Vec2) -> Result<Vec2, DriftError> {
        match self {
            Self::Plane => Ok(Vec2::repeat(1.0)),
            Self::Sphere { latitude } => {
                let degrees = (SECONDS_PER_DAY / EARTH_RADIUS).to_degrees();
                let at = latitude + x.y;
                if at.is_nan() || at.abs() > HIGHEST_LATITUDE {
                    return Err(DriftError::OutsideDomain { x: x.x, y: x.y });
                }
                Ok(Vec2::new(degrees / at.to_radians().cos(), degrees))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_plane_has_no_metric() -> Result<(), DriftError> {
        assert_eq!(Geometry::Plane.metric(Vec2::new(3.0, 1e9))?, Vec2::repeat(1.0));
        Ok(())
    }

    /// A day at one metre a second is 86.4 km: round a parallel of `2πR cos φ`, or a meridian.
    #[test]
    fn a_unit_of_speed_on_the_sphere() -> Result<(), DriftError> {
        for (latitude, y) in [(0.0_f64, 0.0), (45.0, 2.5), (-60.0, -10.0), (80.0, 8.9)] {
            let metric = Geometry::Sphere { latitude }.metric(Vec2::new(170.0, y))?;
            let circle = std::f64::consts::TAU * 6_371_008.8;
            let parallel = circle * (latitude + y).to_radians().cos();
            assert!((metric.x * parallel / 360.0 - 86_400.0).abs() < 1e-6, "{latitude}, {y}");
            assert!((metric.y * circle / 360.0 - 86_400.0).abs() < 1e-6, "{latitude}, {y}");
        }
        Ok(())
    }

    #[test]
    fn poles_and_what_is_no_number_are_outside() {
        for (latitude, y) in [(88.0, 1.1), (-88.0, -1.1), (0.0, f64::NAN), (0.0, f64::INFINITY)] {
            let metric = Geometry::Sphere { latitude }.metric(Vec2::new(0.0, y));
            assert!(matches!(metric, Err(DriftError::OutsideDomain { .. })), "{latitude}, {y}");
        }
        assert!(Geometry::Sphere { latitude: 88.0 }.metric(Vec2::new(0.0, 1.0)).is_ok());
    }
}
