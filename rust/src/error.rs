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
