//! `ObjSource`: Wavefront OBJ in one streaming pass.
//!
//! ```text
//! v x y z, vn x y z -> vertex caches       f a/b/c ...  -> look-ups -> polygon -> triangles
//! mtllib, usemtl    -> material table      all else     -> counted, skipped
//! vt u v            -> a vertex cache, where a material has a picture: corners have its colours
//! ```
//!
//! Invariants: 1. a face refers to vertices that stand before it, as every exporter writes them; 2. vertices are
//! appended once: on a later pass their rows are only counted.

use super::ImportOptions;
use super::input::Input;
use super::materials::{MAX_LIBRARIES, MaterialTable, library_paths};
use super::picture::CoarseCount;
use super::polygon::{FaceCorner, MAX_POLYGON_SIDES, Polygon};
use super::scalar::Scalar;
use super::text::{Mark, Text, parse_integer, parse_number, printable};
use super::vertices::VertexCache;
use super::warn;
use crate::cluster::{Normal, WHITE};
use crate::error::Result;
use crate::geom::Lattice;
use crate::material_list::MaterialList;
use crate::source::{ScanHint, SourceStats, TriangleBatch, TriangleSource};
use crate::srgb;
use crate::stated_lattice;
use std::path::{Path, PathBuf};

/// Triangles of an OBJ file.
pub(super) struct ObjSource {
    text: Text,
    start: Mark,
    vertices: VertexCache,
    /// `v` rows since the start of this pass: what a face may refer to.
    defined_count: u64,
    /// Colours of the vertices, from the first that has one on.
    colours: Option<VertexCache>,
    /// `vn` rows, from the first on, and how many came since the start of this pass.
    normals: Option<VertexCache>,
    defined_normal_count: u64,
    /// `vt` rows, where there is a picture before the first of them, and how many came since the start of this pass.
    coordinates: Option<VertexCache>,
    defined_coordinate_count: u64,
    textured: CoarseCount,
    options: ImportOptions,
    materials: MaterialTable,
    material: u32,
    /// What a comment states.
    lattice: Option<Lattice>,
    polygon: Polygon,
    stats: SourceStats,
}

/// The MTL files that are named in front of the first row of vertices or faces.
pub(super) fn named_files(input: Input) -> Result<Vec<PathBuf>> {
    let folder = input.path().parent().unwrap_or(Path::new("")).to_owned();
    let (mut text, mut files) = (Text::new(input, 1), Vec::new());
    while text.next_row()? && files.len() < MAX_LIBRARIES {
        match text.word()? {
            Some(b"mtllib") => files.extend(library_paths(&folder, &text.rest()?)),
            Some(b"g" | b"o" | b"s") => text.skip_row()?,
            Some(word) if word.starts_with(b"#") => text.skip_line().map(drop)?,
            Some(_) => break,
            None => {}
        }
    }
    Ok(files)
}

impl ObjSource {
    /// Reads from where `input` stands (after a byte order mark, if there is one).
    pub(super) fn new(input: Input, options: &ImportOptions) -> Result<ObjSource> {
        let text = Text::new(input, 1);
        Ok(ObjSource {
            start: text.mark(),
            vertices: VertexCache::growing(options)?,
            defined_count: 0,
            colours: None,
            normals: None,
            defined_normal_count: 0,
            coordinates: None,
            defined_coordinate_count: 0,
            textured: CoarseCount::default(),
            options: options.clone(),
            materials: MaterialTable::new(options)?,
            material: 0,
            lattice: None,
            polygon: Polygon::new(&options.budget)?,
            stats: SourceStats::default(),
            text,
        })
    }

    fn row(&mut self, batch: &mut TriangleBatch) -> Result<()> {
        match self.text.word()? {
            Some(b"v") => self.vertex(),
            Some(b"f" | b"fo") => self.face(batch),
            Some(b"vn") => self.normal(),
            Some(b"vt") => self.coordinate(),
            Some(b"p" | b"l") => {
                self.stats.skipped_face_count += 1;
                self.text.skip_row()
            }
            Some(b"usemtl") => {
                let name = self.text.rest()?;
                self.material = self.materials.index_of(&name)?;
                Ok(())
            }
            Some(b"mtllib") => self.library(),
            Some(b"g" | b"o" | b"s") => self.text.skip_row(),
            Some(b"#") => self.comment(),
            Some(word) if word.starts_with(b"#") => self.text.skip_line().map(drop),
            Some(word) => {
                let message = format!("rows that begin with `{}` are not read", printable(word));
                warn(&mut self.stats, message);
                self.text.skip_row()
            }
            None => Ok(()),
        }
    }

    /// What is behind the sign of a comment.
    fn comment(&mut self) -> Result<()> {
        if self.lattice.is_none() && self.text.starts_with(stated_lattice::WORDS)? {
            self.lattice = stated_lattice::parse(&self.text.rest()?);
            return Ok(());
        }
        self.text.skip_line().map(drop)
    }

    fn vertex(&mut self) -> Result<()> {
        self.defined_count += 1;
        if self.defined_count <= self.vertices.count() {
            return self.text.skip_row();
        }
        let position = [self.text.number()?, self.text.number()?, self.text.number()?];
        self.vertices.push(position)?;
        // One number more is the weight of a rational curve's point, three are a colour.
        let (mut more, mut count) = ([None; 3], 0);
        while let Some(word) = self.text.word()? {
            if let Some(value) = more.get_mut(count) {
                *value = parse_number(word);
            }
            count += 1;
        }
        let colour = match (more, count) {
            ([Some(r), Some(g), Some(b)], 3) => Some([r, g, b]),
            _ => None,
        };
        if self.colours.is_none() && colour.is_some() {
            self.polygon.lease_colours()?;
            let mut colours = VertexCache::growing(&self.options)?;
            (1..self.vertices.count()).try_for_each(|_| colours.push([1.0; 3]))?;
            self.colours = Some(colours);
        }
        self.colours.as_mut().map_or(Ok(()), |colours| colours.push(colour.unwrap_or([1.0; 3])))
    }

    fn normal(&mut self) -> Result<()> {
        self.defined_normal_count += 1;
        if self.normals.is_none() {
            self.polygon.lease_normals()?;
            self.normals = Some(VertexCache::growing(&self.options)?);
        }
        let normals = self.normals.as_mut().expect("just made");
        if self.defined_normal_count > normals.count() {
            // What is no number is no normal; a mesh is drawn without it.
            let mut normal = [f64::NAN; 3];
            for part in &mut normal {
                *part = self.text.word()?.and_then(parse_number).unwrap_or(f64::NAN);
            }
            normals.push(normal)?;
        }
        self.text.skip_row()
    }

    fn coordinate(&mut self) -> Result<()> {
        self.defined_coordinate_count += 1;
        let Some(coordinates) = &mut self.coordinates else {
            self.stats.dropped_attribute_count += 1;
            return self.text.skip_row();
        };
        if self.defined_coordinate_count > coordinates.count() {
            // What is no number is at the edge of the picture.
            let mut place = [0.0; 3];
            for part in &mut place[..2] {
                *part = self.text.word()?.and_then(parse_number).unwrap_or(0.0);
            }
            coordinates.push(place)?;
        }
        self.text.skip_row()
    }

    fn face(&mut self, batch: &mut TriangleBatch) -> Result<()> {
        self.polygon.clear();
        let place = self.materials.pictures().place(self.material);
        // In the picture, the first corner and the last one so far.
        let (mut first_at, mut last_at) = (None, [0.0; 2]);
        while let Some(ObjCorner { vertex: index, coordinate, normal }) = self.corner()? {
            if self.polygon.len() == MAX_POLYGON_SIDES {
                return Err(self
                    .text
                    .out_of_range("a face has too many sides", format!("more than {MAX_POLYGON_SIDES}")));
            }
            let mut colour = match &mut self.colours {
                Some(colours) => colours.get(index)?.map(|value| Scalar::F64.channel(value)),
                None => WHITE,
            };
            if let Some(place) = place {
                let coordinates = match (&mut self.coordinates, coordinate) {
                    (Some(coordinates), Some(index)) => Some(coordinates.get(index)?),
                    _ => None,
                };
                let coordinates = coordinates.map(|[u, v, _]| [u, v]);
                let (texel, at) = self.materials.pictures_mut().colour(place, coordinates)?;
                colour = [0, 1, 2].map(|i| srgb::byte_of(srgb::linear_of(colour[i]) * texel[i]));
                if self.polygon.len() >= 2 {
                    let size = self.materials.pictures().size(place);
                    self.textured.add([first_at.unwrap_or(at), last_at, at], size);
                }
                (first_at, last_at) = (first_at.or(Some(at)), at);
            }
            let normal = match (&mut self.normals, normal) {
                (Some(normals), Some(index)) => Normal::from_vector(normals.get(index)?),
                _ => Normal::NONE,
            };
            self.polygon.push(FaceCorner { position: self.vertices.get(index)?, colour, normal });
        }
        self.polygon.emit(self.material, batch, &mut self.stats);
        Ok(())
    }

    /// The next corner of this row.
    fn corner(&mut self) -> Result<Option<ObjCorner>> {
        let (count, normal_count) = (self.defined_count, self.defined_normal_count);
        let coordinate_count = self.coordinates.as_ref().map(|_| self.defined_coordinate_count);
        let word = match self.text.word()? {
            Some(word) if !word.starts_with(b"#") => word,
            Some(_) => return self.text.skip_line().map(|_| None),
            None => return Ok(None),
        };
        let digits = &word[..memchr::memchr(b'/', word).unwrap_or(word.len())];
        let Some(index) = parse_integer(digits) else {
            let found = format!("found `{}`", printable(word));
            return Err(self.text.wrong("text where a vertex index belongs").numbers(found));
        };
        let mut others = word.splitn(3, |&byte| byte == b'/').skip(1);
        let mut other = |count: u64| {
            let digits = others.next().filter(|digits| !digits.is_empty())?;
            Some(parse_integer(digits).and_then(|index| from_zero(index, count)).ok_or(()))
        };
        let coordinate = other(coordinate_count.unwrap_or(0)).filter(|_| coordinate_count.is_some());
        let normal = other(normal_count);
        for (part, has, found) in
            [("normals", "have none", normal), ("coordinates", "have the mean of their picture", coordinate)]
        {
            if found == Some(Err(())) {
                let message = format!("faces refer to {part} that are not there: these corners {has}");
                warn(&mut self.stats, message);
            }
        }
        match from_zero(index, count) {
            Some(vertex) => {
                let [coordinate, normal] =
                    [coordinate, normal].map(|found| found.and_then(std::result::Result::ok));
                Ok(Some(ObjCorner { vertex, coordinate, normal }))
            }
            None => Err(self.text.out_of_range(
                "a face refers to a vertex that is not there",
                format!("index {index}, and {count} vertices stand before this line"),
            )),
        }
    }

    fn library(&mut self) -> Result<()> {
        let names = self.text.rest()?;
        let folder = self.text.input().path().parent().map(PathBuf::from).unwrap_or_default();
        self.materials.pictures_mut().begin_library_row();
        for warning in self.materials.load_libraries(&folder, &names)? {
            warn(&mut self.stats, warning);
        }
        if self.coordinates.is_none() && self.materials.pictures().are_sampled() {
            self.polygon.lease_colours()?;
            if self.defined_coordinate_count > 0 {
                let message = "a picture is named behind the first row of coordinates: its faces have its mean. Put \
                               the row `mtllib` at the head of the file";
                warn(&mut self.stats, message.to_owned());
                return Ok(());
            }
            self.coordinates = Some(VertexCache::growing(&self.options)?);
        }
        Ok(())
    }
}

/// A corner of a face: the numbers of its vertex, its coordinates in a picture, and its normal, from 0.
struct ObjCorner {
    vertex: u64,
    coordinate: Option<u64>,
    normal: Option<u64>,
}

impl TriangleSource for ObjSource {
    fn name(&self) -> String {
        self.text.input().path().display().to_string()
    }

    fn next_batch(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        batch.clear();
        while batch.len() < TriangleBatch::TARGET_TRIANGLES {
            if !self.text.next_row()? {
                if let Some(warning) = self.materials.undefined_warning() {
                    warn(&mut self.stats, warning);
                }
                break;
            }
            self.row(batch)?;
        }
        self.stats.triangle_count += batch.len() as u64;
        Ok(!batch.is_empty())
    }

    fn rewind(&mut self) -> Result<()> {
        self.text.seek(self.start);
        (self.defined_count, self.defined_normal_count, self.material) = (0, 0, 0);
        (self.defined_coordinate_count, self.textured) = (0, CoarseCount::default());
        self.vertices.reset_counters();
        self.materials.pictures_mut().rewind();
        self.stats =
            SourceStats { warnings: std::mem::take(&mut self.stats.warnings), ..SourceStats::default() };
        Ok(())
    }

    fn hint(&self) -> Option<ScanHint> {
        None
    }

    fn lattice(&self) -> Option<Lattice> {
        self.lattice
    }

    fn materials(&self) -> &MaterialList {
        self.materials.entries()
    }

    fn stats(&self) -> SourceStats {
        let (vertex_lookups, vertex_cache_misses) = self.vertices.lookups_and_misses();
        let mut stats = self.stats.clone();
        if let Some(told) = self.textured.warning() {
            warn(&mut stats, told);
        }
        SourceStats {
            bytes_read: self.text.input().offset(),
            bytes_total: self.text.input().length(),
            vertex_count: self.defined_count,
            vertex_lookups,
            vertex_cache_misses,
            transparent_material_count: self.materials.transparent_count(),
            material_name_bytes: self.materials.name_bytes(),
            named_files: self.materials.named_files(),
            ..stats
        }
    }
}

/// The place, from 0, of a number that counts from 1 on, or back from the last of `count`; `None` where there is none.
fn from_zero(index: i64, count: u64) -> Option<u64> {
    let place =
        if index < 0 { count.checked_sub(index.unsigned_abs()) } else { (index as u64).checked_sub(1) };
    place.filter(|&place| place < count)
}
