//! `NativeLive`: a picture that is made in frames while its camera, lights and materials change.

use crate::detached;
use crate::errors::{exception, raised};
use crate::picture;
use numpy::PyReadwriteArray3;
use pyo3::prelude::*;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use trex_model::{LiveSession, Model};
use trex_render::{Event, FrameOptions, FrameProgress, Scene};
use trex_store::{Code, Error, Result};

/// Longest time of a frame, seconds: a minute.
const T_MAX_S: f64 = 60.0;

/// A live session, until it is closed.
#[pyclass(frozen, module = "trex._trex")]
pub(crate) struct NativeLive {
    model: Model,
    session: Mutex<Option<LiveSession>>,
}

impl NativeLive {
    /// A session on `scene` whose frames take up to `t_max` seconds.
    pub(crate) fn new(py: Python<'_>, model: Model, scene: &Scene, t_max: f64) -> PyResult<NativeLive> {
        if !(t_max > 0.0 && t_max <= T_MAX_S) {
            let refused = Error::new(Code::Usage, "this is no time of a frame").at_place("t_max");
            let refused = refused.numbers(format!("{t_max} s")).next(format!("give up to {T_MAX_S} seconds"));
            return Err(exception(py, &refused));
        }
        let options = FrameOptions { t_max: Duration::from_secs_f64(t_max), ..FrameOptions::default() };
        let session = detached::run(py, None, |_| model.live(scene, options))?;
        Ok(NativeLive { model, session: Mutex::new(Some(session)) })
    }

    fn with<R>(&self, work: impl FnOnce(&mut LiveSession) -> Result<R>) -> Result<R> {
        let mut session = self.session.lock().unwrap_or_else(PoisonError::into_inner);
        match &mut *session {
            Some(session) => work(session),
            None => Err(Error::new(Code::Usage, "the live picture is closed")
                .at(self.model.file().path())
                .next("begin another")),
        }
    }

    /// The index of a material.
    fn material(&self, name: &str) -> Result<usize> {
        let file = self.model.file();
        file.material_names().index_of(name).ok_or_else(|| {
            Error::new(Code::SceneFormat, "the model has no such material")
                .at_place(format!("material {name:?}"))
                .numbers(format!("{} materials", file.materials().len()))
                .next("list the materials of the model")
        })
    }
}

#[pymethods]
impl NativeLive {
    /// Width and height, pixels.
    #[getter]
    fn resolution(&self, py: Python<'_>) -> PyResult<[u32; 2]> {
        raised(py, self.with(|session| Ok(session.film().resolution())))
    }

    /// Makes a frame, towards `spp` samples a pixel, and writes what is on show. Gives how far the picture is.
    fn frame(
        &self,
        py: Python<'_>,
        spp: u32,
        mut shown: PyReadwriteArray3<'_, f32>,
    ) -> PyResult<&'static str> {
        let mut shown = shown.as_array_mut();
        let progress = detached::run(py, None, |work| {
            self.with(|session| {
                let progress = session.frame(spp, &|| work.interrupt.is_raised()).progress;
                self.model.check_damage()?;
                for (y, mut row) in shown.outer_iter_mut().enumerate() {
                    for (x, mut place) in row.outer_iter_mut().enumerate() {
                        let radiance = session.shown([x as u32, y as u32]);
                        place.iter_mut().zip(radiance).for_each(|(place, x)| *place = x);
                    }
                }
                Ok(progress)
            })
        })?;
        Ok(match progress {
            FrameProgress::PreviewPart | FrameProgress::Preview => "preview",
            FrameProgress::Part => "part",
            FrameProgress::Block => "block",
            FrameProgress::Complete => "complete",
            FrameProgress::Done => "done",
        })
    }

    /// Changes what `named` of a scene's parts say: `camera`, `light`, `material`, `parts`.
    fn apply(&self, py: Python<'_>, scene: &str, named: Vec<String>) -> PyResult<()> {
        let scene = raised(py, picture::scene(scene))?;
        let is_named = |name: &str| named.iter().any(|given| given == name);
        detached::run(py, None, |_| {
            self.with(|session| {
                // What the model has not is refused before anything changes.
                let parts = is_named("parts").then(|| scene.parts.parts(session.model())).transpose()?;
                let materials = scene.materials.iter().map(|(name, edit)| Ok((self.material(name)?, *edit)));
                let materials = materials.collect::<Result<Vec<_>>>()?;
                if is_named("camera") {
                    let camera = scene.camera.camera(session.model(), &session.view().settings);
                    session.apply(Event::Camera(camera))?;
                }
                if is_named("light") {
                    session.apply(Event::Lights(scene.lights.clone()))?;
                }
                if let Some(parts) = parts {
                    self.model.show_parts(session, &Arc::new(parts))?;
                }
                materials
                    .into_iter()
                    .try_for_each(|(index, edit)| session.apply(Event::Material { index, edit }))
            })
        })
    }

    /// Ends it: its memory is given back.
    fn close(&self, py: Python<'_>) {
        py.detach(|| drop(self.session.lock().unwrap_or_else(PoisonError::into_inner).take()));
    }
}
