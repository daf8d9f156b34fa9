//! What a unit of speed is in the coordinates of a run.

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
