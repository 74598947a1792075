//! `GltfSource`: the triangles of a glTF file, as a stream.
//!
//! Invariants: 1. triangles come by primitive, placement, instance, and then as their corners stand; 2. at any time one
//! vertex cache, one window of indices, and those of one node's instances are open.

use super::affine::Affine;
use super::dense::DenseStore;
use super::materials::GltfMaterials;
use super::nodes::{InstanceRows, Placement, Walk};
use super::open_values::{OpenValues, open_vectors};
use super::primitives::{GltfPrimitive, Primitives};
use super::rows::{ElementRows, RowWindow, RowsId, number_of_share};
use super::textures::Textures;
use super::triangles::TriangleCorners;
use crate::budget::Lease;
use crate::error::{Code, Error, Result};
use crate::geom::Lattice;
use crate::import::picture::CoarseCount;
use crate::import::polygon::FaceCorner;
use crate::import::scalar::Scalar;
use crate::import::vertices::VertexCache;
use crate::import::{ImportOptions, warn};
use crate::material_list::MaterialList;
use crate::source::{ScanHint, SourceStats, TriangleBatch, TriangleSource};
use crate::srgb;
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What a file was found to hold.
pub(super) struct GltfParts {
    pub(super) path: Arc<Path>,
    pub(super) walk: Walk,
    pub(super) primitives: Primitives,
    pub(super) materials: GltfMaterials,
    pub(super) textures: Textures,
    pub(super) store: DenseStore,
    pub(super) stats: SourceStats,
    /// Files that are named, and their lease.
    pub(super) named: (Vec<(Vec<u8>, String)>, Lease),
    pub(super) lattice: Option<Lattice>,
}

/// Triangles of a glTF file.
pub(in crate::import) struct GltfSource {
    parts: GltfParts,
    options: ImportOptions,
    at: GltfCursor,
    /// Positions, colours, normals and coordinates of the accessors at hand.
    positions: Option<OpenPositions>,
    colours: Option<OpenValues>,
    normals: Option<OpenValues>,
    coordinates: Option<OpenValues>,
    /// Of triangles with a picture.
    textured: CoarseCount,
    /// Corners of the primitive at hand.
    corners: Option<TriangleCorners>,
    instances: Option<OpenInstances>,
    /// Of caches that are closed.
    lookups: [u64; 2],
}

/// The next triangle.
#[derive(Clone, Copy, Debug, Default)]
struct GltfCursor {
    primitive: usize,
    /// From the primitive's first.
    placement: u32,
    instance: u64,
    triangle: u64,
    /// Of this instance, once it is begun.
    world: Option<World>,
}

#[derive(Clone, Copy, Debug)]
struct World {
    transform: Affine,
    is_mirrored: bool,
}

struct OpenPositions {
    rows: RowsId,
    cache: VertexCache,
    /// Positions are shares of this type's greatest value.
    share_of: Option<Scalar>,
}

/// Windows of the instances of a node.
struct OpenInstances {
    placement: u32,
    translation: Option<RowWindow>,
    rotation: Option<RowWindow>,
    scale: Option<RowWindow>,
}

impl GltfSource {
    /// Stands before the first triangle.
    pub(super) fn new(parts: GltfParts, options: &ImportOptions) -> GltfSource {
        GltfSource {
            parts,
            options: options.clone(),
            at: GltfCursor::default(),
            positions: None,
            colours: None,
            normals: None,
            coordinates: None,
            textured: CoarseCount::default(),
            corners: None,
            instances: None,
            lookups: [0; 2],
        }
    }

    /// Vertices and triangles that the file declares, each triangle as often as it is drawn.
    pub(super) fn declared(&self) -> (u64, u64) {
        (self.parts.primitives.vertex_count, self.parts.primitives.triangle_count)
    }

    /// The files that it names, by full path.
    pub(in crate::import) fn named_files(&self) -> Vec<PathBuf> {
        self.parts.named.0.iter().map(|(path, _)| OsStr::from_bytes(path).into()).collect()
    }

    /// Goes to the next instance that has a triangle left; false at the end.
    fn find_triangle(&mut self) -> Result<bool> {
        loop {
            let Some(primitive) = self.parts.primitives.list.get(self.at.primitive) else { return Ok(false) };
            let Some(index) = self.placement_index(primitive).filter(|_| primitive.triangle_count() > 0)
            else {
                self.at = GltfCursor { primitive: self.at.primitive + 1, ..GltfCursor::default() };
                self.corners = None;
                continue;
            };
            let (triangles, instances) =
                (primitive.triangle_count(), self.parts.walk.placements[index as usize].instance_count());
            if self.at.triangle == triangles {
                self.at = GltfCursor { instance: self.at.instance + 1, triangle: 0, world: None, ..self.at };
            }
            if self.at.instance >= instances {
                self.at =
                    GltfCursor { placement: self.at.placement + 1, instance: 0, world: None, ..self.at };
                continue;
            }
            if self.at.world.is_none() {
                self.begin_instance(index)?;
            }
            return Ok(true);
        }
    }

    fn placement_index(&self, primitive: &GltfPrimitive) -> Option<u32> {
        let index = primitive.placements.start + self.at.placement;
        (index < primitive.placements.end).then_some(index)
    }

    fn begin_instance(&mut self, placement: u32) -> Result<()> {
        if self.corners.is_none() {
            self.open_primitive()?;
        }
        let Placement { world, instancing, .. } = &self.parts.walk.placements[placement as usize];
        let mut transform = *world;
        if let Some(instancing) = instancing {
            if self.instances.as_ref().is_none_or(|open| open.placement != placement) {
                self.instances = None;
                self.instances = Some(OpenInstances::open(placement, instancing, &mut self.parts.store)?);
            }
            let open = self.instances.as_mut().expect("just opened");
            transform = transform.after(&open.transform(self.at.instance)?);
        }
        self.at.world = Some(World { transform, is_mirrored: transform.is_mirrored() });
        Ok(())
    }

    fn open_primitive(&mut self) -> Result<()> {
        let primitive = &self.parts.primitives.list[self.at.primitive];
        let rows = primitive.positions.identity();
        if self.positions.as_ref().is_none_or(|open| open.rows != rows) {
            if let Some(closed) = self.positions.take() {
                let (lookups, misses) = closed.cache.lookups_and_misses();
                self.lookups = [self.lookups[0] + lookups, self.lookups[1] + misses];
            }
            let layout = &primitive.positions.layout;
            let share_of = layout.is_normalized.then_some(layout.scalar);
            let cache = open_vectors(&primitive.positions, &mut self.parts.store, &self.options)?;
            self.positions = Some(OpenPositions { rows, cache, share_of });
        }
        let (store, options) = (&mut self.parts.store, &self.options);
        OpenValues::open(&mut self.colours, primitive.colours.as_deref(), store, options)?;
        OpenValues::open(&mut self.normals, primitive.normals.as_deref(), store, options)?;
        OpenValues::open(&mut self.coordinates, primitive.coordinates.as_deref(), store, options)?;
        let indices = primitive.indices.as_ref().map(|rows| self.parts.store.window(rows)).transpose()?;
        self.corners = Some(TriangleCorners::new(primitive.topology, indices));
        Ok(())
    }

    /// Adds triangles of the instance at hand until it ends or the batch is full.
    fn run(&mut self, batch: &mut TriangleBatch) -> Result<()> {
        let primitive = &self.parts.primitives.list[self.at.primitive];
        let (material, triangle_count) = (primitive.material, primitive.triangle_count());
        let (Some(open), Some(corners)) = (&mut self.positions, &mut self.corners) else {
            unreachable!("an instance is begun with its primitive open")
        };
        let World { transform, is_mirrored } = self.at.world.expect("an instance is begun");
        let vertex_count = open.cache.count();
        let texture = self.parts.textures.sampled(material.checked_sub(1));
        while self.at.triangle < triangle_count && batch.len() < TriangleBatch::TARGET_TRIANGLES {
            let indices = corners.of(self.at.triangle)?;
            if let Some(&index) = indices.iter().find(|&&index| index >= vertex_count) {
                let rows = primitive.indices.as_ref().map_or(0, |rows| rows.accessor);
                return Err(Error::new(Code::InputRange, "a triangle refers to a vertex that is not there")
                    .at_place(format!("{}: accessors[{rows}]", self.parts.path.display()))
                    .numbers(format!(
                        "index {index} in triangle {}, and there are {vertex_count} vertices",
                        self.at.triangle
                    ))
                    .next("check the file with a glTF validator, or export it again"));
            }
            let (mut triangle, mut places) = ([FaceCorner::default(); 3], [[0.0; 2]; 3]);
            for ((corner, place), index) in triangle.iter_mut().zip(&mut places).zip(indices) {
                let mut position = open.cache.get(index)?;
                if let Some(scalar) = open.share_of {
                    position = position.map(|part| number_of_share(scalar, part));
                }
                corner.position = transform.position(position);
                let mut colour = match &mut self.colours {
                    Some(open) => Some(open.colour(index)?),
                    None => None,
                };
                if let Some(texture) = &texture {
                    let pictures = &mut self.parts.textures.pictures;
                    let texel = match &mut self.coordinates {
                        Some(open) => {
                            *place = texture.place(open.place(index)?);
                            texture.colour(pictures, *place)?
                        }
                        None => pictures[texture.picture].mean,
                    };
                    colour = Some([0, 1, 2].map(|i| colour.map_or(1.0, |colour| colour[i]) * texel[i]));
                }
                if let Some(linear) = colour {
                    corner.colour = linear.map(srgb::byte_of);
                }
                if let Some(open) = &mut self.normals {
                    corner.normal = open.normal(index, &transform)?;
                }
            }
            if let Some(texture) = &texture {
                let size = self.parts.textures.pictures[texture.picture].file_size;
                self.textured.add(places, size);
            }
            if is_mirrored {
                triangle.swap(1, 2);
            }
            FaceCorner::push_triangle(triangle, material, batch);
            self.at.triangle += 1;
        }
        Ok(())
    }
}

impl OpenInstances {
    fn open(placement: u32, instancing: &InstanceRows, store: &mut DenseStore) -> Result<OpenInstances> {
        let mut window =
            |rows: &Option<ElementRows>| rows.as_ref().map(|rows| store.window(rows)).transpose();
        Ok(OpenInstances {
            placement,
            translation: window(&instancing.translation)?,
            rotation: window(&instancing.rotation)?,
            scale: window(&instancing.scale)?,
        })
    }

    fn transform(&mut self, instance: u64) -> Result<Affine> {
        let translation = self.translation.as_mut().map(|rows| rows.numbers(instance)).transpose()?;
        let rotation = self.rotation.as_mut().map(|rows| rows.numbers(instance)).transpose()?;
        let scale = self.scale.as_mut().map(|rows| rows.numbers(instance)).transpose()?;
        Ok(Affine::from_parts(
            translation.unwrap_or([0.0; 3]),
            rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]),
            scale.unwrap_or([1.0; 3]),
        ))
    }
}

impl TriangleSource for GltfSource {
    fn name(&self) -> String {
        self.parts.path.display().to_string()
    }

    fn next_batch(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        batch.clear();
        self.options.interrupt.check()?;
        while batch.len() < TriangleBatch::TARGET_TRIANGLES && self.find_triangle()? {
            self.run(batch)?;
        }
        self.parts.stats.triangle_count += batch.len() as u64;
        Ok(!batch.is_empty())
    }

    fn rewind(&mut self) -> Result<()> {
        (self.at, self.corners, self.lookups) = (GltfCursor::default(), None, [0; 2]);
        self.textured = CoarseCount::default();
        if let Some(open) = &mut self.positions {
            open.cache.reset_counters();
        }
        self.parts.stats.triangle_count = 0;
        Ok(())
    }

    fn hint(&self) -> Option<ScanHint> {
        None
    }

    fn lattice(&self) -> Option<Lattice> {
        self.parts.lattice
    }

    fn materials(&self) -> &MaterialList {
        &self.parts.materials.entries
    }

    fn stats(&self) -> SourceStats {
        let stats = &self.parts.stats;
        let open = self.positions.as_ref().map(|open| open.cache.lookups_and_misses()).unwrap_or_default();
        // What is read follows triangles: how the bytes of shared buffers do is not known.
        let done = u128::from(stats.triangle_count) * u128::from(stats.bytes_total);
        let triangle_count = u128::from(self.parts.primitives.triangle_count.max(1));
        let mut stats = stats.clone();
        if let Some(told) = self.textured.warning() {
            warn(&mut stats, told);
        }
        SourceStats {
            bytes_read: (done / triangle_count).min(u128::from(stats.bytes_total)) as u64,
            vertex_lookups: self.lookups[0] + open.0,
            vertex_cache_misses: self.lookups[1] + open.1,
            named_files: self.parts.named.0.clone(),
            ..stats
        }
    }
}
