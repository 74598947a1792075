//! Rays in arrays, answers into arrays, a block at a time.
//!
//! ```text
//! origins, directions (N, 3), t_max (N,) -> check all -> block -> rays -> Model -> answers -> arrays of the caller
//! ```
//!
//! Invariants: 1. no more than a block of rays and answers is held beside the arrays, whatever N is; 2. arrays are
//! read and written attached alone, so that nobody else changes them meanwhile.

use crate::detached;
use crate::errors::raised;
use numpy::ndarray::{ArrayView1, ArrayView2, Axis};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadwriteArray1,
    PyReadwriteArray2, PyReadwriteArray3,
};
use pyo3::prelude::*;
use std::ops::Range;
use trex_model::{Model, check_rays};
use trex_render::{Hit, Ray};

/// Rays that are answered together: some hundredths of a second, in which their arrays are touched once, and some
/// 10 MB with their answers.
const BLOCK: usize = 1 << 16;

/// Vectors in rows, f32 or f64, with any strides.
#[derive(FromPyObject)]
pub(crate) enum Vectors<'py> {
    /// In double precision.
    Double(PyReadonlyArray2<'py, f64>),
    /// In single precision.
    Single(PyReadonlyArray2<'py, f32>),
}

/// Numbers, with any stride.
#[derive(FromPyObject)]
pub(crate) enum Numbers<'py> {
    /// In double precision.
    Double(PyReadonlyArray1<'py, f64>),
    /// In single precision.
    Single(PyReadonlyArray1<'py, f32>),
}

enum VectorView<'a> {
    Double(ArrayView2<'a, f64>),
    Single(ArrayView2<'a, f32>),
}

enum NumberView<'a> {
    Double(ArrayView1<'a, f64>),
    Single(ArrayView1<'a, f32>),
}

impl VectorView<'_> {
    fn get(&self, row: usize) -> [f64; 3] {
        match self {
            VectorView::Double(rows) => std::array::from_fn(|axis| rows[[row, axis]]),
            VectorView::Single(rows) => std::array::from_fn(|axis| rows[[row, axis]].into()),
        }
    }
}

/// The rays of a call. The package has brought all three to one length.
pub(crate) struct Rays<'py> {
    pub(crate) origins: Vectors<'py>,
    pub(crate) directions: Vectors<'py>,
    pub(crate) t_max: Numbers<'py>,
}

impl Vectors<'_> {
    fn view(&self) -> VectorView<'_> {
        match self {
            Vectors::Double(rows) => VectorView::Double(rows.as_array()),
            Vectors::Single(rows) => VectorView::Single(rows.as_array()),
        }
    }
}

impl Rays<'_> {
    fn len(&self) -> usize {
        match &self.t_max {
            Numbers::Double(t_max) => t_max.as_array().len(),
            Numbers::Single(t_max) => t_max.as_array().len(),
        }
    }

    /// Replaces `rays` with those of `range`.
    fn read(&self, range: Range<usize>, rays: &mut Vec<Ray>) {
        let (origins, directions) = (self.origins.view(), self.directions.view());
        let t_max = match &self.t_max {
            Numbers::Double(t_max) => NumberView::Double(t_max.as_array()),
            Numbers::Single(t_max) => NumberView::Single(t_max.as_array()),
        };
        rays.clear();
        rays.extend(range.map(|row| Ray {
            origin: origins.get(row),
            direction: directions.get(row),
            t_max: match &t_max {
                NumberView::Double(t_max) => t_max[row],
                NumberView::Single(t_max) => t_max[row].into(),
            },
        }));
    }

    fn blocks(&self) -> impl Iterator<Item = Range<usize>> {
        let count = self.len();
        (0..count).step_by(BLOCK).map(move |first| first..count.min(first + BLOCK))
    }

    /// Has `ask` answer all blocks and `write` put down what each range of rays got.
    fn answer<A: Send>(
        &self,
        py: Python<'_>,
        ask: impl Fn(&[Ray], &detached::Work) -> trex_store::Result<A> + Sync,
        mut write: impl FnMut(Range<usize>, A),
    ) -> PyResult<()> {
        let mut rays = Vec::with_capacity(self.len().min(BLOCK));
        for range in self.blocks() {
            self.read(range.clone(), &mut rays);
            raised(py, check_rays(&rays, range.start, self.len()))?;
        }
        for range in self.blocks() {
            self.read(range.clone(), &mut rays);
            let answers = detached::run(py, None, |work| ask(&rays, work))?;
            write(range, answers);
        }
        Ok(())
    }
}

/// Where closest hits go: arrays of the caller, as long as there are rays.
pub(crate) struct HitArrays<'py> {
    pub(crate) t_hit: PyReadwriteArray1<'py, f64>,
    pub(crate) triangle: PyReadwriteArray1<'py, i64>,
    pub(crate) barycentric: PyReadwriteArray2<'py, f32>,
    pub(crate) normal: PyReadwriteArray2<'py, f32>,
    pub(crate) material: PyReadwriteArray1<'py, i32>,
}

impl HitArrays<'_> {
    fn write(&mut self, range: Range<usize>, hits: &[Option<Hit>]) {
        let mut t_hit = self.t_hit.as_array_mut();
        let mut triangle = self.triangle.as_array_mut();
        let mut barycentric = self.barycentric.as_array_mut();
        let mut normal = self.normal.as_array_mut();
        let mut material = self.material.as_array_mut();
        for (row, hit) in range.zip(hits) {
            t_hit[row] = hit.map_or(f64::INFINITY, |hit| hit.t);
            triangle[row] = hit.map_or(-1, |hit| hit.triangle.into());
            material[row] = hit.map_or(-1, |hit| hit.material as i32);
            let (weights, n) = hit.map_or_else(Default::default, |hit| (hit.barycentric, hit.normal));
            for axis in 0..3 {
                (barycentric[[row, axis]], normal[[row, axis]]) = (weights[axis], n[axis]);
            }
        }
    }
}

/// Closest hits of `rays`.
pub(crate) fn intersect(
    py: Python<'_>,
    model: &Model,
    rays: &Rays<'_>,
    hits: &mut HitArrays<'_>,
) -> PyResult<()> {
    rays.answer(
        py,
        |rays, work| model.intersect(rays, &work.interrupt),
        |range, found| hits.write(range, &found),
    )
}

/// All hits of `rays`: where those of each begin, and their columns.
pub(crate) fn intersect_all<'py>(
    py: Python<'py>,
    model: &Model,
    rays: &Rays<'_>,
) -> PyResult<HitColumns<'py>> {
    let mut first = vec![0];
    let mut all = Columns::default();
    rays.answer(
        py,
        |rays, work| model.intersect_all(rays, &work.interrupt),
        |_, found| {
            let before = all.t_hit.len();
            first.extend(found.first[1..].iter().map(|&place| (before + place) as i64));
            found.hits.iter().for_each(|hit| all.push(hit));
        },
    )?;
    let rows = |column: Vec<f32>| {
        let count = column.len() / 3;
        column.into_pyarray(py).reshape([count, 3])
    };
    Ok((
        first.into_pyarray(py),
        all.t_hit.into_pyarray(py),
        all.triangle.into_pyarray(py),
        rows(all.barycentric)?,
        rows(all.normal)?,
        all.material.into_pyarray(py),
    ))
}

/// `first`, `t_hit`, `triangle`, `barycentric`, `normal`, `material`.
pub(crate) type HitColumns<'py> = (
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray1<i32>>,
);

/// Hits, a list for each thing that is said of them.
#[derive(Default)]
struct Columns {
    t_hit: Vec<f64>,
    triangle: Vec<i64>,
    barycentric: Vec<f32>,
    normal: Vec<f32>,
    material: Vec<i32>,
}

impl Columns {
    fn push(&mut self, hit: &Hit) {
        self.t_hit.push(hit.t);
        self.triangle.push(hit.triangle.into());
        self.barycentric.extend(hit.barycentric);
        self.normal.extend(hit.normal);
        self.material.push(hit.material as i32);
    }
}

/// The triangles with these ids: corners into an array (N, 3, 3), materials into one of N.
pub(crate) fn read_triangles(
    py: Python<'_>,
    model: &Model,
    ids: &PyReadonlyArray1<'_, u32>,
    corners: &mut PyReadwriteArray3<'_, f64>,
    material: &mut PyReadwriteArray1<'_, i32>,
) -> PyResult<()> {
    let ids = ids.as_array();
    let (mut corners, mut material) = (corners.as_array_mut(), material.as_array_mut());
    for first in (0..ids.len()).step_by(BLOCK) {
        let range = first..ids.len().min(first + BLOCK);
        let block: Vec<u32> = range.clone().map(|row| ids[row]).collect();
        let triangles = detached::run(py, None, |work| model.read_triangles(&block, &work.interrupt))?;
        for (row, triangle) in range.zip(triangles) {
            material[row] = triangle.material as i32;
            for ((corner, axis), place) in corners.index_axis_mut(Axis(0), row).indexed_iter_mut() {
                *place = triangle.corners[corner][axis];
            }
        }
    }
    Ok(())
}

/// Whether each of `rays` meets anything.
pub(crate) fn occluded(
    py: Python<'_>,
    model: &Model,
    rays: &Rays<'_>,
    answers: &mut PyReadwriteArray1<'_, bool>,
) -> PyResult<()> {
    rays.answer(
        py,
        |rays, work| model.occluded(rays, &work.interrupt),
        |range, found| {
            let mut answers = answers.as_array_mut();
            range.zip(found).for_each(|(row, is_hit)| answers[row] = is_hit);
        },
    )
}
