//! A scene rendered to its end, as arrays.

use crate::detached;
use numpy::{PyArray2, PyArray3, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::ops::ControlFlow;
use std::path::Path;
use trex_model::{Model, SessionOptions};
use trex_render::{Film, Layers, NO_ID, Scene};
use trex_store::{Code, Error, Progress, Result};

/// Where errors of a scene lie.
const PLACE: &str = "the arguments of render";

/// What is rendered beside the radiance.
pub(crate) fn layers(names: &[String]) -> Result<Layers> {
    let mut layers = Layers::default();
    for name in names {
        *match name.as_str() {
            "depth" => &mut layers.depth,
            "normal" => &mut layers.normal,
            "albedo" => &mut layers.albedo,
            "triangle" => &mut layers.id,
            _ => {
                return Err(Error::new(Code::Usage, "there is no such layer")
                    .at_place("layers")
                    .numbers(format!("{name:?}"))
                    .next("give some of 'depth', 'normal', 'albedo', 'triangle'"));
            }
        } = true;
    }
    Ok(layers)
}

/// The scene that a JSON text says, in the keys of scene files.
pub(crate) fn scene(json: &str) -> Result<Scene> {
    let refused = |error: &dyn std::fmt::Display| {
        Error::new(Code::SceneFormat, "this is no scene")
            .at_place(PLACE)
            .numbers(error.to_string())
            .next("give numbers, texts and lists of them under the keys of scene files")
    };
    let table: toml::Table = serde_json::from_str(json).map_err(|error| refused(&error))?;
    let text = toml::to_string(&table).map_err(|error| refused(&error))?;
    Scene::parse(&text, Path::new(PLACE))
}

/// Renders `scene`: its arrays by name, `radiance` and those of `layers`.
pub(crate) fn render<'py>(
    py: Python<'py>,
    model: &Model,
    (scene, layers): (&Scene, Layers),
    progress: Option<&Py<PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let session = detached::run(py, progress, |work| {
        let report = |phase, unit, [done, total]: [u64; 2]| {
            let memory_bytes = model.budget().used_bytes();
            work.report(Progress { phase, done, total, unit, memory_bytes });
        };
        let mut session =
            model.session_with(scene, &SessionOptions { layers, ..SessionOptions::default() })?;
        let stop = || work.interrupt.is_raised();
        session.illuminate(&stop, &mut |done, total| report("photons", "photons", [done, total]))?;
        let keys = scene.render;
        let pixels = u64::from(keys.resolution[0]) * u64::from(keys.resolution[1]);
        session.render(keys.spp, &stop, &mut |_, stats| {
            report("render", "samples", [u64::from(stats.spp) * pixels, u64::from(keys.spp) * pixels]);
            ControlFlow::Continue(())
        });
        work.interrupt.check()?;
        model.check_damage()?;
        session.smooth()?;
        Ok(session)
    })?;
    let arrays = PyDict::new(py);
    let picture = Picture { py, film: session.film(), arrays: &arrays };
    picture.vectors("radiance", |pixel| picture.film.radiance(pixel))?;
    if layers.depth {
        picture.numbers("depth", "float32", |pixel| picture.film.depth(pixel))?;
    }
    if layers.normal {
        picture.vectors("normal", |pixel| picture.film.normal(pixel))?;
    }
    if layers.albedo {
        picture.vectors("albedo", |pixel| picture.film.albedo(pixel))?;
    }
    if layers.id {
        let id = |id: u32| if id == NO_ID { -1 } else { i64::from(id) };
        picture.numbers("triangle", "int64", |pixel| id(picture.film.id(pixel)))?;
    }
    Ok(arrays)
}

/// Renders `scene` and encodes it as PNG, with the exposure of the scene.
pub(crate) fn png<'py>(
    py: Python<'py>,
    model: &Model,
    scene: &Scene,
    progress: Option<&Py<PyAny>>,
) -> PyResult<Bound<'py, PyBytes>> {
    let png = detached::run(py, progress, |work| {
        let picture = model.render(scene, &work.interrupt, &|progress| work.report(progress))?;
        let mut png = vec![];
        picture.write_png(&mut png).expect("memory takes what is written");
        Ok(png)
    })?;
    Ok(PyBytes::new(py, &png))
}

/// A film on its way into arrays, which NumPy allocates: it has an exception where there is no memory.
struct Picture<'a, 'py> {
    py: Python<'py>,
    film: &'a Film,
    arrays: &'a Bound<'py, PyDict>,
}

impl Picture<'_, '_> {
    fn numbers<T: numpy::Element + Copy>(
        &self,
        name: &str,
        dtype: &str,
        value: impl Fn([u32; 2]) -> T,
    ) -> PyResult<()> {
        let [width, height] = self.film.resolution();
        let array = self.py.import("numpy")?.call_method1("empty", ((height, width), dtype))?;
        let rows = array.cast::<PyArray2<T>>()?;
        for ((y, x), place) in rows.readwrite().as_array_mut().indexed_iter_mut() {
            *place = value([x as u32, y as u32]);
        }
        self.arrays.set_item(name, array)
    }

    fn vectors(&self, name: &str, value: impl Fn([u32; 2]) -> [f32; 3]) -> PyResult<()> {
        let [width, height] = self.film.resolution();
        let array = self.py.import("numpy")?.call_method1("empty", ((height, width, 3), "float32"))?;
        let rows = array.cast::<PyArray3<f32>>()?;
        let mut rows = rows.readwrite();
        for (y, mut row) in rows.as_array_mut().outer_iter_mut().enumerate() {
            for (x, mut place) in row.outer_iter_mut().enumerate() {
                let vector = value([x as u32, y as u32]);
                place.iter_mut().zip(vector).for_each(|(place, x)| *place = x);
            }
        }
        self.arrays.set_item(name, array)
    }
}
