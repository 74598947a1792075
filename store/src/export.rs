//! `PageTriangles`: the mesh back out: the triangles of a page file as a stream, all of them, or those of a box or of
//! some materials.
//!
//! ```text
//! pages whose box meets the box -> frame -> clusters -> triangles whose middle is in the box -> batch
//! ```
//!
//! A box takes the triangles whose mean of three corners lies in it, its far sides not counted: of boxes that fill
//! space without gaps each triangle is in one.
//!
//! Invariants: 1. memory is a frame, and one for colours and for normals, a byte of each page and a list of materials;
//! 2. triangles come in the order of their ids, and corners at `origin + integer * 2^e`, which is exact in f64; 3. a
//! page that is damaged ends the stream with an error: nothing is left out in silence.

use crate::attributes::{AttributeSet, CornerAttributes};
use crate::budget::{Budget, Lease};
use crate::cluster::{ClusterView, Colour, CornerValue, FrameView, Normal, ValueView};
use crate::error::{Code, Error, Result};
use crate::file::PageFile;
use crate::geom::{Aabb, Lattice};
use crate::layout::{CLUSTER_TRIANGLES, FRAME_BYTES, PageEntry, PageKind};
use crate::material_list::MaterialList;
use crate::material_names::stored_name;
use crate::next_step::NextStep;
use crate::source::{ScanHint, SourceStats, TriangleBatch, TriangleSource};
use crate::verify::each_child_box;
use std::sync::Arc;

/// Most triangles of a batch.
const BATCH_TRIANGLES: usize = 2 * TriangleBatch::TARGET_TRIANGLES;

const _: () = assert!(TriangleBatch::TARGET_TRIANGLES >= CLUSTER_TRIANGLES);

/// What is exported of a file.
#[derive(Clone, Debug, Default)]
pub struct ExportOptions {
    /// Triangles of this box alone; `None` for all.
    pub bounds: Option<Aabb>,
    /// Triangles of the materials of these names alone; none for all.
    pub materials: Vec<String>,
}

/// The triangles of a page file. See the module's invariants.
pub struct PageTriangles {
    file: Arc<PageFile>,
    bounds: Option<Aabb>,
    /// By index in the file, the index in `materials`; `None` for what is left out.
    material_of: Vec<Option<u32>>,
    materials: MaterialList,
    /// Whether a page may hold triangles that are asked for.
    is_wanted: Vec<bool>,
    frame: Vec<u8>,
    buffers: [Vec<u8>; 2],
    values: AttributeReader,
    /// The page at hand, whether it is in the frame, and how many of its clusters have been handed out.
    page: u32,
    is_installed: bool,
    cluster_count: usize,
    stats: SourceStats,
    _lease: Lease,
}

impl PageTriangles {
    /// The stream of what `options` ask of `file`. Its memory is leased from `budget`.
    ///
    /// # Errors
    /// [`Code::Usage`] for a material that the file has not; [`Code::MemoryLimit`].
    pub fn open(file: Arc<PageFile>, options: &ExportOptions, budget: &Budget) -> Result<PageTriangles> {
        let names = file.material_names();
        let list_bytes = MaterialList::bytes(names.len() as u64, names.text_bytes() as u64);
        let index_bytes = (names.len() * size_of::<Option<u32>>() + file.pages().len()) as u64;
        let AttributeSet { colours, normals } = file.superblock().attributes();
        let frames = 3 * (1 + u64::from(colours) + u64::from(normals));
        let bytes = list_bytes + index_bytes + frames * FRAME_BYTES as u64;
        let lease = budget.lease("the triangles of the file", bytes)?;
        let (material_of, materials) = chosen_materials(&file, &options.materials)?;
        let is_wanted = wanted_pages(&file, options.bounds);
        let stored = |(entry, _): (&PageEntry, &bool)| u64::from(entry.stored_bytes);
        let wanted = file.pages().iter().zip(&is_wanted).filter(|(_, is_wanted)| **is_wanted);
        let bytes_total = wanted.map(stored).sum();
        Ok(PageTriangles {
            bounds: options.bounds,
            material_of,
            materials,
            is_wanted,
            frame: vec![0; FRAME_BYTES],
            buffers: [Vec::new(), Vec::new()],
            values: AttributeReader::default(),
            page: 0,
            is_installed: false,
            cluster_count: 0,
            stats: SourceStats { bytes_total, ..SourceStats::default() },
            file,
            _lease: lease,
        })
    }

    /// Adds what there is room for of the clusters of the page at hand; true when none is left.
    fn take_clusters(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        let choice = TriangleChoice {
            file: &self.file,
            page: self.page,
            bounds: self.bounds,
            material_of: &self.material_of,
        };
        let (mut at, mut next, mut added) = (0, self.cluster_count, Ok(()));
        FrameView::new(&self.frame).for_each_cluster(|cluster| {
            let has_room = batch.len() + CLUSTER_TRIANGLES <= BATCH_TRIANGLES;
            if at == next && has_room && added.is_ok() {
                added = choice.add(cluster, &mut self.values, batch);
                next += 1;
            }
            at += 1;
        });
        self.cluster_count = next;
        added.map(|()| next == at)
    }

    /// The error of a stream without a triangle.
    fn nothing(&self) -> Error {
        Error::new(
            Code::Usage,
            "no triangle of the file is in the box, or of the materials, that were asked for",
        )
        .at(self.file.path())
        .numbers(format!("the model's box is {:?}", self.file.superblock().bounds))
        .next("ask for a box that meets the model, or for other materials")
    }
}

impl TriangleSource for PageTriangles {
    fn name(&self) -> String {
        self.file.path().display().to_string()
    }

    fn next_batch(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        batch.clear();
        while batch.len() < TriangleBatch::TARGET_TRIANGLES && (self.page as usize) < self.is_wanted.len() {
            let page = self.page;
            if self.is_wanted[page as usize] {
                if !self.is_installed {
                    self.file.fetch_run(page);
                    self.file.read_page(page, &mut self.frame, &mut self.buffers)?;
                    self.stats.bytes_read += u64::from(self.file.pages()[page as usize].stored_bytes);
                    self.is_installed = true;
                }
                if !self.take_clusters(batch)? {
                    break;
                }
            }
            (self.page, self.is_installed, self.cluster_count) = (page + 1, false, 0);
        }
        self.stats.triangle_count += batch.len() as u64;
        if self.stats.triangle_count == 0 {
            return Err(self.nothing());
        }
        Ok(!batch.is_empty())
    }

    fn rewind(&mut self) -> Result<()> {
        (self.page, self.is_installed, self.cluster_count) = (0, false, 0);
        (self.stats.bytes_read, self.stats.triangle_count) = (0, 0);
        Ok(())
    }

    fn hint(&self) -> Option<ScanHint> {
        None
    }

    fn lattice(&self) -> Option<Lattice> {
        Some(self.file.superblock().lattice)
    }

    fn attributes(&self) -> AttributeSet {
        self.file.superblock().attributes()
    }

    fn materials(&self) -> &MaterialList {
        &self.materials
    }

    fn stats(&self) -> SourceStats {
        self.stats.clone()
    }
}

/// Reads the attributes of triangles that are asked for in order.
#[derive(Default)]
struct AttributeReader {
    colours: ValueReader,
    normals: ValueReader,
}

impl AttributeReader {
    /// The attributes of the corners of a triangle, by its store id, of mesh page `page`.
    fn attributes(
        &mut self,
        file: &PageFile,
        page: u32,
        triangle: u32,
        vertices: [u8; 3],
    ) -> Result<CornerAttributes> {
        let place = ValuePlace { page, triangle, vertices };
        Ok(CornerAttributes {
            colours: self.colours.values::<Colour>(file, PageKind::Colours, place)?,
            normals: self.normals.values::<Normal>(file, PageKind::Normals, place)?,
        })
    }
}

/// A triangle of a mesh page, by its store id, and its vertices within its cluster.
#[derive(Clone, Copy)]
struct ValuePlace {
    page: u32,
    triangle: u32,
    vertices: [u8; 3],
}

/// The page of values that was asked for last.
#[derive(Default)]
struct ValueReader {
    page: Option<u32>,
    frame: Vec<u8>,
    buffers: [Vec<u8>; 2],
}

impl ValueReader {
    fn values<V: CornerValue>(
        &mut self,
        file: &PageFile,
        kind: PageKind,
        place: ValuePlace,
    ) -> Result<[V; 3]> {
        let Some(values) = file.value_page(kind, place.page, place.triangle) else { return Ok([V::NONE; 3]) };
        if self.page != Some(values) {
            self.page = None;
            self.frame.resize(FRAME_BYTES, 0);
            file.read_page(values, &mut self.frame, &mut self.buffers)?;
            self.page = Some(values);
        }
        let triangle = (place.triangle - file.pages()[values as usize].first_triangle) as usize;
        Ok(ValueView::new(&self.frame).values(triangle, place.vertices.map(usize::from)))
    }
}

/// Which triangles of a cluster are handed out, and how.
struct TriangleChoice<'a> {
    file: &'a PageFile,
    page: u32,
    bounds: Option<Aabb>,
    material_of: &'a [Option<u32>],
}

impl TriangleChoice<'_> {
    fn add(
        &self,
        cluster: ClusterView<'_>,
        values: &mut AttributeReader,
        batch: &mut TriangleBatch,
    ) -> Result<()> {
        let (mesh, lattice) = (cluster.decode(), self.file.superblock().lattice);
        let first_triangle = self.file.pages()[self.page as usize].first_triangle;
        for (index, (vertices, &material)) in mesh.triangles.iter().zip(&mesh.materials).enumerate() {
            let q = vertices.map(|vertex| mesh.vertices[usize::from(vertex)]);
            let Some(material) = self.material_of[usize::from(material)] else { continue };
            if self.bounds.is_some_and(|bounds| !holds(&bounds, middle(&lattice, &q))) {
                continue;
            }
            let corners = q.map(|corner| lattice.position(corner));
            let triangle = first_triangle + (cluster.first_triangle() + index) as u32;
            let attributes = values.attributes(self.file, self.page, triangle, *vertices)?;
            batch.push_with(corners, material, &attributes);
        }
        Ok(())
    }
}

/// The mean of the corners: of all boxes that are asked, the same number.
fn middle(lattice: &Lattice, q: &[[i64; 3]; 3]) -> [f64; 3] {
    let step = lattice.step();
    std::array::from_fn(|a| lattice.origin[a] + (q[0][a] + q[1][a] + q[2][a]) as f64 * step / 3.0)
}

/// Whether a point lies in a box, its far sides not counted.
fn holds(bounds: &Aabb, point: [f64; 3]) -> bool {
    (0..3).all(|a| bounds.lo[a] <= point[a] && point[a] < bounds.hi[a])
}

/// For each material of the file its index among those that are asked for, and these.
fn chosen_materials(file: &PageFile, wanted: &[String]) -> Result<(Vec<Option<u32>>, MaterialList)> {
    let names = file.material_names();
    if let Some(unknown) = wanted.iter().find(|name| names.index_of(name).is_none()) {
        return Err(Error::new(Code::Usage, format!("the model has no material called {unknown:?}"))
            .at(file.path())
            .numbers(format!("it has {}", names.len()))
            .next(NextStep::ListMaterials));
    }
    let wanted: Vec<_> = wanted.iter().map(|name| stored_name(name)).collect();
    let mut list = MaterialList::with_capacity(names.len(), names.text_bytes());
    let mut index_of = Vec::with_capacity(names.len());
    for (name, material) in names.iter().zip(file.materials()) {
        let is_wanted = wanted.is_empty() || wanted.iter().any(|wanted| wanted == name);
        index_of.push(is_wanted.then_some(list.len() as u32));
        if is_wanted {
            list.push(name, *material);
        }
    }
    Ok((index_of, list))
}

/// For each page whether it may hold triangles of the box.
fn wanted_pages(file: &PageFile, bounds: Option<Aabb>) -> Vec<bool> {
    let is_mesh = |entry: &PageEntry| entry.kind == PageKind::Mesh;
    let Some(bounds) = bounds else { return file.pages().iter().map(is_mesh).collect() };
    let mut is_wanted = vec![false; file.pages().len()];
    each_child_box(file, |page, child| {
        is_wanted[page as usize] |= (0..3).all(|a| child.lo[a] < bounds.hi[a] && bounds.lo[a] <= child.hi[a]);
    });
    is_wanted
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_that_fill_space_hold_a_point_once() {
        let cut = 0.1 + 0.2;
        let left = Aabb { lo: [0.0; 3], hi: [cut, 1.0, 1.0] };
        let right = Aabb { lo: [cut, 0.0, 0.0], hi: [1.0; 3] };
        for x in [0.0, 0.3, cut, cut.next_up(), cut.next_down(), 0.99] {
            let point = [x, 0.5, 0.0];
            assert!(holds(&left, point) != holds(&right, point), "{x}");
        }
        assert!(!holds(&right, [1.0; 3]));
    }
}
