//! `CreasedSource`: a source whose corners have normals from its mesh.
//!
//! Invariants: 1. its triangles are those of the source within, in their order; 2. a source that changes between its
//! passes is an error.

use super::bucket_file::{BUCKETS, BucketFile};
use crate::attributes::AttributeSet;
use crate::budget::{Budget, Lease};
use crate::cluster::Normal;
use crate::error::{Code, Error, Result};
use crate::geom::Lattice;
use crate::material_list::MaterialList;
use crate::progress::{Interrupt, Progress, Report};
use crate::source::{ScanHint, SourceStats, TriangleBatch, TriangleSource};
use glam::{DVec3, Vec3};
use std::path::Path;
use xxhash_rust::xxh3::xxh3_128;

/// Triangles of a bucket of normals, at least.
const STRIDE_LEAST: u64 = 1 << 12;
/// The bits of a hash that say which bucket.
const BUCKET_SHIFT: u32 = u64::BITS - BUCKETS.ilog2();
/// What a cosine may be off.
const COS_ERROR: f32 = 1e-6;
/// Most triangles at a place whose corners get normals: each is compared with each.
const FAN_MOST: usize = 4096;

/// How normals are made.
pub struct CreaseOptions<'a> {
    /// Degrees, 0 to 180: planes that differ by more meet in a crease.
    pub angle_deg: f64,
    /// Folder of the scratch files.
    pub folder: &'a Path,
    /// Where memory is leased.
    pub budget: &'a Budget,
    /// Stops the work.
    pub interrupt: &'a Interrupt,
    /// Hears of the work.
    pub report: Report<'a>,
}

/// A corner of a triangle that has a plane.
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
struct Corner {
    /// Hash of its place: two places of one hash are as likely as a disk that lies.
    place: [u64; 2],
    /// Three times its triangle, and which of the three it is.
    index: u64,
    /// Unit normal of its triangle's plane.
    normal: [f32; 3],
    /// Of its triangle there, radians.
    angle: f32,
}

/// The normal of a corner, by its index within its bucket.
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
struct CornerNormal {
    index: u32,
    code: u32,
}

/// Triangles of a source with normals of their own making. Those that the source has are dropped.
pub struct CreasedSource {
    source: Box<dyn TriangleSource>,
    normals: BucketFile<CornerNormal>,
    triangle_count: u64,
    /// Triangles of a bucket.
    stride: u64,
    /// The next triangle.
    next: u64,
    /// The bucket that is open, and its normals.
    open: Option<usize>,
    rows: Vec<[Normal; 3]>,
    flat_fan_count: u64,
    _lease: Lease,
}

impl CreasedSource {
    /// Memory that it takes beside its source, with small buckets.
    pub const fn smallest_bytes() -> u64 {
        BucketFile::<Corner>::BYTES
            + BucketFile::<CornerNormal>::BYTES
            + TriangleBatch::bytes(AttributeSet::ALL)
    }

    /// Reads all of `source`, and makes the normals of its corners.
    ///
    /// # Errors
    /// Those of the source, and of writing scratch: 120 bytes a triangle, and then 24 more; [`Code::MemoryLimit`];
    /// [`Code::Interrupted`].
    pub fn new(mut source: Box<dyn TriangleSource>, options: &CreaseOptions<'_>) -> Result<CreasedSource> {
        let budget = options.budget;
        let mut corners = BucketFile::<Corner>::create(options.folder, budget)?;
        let triangle_count = read_corners(&mut *source, &mut corners, options)?;
        source.rewind()?;
        let mut normals = BucketFile::<CornerNormal>::create(options.folder, budget)?;
        let stride = triangle_count.div_ceil(BUCKETS as u64).max(STRIDE_LEAST);
        let flat_fan_count = make_normals(&mut corners, &mut normals, stride, options)?;
        drop(corners);
        normals.finish()?;
        let lease = budget.lease("the normals of a bucket", stride * size_of::<[Normal; 3]>() as u64)?;
        Ok(CreasedSource {
            source,
            normals,
            triangle_count,
            stride,
            next: 0,
            open: None,
            rows: Vec::with_capacity(stride as usize),
            flat_fan_count,
            _lease: lease,
        })
    }

    /// The normals of a triangle, whose bucket is opened where it is not.
    fn row(&mut self, triangle: u64) -> Result<[Normal; 3]> {
        let bucket = (triangle / self.stride) as usize;
        if self.open != Some(bucket) {
            self.open = None;
            self.rows.clear();
            self.rows.resize(self.stride as usize, [Normal::NONE; 3]);
            let corners = self.rows.as_flattened_mut();
            self.normals.read(bucket, |CornerNormal { index, code }| {
                corners[index as usize] = Normal::from_code(code);
            })?;
            self.open = Some(bucket);
        }
        Ok(self.rows[(triangle % self.stride) as usize])
    }

    fn with_normals(&self, attributes: AttributeSet) -> AttributeSet {
        AttributeSet { normals: true, ..attributes }
    }

    fn changed(&self) -> Error {
        Error::new(Code::InputFormat, "the source gave other triangles when read again")
            .at_place(self.source.name())
            .numbers(format!("{} triangles, then others", self.triangle_count))
            .next("do not change the input while it is read")
    }
}

/// Sorts the corners of all triangles into buckets by place. Gives the count of triangles.
fn read_corners(
    source: &mut dyn TriangleSource,
    corners: &mut BucketFile<Corner>,
    options: &CreaseOptions<'_>,
) -> Result<u64> {
    let _batch = options.budget.lease("a batch of triangles", TriangleBatch::bytes(AttributeSet::ALL))?;
    let (mut batch, mut count) = (TriangleBatch::default(), 0);
    while source.next_batch(&mut batch)? {
        options.interrupt.check()?;
        for triangle in &batch.corners {
            for corner in corners_of(triangle, count).into_iter().flatten() {
                corners.push((corner.place[0] >> BUCKET_SHIFT) as usize, corner)?;
            }
            count += 1;
        }
        tell(options, count, 0);
    }
    corners.finish()?;
    Ok(count)
}

fn tell(options: &CreaseOptions<'_>, done: u64, total: u64) {
    let memory_bytes = options.budget.used_bytes();
    (options.report)(Progress { phase: "normals", done, total, unit: "triangles", memory_bytes });
}

/// The corners of triangle `number`; `None` where it has no plane.
fn corners_of(triangle: &[[f64; 3]; 3], number: u64) -> Option<[Corner; 3]> {
    let places = triangle.map(DVec3::from);
    let ways = [0, 1, 2].map(|corner| (places[(corner + 1) % 3] - places[corner]).try_normalize());
    let [Some(ab), Some(bc), Some(ca)] = ways else { return None };
    let normal = ab.cross(bc).try_normalize()?;
    let angles = [ab.angle_between(-ca), bc.angle_between(-ab), ca.angle_between(-bc)];
    Some([0, 1, 2].map(|corner| {
        // 0 and -0 are one place.
        let place: [f64; 3] = triangle[corner].map(|v| v + 0.0);
        let hash = xxh3_128(bytemuck::bytes_of(&place));
        Corner {
            place: [(hash >> 64) as u64, hash as u64],
            index: 3 * number + corner as u64,
            normal: normal.as_vec3().to_array(),
            angle: angles[corner] as f32,
        }
    }))
}

/// Makes the normals of all corners, and sorts them into buckets of `stride` triangles. Gives how many corners stay
/// flat because too many triangles meet there.
fn make_normals(
    corners: &mut BucketFile<Corner>,
    normals: &mut BucketFile<CornerNormal>,
    stride: u64,
    options: &CreaseOptions<'_>,
) -> Result<u64> {
    let cos = options.angle_deg.to_radians().cos() as f32 - COS_ERROR;
    let (mut done, mut flat_fan_count) = (0, 0);
    let corner_count: u64 = (0..BUCKETS).map(|bucket| corners.len(bucket) as u64).sum();
    for bucket in 0..BUCKETS {
        options.interrupt.check()?;
        let count = corners.len(bucket);
        let _lease = options.budget.lease("the corners of a bucket", (count * size_of::<Corner>()) as u64)?;
        let mut all = Vec::with_capacity(count);
        corners.read(bucket, |corner| all.push(corner))?;
        all.sort_unstable_by_key(|corner| (corner.place, corner.index));
        for fan in all.chunk_by(|a, b| a.place == b.place) {
            if fan.len() > FAN_MOST {
                flat_fan_count += fan.len() as u64;
                continue;
            }
            for corner in fan {
                let Some(normal) = smooth_normal(corner, fan, cos) else { continue };
                let index = (corner.index % (3 * stride)) as u32;
                let record = CornerNormal { index, code: normal.code() };
                normals.push((corner.index / (3 * stride)) as usize, record)?;
            }
        }
        done += count as u64;
        tell(options, done / 3, corner_count / 3);
    }
    Ok(flat_fan_count)
}

/// The normal of a corner among all those of its place; `None` where that is the normal of its plane.
fn smooth_normal(own: &Corner, fan: &[Corner], cos: f32) -> Option<Normal> {
    let plane = Vec3::from(own.normal);
    let smooth = fan.iter().filter(|other| plane.dot(other.normal.into()) >= cos);
    let sum: DVec3 = smooth.map(|other| f64::from(other.angle) * Vec3::from(other.normal).as_dvec3()).sum();
    let normal = Normal::from_vector(sum.to_array());
    let is_plane = normal == Normal::from_vector(plane.as_dvec3().to_array());
    (!is_plane && normal != Normal::NONE).then_some(normal)
}

impl TriangleSource for CreasedSource {
    fn name(&self) -> String {
        self.source.name()
    }

    fn next_batch(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        // A source may hand over batches of its own: the normals' memory stays with this one.
        let mut normals = std::mem::take(&mut batch.attributes.normals);
        normals.clear();
        let is_more = self.source.next_batch(batch)?;
        let end = self.next + batch.len() as u64;
        if end > self.triangle_count || !is_more && end < self.triangle_count {
            return Err(self.changed());
        }
        normals.reserve_exact(batch.corners.capacity());
        for triangle in self.next..end {
            normals.push(self.row(triangle)?);
        }
        if normals.iter().all(|row| *row == [Normal::NONE; 3]) {
            normals.clear();
        }
        batch.attributes.normals = normals;
        self.next = end;
        Ok(is_more)
    }

    fn rewind(&mut self) -> Result<()> {
        self.next = 0;
        self.source.rewind()
    }

    fn hint(&self) -> Option<ScanHint> {
        self.source.hint().map(|hint| ScanHint { attributes: self.with_normals(hint.attributes), ..hint })
    }

    fn lattice(&self) -> Option<Lattice> {
        self.source.lattice()
    }

    fn attributes(&self) -> AttributeSet {
        self.with_normals(self.source.attributes())
    }

    fn materials(&self) -> &MaterialList {
        self.source.materials()
    }

    fn stats(&self) -> SourceStats {
        let mut stats = self.source.stats();
        if self.flat_fan_count > 0 {
            stats.warnings.push(format!(
                "{} corners stay flat, at places where more than {FAN_MOST} triangles meet",
                self.flat_fan_count
            ));
        }
        stats
    }
}
