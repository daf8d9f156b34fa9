//! What can go wrong, in one place.

use thiserror::Error;

/// Every error of the core. A bad call is reported to the caller; an error met while following
/// one member ends that member with a status (see [`crate::ensemble`]).
#[derive(Debug, Clone, PartialEq, Error)]
pub enum DriftError {
    /// An argument has a value the core cannot work with.
    #[error("{field}: {value} is not accepted; {accepted}")]
    Invalid {
        /// Name of the argument, as the user knows it.
        field: &'static str,
        /// The value given.
        value: String,
        /// What would be accepted.
        accepted: String,
    },
    /// A position lies beyond the data of a field.
    #[error("position ({x}, {y}) lies outside the domain of the sea field")]
    OutsideDomain {
        /// First component of the position.
        x: f64,
        /// Second component of the position.
        y: f64,
    },
    /// A wind path does not cover the times a model needs.
    #[error("wind path: covers [{start}, {end}], but the run needs [{need_start}, {need_end}]")]
    WindTooShort {
        /// First knot.
        start: f64,
        /// Last knot.
        end: f64,
        /// First time needed.
        need_start: f64,
        /// Last time needed.
        need_end: f64,
    },
    /// The adaptive integrator could not reach its tolerance.
    #[error("integration failed at t = {t}: {reason}")]
    Integration {
        /// Time reached.
        t: f64,
        /// Why it stopped there.
        reason: &'static str,
    },
}

impl DriftError {
    /// An [`DriftError::Invalid`] from anything printable.
    pub fn invalid(field: &'static str, value: impl ToString, accepted: impl Into<String>) -> Self {
        Self::Invalid { field, value: value.to_string(), accepted: accepted.into() }
    }
}

/// An empty list with room for `count` values, where there is memory for them.
pub(crate) fn room<T>(field: &'static str, count: usize) -> Result<Vec<T>, DriftError> {
    let mut values = Vec::new();
    values.try_reserve_exact(count).map_err(|_| {
        let bytes = count.saturating_mul(size_of::<T>());
        DriftError::invalid(field, count, format!("there is no memory for {bytes} bytes"))
    })?;
    Ok(values)
}

/// The product of some counts, where a list can be as long.
pub(crate) fn product(field: &'static str, counts: &[usize]) -> Result<usize, DriftError> {
    (counts.iter().try_fold(1_usize, |product, count| product.checked_mul(*count)))
        .filter(|product| *product <= isize::MAX as usize)
        .ok_or_else(|| DriftError::invalid(field, format!("{counts:?}"), "that is too many"))
}

/// Fails unless every value is finite.
pub(crate) fn finite(field: &'static str, values: &[f64]) -> Result<(), DriftError> {
    match values.iter().find(|value| !value.is_finite()) {
        None => Ok(()),
        Some(bad) => Err(DriftError::invalid(field, bad, "it must be finite")),
    }
}

/// `value` if it is finite and above zero, else an error that names `field`.
pub fn positive(field: &'static str, value: f64) -> Result<f64, DriftError> {
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(DriftError::invalid(field, value, "it must be a finite number above 0"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told<T>(result: Result<T, DriftError>) -> String {
        result.err().map_or_else(String::new, |error| error.to_string())
    }

    #[test]
    fn what_no_memory_holds_is_refused() -> Result<(), DriftError> {
        assert!(room::<f64>("members", 7)?.capacity() >= 7);
        let count = 1 << 58;
        let expected = format!("members: {count} is not accepted; there is no memory for");
        assert_eq!(told(room::<f64>("members", count)), format!("{expected} {} bytes", count * 8));
        // Bytes that no number counts are said as the most that one does.
        assert!(
            told(room::<f64>("members", usize::MAX)).ends_with(&format!("{} bytes", usize::MAX))
        );
        Ok(())
    }

    #[test]
    fn a_list_has_as_many_places_as_its_sides_say() -> Result<(), DriftError> {
        assert_eq!(product("cells", &[3, 4, 5])?, 60);
        assert_eq!(product("cells", &[])?, 1);
        assert_eq!(product("cells", &[1 << 61, 2])?, 1 << 62);
        let many = "cells: [2305843009213693952, 4] is not accepted; that is too many";
        assert_eq!(told(product("cells", &[1 << 61, 4])), many);
        assert!(told(product("cells", &[1 << 62, 4])).ends_with("that is too many"));
        Ok(())
    }

    #[test]
    fn numbers_are_finite_or_above_zero() {
        assert!(finite("drag", &[1.0, -2.0, 0.0]).is_ok());
        let refused = told(finite("drag", &[1.0, f64::INFINITY]));
        assert_eq!(refused, "drag: inf is not accepted; it must be finite");
        assert_eq!(positive("drag", 1e-300), Ok(1e-300));
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(told(positive("drag", bad)).ends_with("it must be a finite number above 0"));
        }
    }
}
