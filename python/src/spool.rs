//! `NativeSpool`: arrays of an iterator, spooled to scratch on their way into a build.
//!
//! Invariant: arrays are read attached, blocks are written detached.

use crate::errors::{exception, raised};
use numpy::PyReadonlyArray2;
use pyo3::prelude::*;
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};
use trex_store::{Budget, Code, Error, Material, Result, SpooledSource, TriangleSpool};

/// Triangles between two looks for signals.
const BLOCK: usize = 1 << 14;

/// Triangles that are on their way into a build.
#[pyclass(frozen, module = "trex._trex")]
pub(crate) struct NativeSpool(Mutex<Option<SpoolState>>);

struct SpoolState {
    spool: TriangleSpool,
    /// Index of the material of each colour.
    colours: HashMap<[u8; 3], u32>,
}

/// A mesh of an iterator: corners by index, and the colour of each face.
struct Mesh<'a, 'py> {
    vertices: &'a PyReadonlyArray2<'py, f64>,
    faces: &'a PyReadonlyArray2<'py, i64>,
    colours: Option<&'a PyReadonlyArray2<'py, u8>>,
    /// Which of the iterator's it is.
    number: u64,
}

impl NativeSpool {
    fn lock(&self) -> MutexGuard<'_, Option<SpoolState>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What was spooled, once.
    pub(crate) fn take(&self) -> Result<SpooledSource> {
        let state = self.lock().take();
        state
            .ok_or_else(|| Error::new(Code::Usage, "the spool has been built from"))
            .and_then(|s| s.spool.finish())
    }
}

#[pymethods]
impl NativeSpool {
    #[new]
    fn new(py: Python<'_>, folder: PathBuf, memory_limit: u64) -> PyResult<NativeSpool> {
        let spool = raised(py, TriangleSpool::create(&folder, "the iterator", &Budget::new(memory_limit)))?;
        Ok(NativeSpool(Mutex::new(Some(SpoolState { spool, colours: HashMap::new() }))))
    }

    /// Adds the faces of a mesh, the iterator's `number`th, with the material of `colours`' rows, or the default one.
    fn add(
        &self,
        py: Python<'_>,
        number: u64,
        vertices: PyReadonlyArray2<'_, f64>,
        faces: PyReadonlyArray2<'_, i64>,
        colours: Option<PyReadonlyArray2<'_, u8>>,
    ) -> PyResult<()> {
        let mesh = Mesh { vertices: &vertices, faces: &faces, colours: colours.as_ref(), number };
        let count = faces.as_array().nrows();
        for first in (0..count).step_by(BLOCK) {
            py.check_signals()?;
            let block = {
                let mut state = self.lock();
                let state = state.as_mut().ok_or_else(|| {
                    exception(py, &Error::new(Code::Usage, "the spool has been built from"))
                })?;
                let rows = first..count.min(first + BLOCK);
                let triangles = rows.map(|row| mesh.triangle(row, state)).collect::<Result<Vec<_>>>();
                raised(py, triangles)?
            };
            let pushed = py.detach(|| {
                let mut state = self.lock();
                let Some(state) = state.as_mut() else { return Ok(()) };
                block.into_iter().try_for_each(|(corners, material)| state.spool.push(corners, material))
            });
            raised(py, pushed)?;
        }
        Ok(())
    }
}

impl Mesh<'_, '_> {
    /// Corners and material of a face.
    fn triangle(&self, row: usize, state: &mut SpoolState) -> Result<([[f64; 3]; 3], u32)> {
        let (vertices, faces) = (self.vertices.as_array(), self.faces.as_array());
        let mut corners = [[0.0; 3]; 3];
        for (corner, place) in corners.iter_mut().enumerate() {
            let index = faces[[row, corner]];
            let vertex = usize::try_from(index).ok().filter(|&vertex| vertex < vertices.nrows());
            let vertex = vertex.ok_or_else(|| {
                Error::new(Code::InputRange, "a face names a vertex that is not there")
                    .at_place(format!("mesh {}, face {row}", self.number))
                    .numbers(format!("{index}, of {} vertices", vertices.nrows()))
                    .next("give indices from 0 on, of the vertices beside the faces")
            })?;
            *place = std::array::from_fn(|axis| vertices[[vertex, axis]]);
        }
        let Some(colours) = self.colours else { return Ok((corners, 0)) };
        let colours = colours.as_array();
        state.material(std::array::from_fn(|c| colours[[row, c]])).map(|material| (corners, material))
    }
}

impl SpoolState {
    /// The material of a colour, sRGB.
    fn material(&mut self, colour: [u8; 3]) -> Result<u32> {
        if let Some(&index) = self.colours.get(&colour) {
            return Ok(index);
        }
        let [r, g, b] = colour;
        let material = Material { kd: colour.map(linear), ..Material::default() };
        let index = self.spool.add_material(&format!("#{r:02x}{g:02x}{b:02x}"), material)?;
        self.colours.insert(colour, index);
        Ok(index)
    }
}

/// The reflectance that sRGB stands for (IEC 61966-2-1).
fn linear(value: u8) -> f32 {
    let value = f32::from(value) / 255.0;
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}
