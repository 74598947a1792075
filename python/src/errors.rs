//! Errors of the library as exceptions: one class a code, in `trex/errors.py`, the four parts as attributes.

use pyo3::prelude::*;
use trex_store::{Code, Error};

/// The exception of an error.
pub(crate) fn exception(py: Python<'_>, error: &Error) -> PyErr {
    let parts = (
        error.code().as_str(),
        error.to_string(),
        error.what(),
        error.place(),
        error.numbers_text(),
        error.next_step(),
        error.smallest_limit_bytes(),
    );
    let made = py.import("trex.errors").and_then(|errors| errors.call_method1("exception", parts));
    made.map_or_else(|failed| failed, PyErr::from_value)
}

/// The answer of work, or its exception.
pub(crate) fn raised<T>(py: Python<'_>, answer: trex_store::Result<T>) -> PyResult<T> {
    answer.map_err(|error| exception(py, &error))
}

/// All codes of the library, by their stable names.
#[pyfunction]
pub(crate) fn error_codes() -> Vec<&'static str> {
    Code::ALL.iter().map(|code| code.as_str()).collect()
}
