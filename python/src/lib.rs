//! trex-mesh: the Python package over `trex-model`, `trex._trex` inside of it.
//!
//! What Python's users call stands in `trex/`: it brings arguments to one form, allocates arrays, and documents. Here
//! is what needs the library: arrays to rays, answers to arrays, errors to exceptions, and work that leaves the
//! interpreter free. Nothing here is public API of its own.
//!
//! Floors: each imports those before it alone: `errors`, `detached`, `rays`, `picture`, `live`, `viewer`,
//! `spool`, `file_work`, `model`, `network`.

mod detached;
mod errors;
mod file_work;
mod live;
mod model;
mod network;
mod picture;
mod rays;
mod spool;
mod viewer;

use pyo3::prelude::*;

/// The module `trex._trex`.
#[pymodule]
mod _trex {
    #[pymodule_export]
    use super::errors::error_codes;
    #[pymodule_export]
    use super::file_work::{build, build_spooled, info, verify};
    #[pymodule_export]
    use super::live::NativeLive;
    #[pymodule_export]
    use super::model::NativeModel;
    #[pymodule_export]
    use super::network::set_network;
    #[pymodule_export]
    use super::spool::NativeSpool;
    #[pymodule_export]
    use super::viewer::NativeViewer;
}
