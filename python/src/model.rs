//! `NativeModel`: an open model as the package holds it.

use crate::detached;
use crate::errors::{exception, raised};
use crate::live::NativeLive;
use crate::picture;
use crate::rays::{self, HitArrays, HitColumns, Numbers, Rays, Vectors};
use crate::viewer::{NativeViewer, ViewerPlace};
use numpy::{PyReadonlyArray1, PyReadwriteArray1, PyReadwriteArray2, PyReadwriteArray3};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::num::NonZero;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use trex_model::{Model, OpenOptions, ThreadSource};
use trex_store::{Code, Error};

/// A model, until it is closed. Calls of several threads are answered at a time.
#[pyclass(frozen, module = "trex._trex")]
pub(crate) struct NativeModel {
    path: PathBuf,
    model: Mutex<Option<Model>>,
}

impl NativeModel {
    fn open_model(&self, py: Python<'_>) -> PyResult<Model> {
        let model = self.model.lock().unwrap_or_else(PoisonError::into_inner).clone();
        model.ok_or_else(|| {
            let closed = Error::new(Code::Usage, "the model is closed").at(&self.path);
            exception(py, &closed.next("open it again"))
        })
    }
}

#[pymethods]
impl NativeModel {
    #[new]
    fn new(
        py: Python<'_>,
        path: PathBuf,
        memory_limit: u64,
        threads: Option<usize>,
    ) -> PyResult<NativeModel> {
        let mut options = OpenOptions::with_limit(memory_limit);
        if let Some(count) = threads {
            options.threads = ThreadSource::Start(NonZero::new(count).unwrap_or(NonZero::<usize>::MIN));
        }
        let model = detached::run(py, None, |_| Model::open(&path, &options))?;
        Ok(NativeModel { path, model: Mutex::new(Some(model)) })
    }

    /// Ends it: its memory and its threads are given back once no call is under way.
    fn close(&self, py: Python<'_>) {
        let model = self.model.lock().unwrap_or_else(PoisonError::into_inner).take();
        py.detach(|| drop(model));
    }

    #[getter]
    fn closed(&self) -> bool {
        self.model.lock().unwrap_or_else(PoisonError::into_inner).is_none()
    }

    /// What the tables of the file say, a JSON text.
    fn info(&self, py: Python<'_>) -> PyResult<String> {
        let info = raised(py, self.open_model(py)?.info())?;
        Ok(serde_json::to_string(&info).expect("its keys are text"))
    }

    /// Names of the materials, in order.
    fn materials(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        Ok(self.open_model(py)?.file().material_names().iter().map(str::to_owned).collect())
    }

    /// Bytes that are leased from the limit now, and the most that ever were.
    fn memory(&self, py: Python<'_>) -> PyResult<(u64, u64)> {
        let model = self.open_model(py)?;
        Ok((model.budget().used_bytes(), model.budget().peak_bytes()))
    }

    /// Writes closest hits into arrays of the caller.
    #[allow(clippy::too_many_arguments)] // Of Python's call, by name.
    fn intersect<'py>(
        &self,
        py: Python<'py>,
        origins: Vectors<'py>,
        directions: Vectors<'py>,
        t_max: Numbers<'py>,
        t_hit: PyReadwriteArray1<'py, f64>,
        triangle: PyReadwriteArray1<'py, i64>,
        barycentric: PyReadwriteArray2<'py, f32>,
        normal: PyReadwriteArray2<'py, f32>,
        material: PyReadwriteArray1<'py, i32>,
    ) -> PyResult<()> {
        let mut hits = HitArrays { t_hit, triangle, barycentric, normal, material };
        rays::intersect(py, &self.open_model(py)?, &Rays { origins, directions, t_max }, &mut hits)
    }

    /// All hits of rays: where those of each begin, and their columns.
    fn intersect_all<'py>(
        &self,
        py: Python<'py>,
        origins: Vectors<'py>,
        directions: Vectors<'py>,
        t_max: Numbers<'py>,
    ) -> PyResult<HitColumns<'py>> {
        rays::intersect_all(py, &self.open_model(py)?, &Rays { origins, directions, t_max })
    }

    /// Writes corners and materials of triangles into arrays of the caller.
    fn read_triangles<'py>(
        &self,
        py: Python<'py>,
        ids: PyReadonlyArray1<'py, u32>,
        mut corners: PyReadwriteArray3<'py, f64>,
        mut material: PyReadwriteArray1<'py, i32>,
    ) -> PyResult<()> {
        rays::read_triangles(py, &self.open_model(py)?, &ids, &mut corners, &mut material)
    }

    /// Writes whether rays meet anything into an array of the caller.
    fn occluded<'py>(
        &self,
        py: Python<'py>,
        origins: Vectors<'py>,
        directions: Vectors<'py>,
        t_max: Numbers<'py>,
        mut answers: PyReadwriteArray1<'py, bool>,
    ) -> PyResult<()> {
        rays::occluded(py, &self.open_model(py)?, &Rays { origins, directions, t_max }, &mut answers)
    }

    /// A live picture of a scene, given as JSON text: frames take up to `t_max` seconds.
    fn live(&self, py: Python<'_>, scene: &str, t_max: f64) -> PyResult<NativeLive> {
        NativeLive::new(py, self.open_model(py)?, &raised(py, picture::scene(scene))?, t_max)
    }

    /// A viewer of a scene, given as JSON text.
    fn view(&self, py: Python<'_>, scene: &str, place: ViewerPlace) -> PyResult<NativeViewer> {
        NativeViewer::new(py, self.open_model(py)?, raised(py, picture::scene(scene))?, place)
    }

    /// Renders a scene, given as JSON text, to the bytes of a PNG file.
    fn render_png<'py>(
        &self,
        py: Python<'py>,
        scene: &str,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyBytes>> {
        let scene = raised(py, picture::scene(scene))?;
        picture::png(py, &self.open_model(py)?, &scene, progress.as_ref())
    }

    /// Renders a scene, given as JSON text with the keys of scene files: arrays by name.
    fn render<'py>(
        &self,
        py: Python<'py>,
        scene: &str,
        layers: Vec<String>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let model = self.open_model(py)?;
        let asked = (&raised(py, picture::scene(scene))?, raised(py, picture::layers(&layers))?);
        picture::render(py, &model, asked, progress.as_ref())
    }
}
