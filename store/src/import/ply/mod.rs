//! `PlySource`: PLY files, ascii and binary, with any elements and properties around the mesh.
//!
//! ```text
//! header -> prepare: walk the elements, note where faces and strips begin,
//!                    take vertices in place (binary, fixed size) or append them to the cache
//!        -> stream:  each section row by row: indices -> look-ups -> polygon -> triangles
//! ```
//!
//! Invariants: 1. sections come in the order of the file; faces may stand before their vertices; 2. each index is
//! compared with the vertex count before the look-up; 3. what is neither position nor index is stepped over.

mod fill;
mod header;
mod rows;
mod section;

use self::header::{Element, Form, Header, colour_columns, normal_columns};
use self::rows::{AsciiRows, BinaryRows, Rows, TriangleRun};
use self::section::{PlySection, SectionProgress};
use super::input::Input;
use super::polygon::{FaceCorner, Polygon};
use super::scalar::{ByteOrder, Scalar};
use super::text::Text;
use super::vertices::{MAX_STRIDE_BYTES, VertexCache, VertexLayout};
use super::{Encoding, ImportOptions, warn};
use crate::budget::Lease;
use crate::cluster::{Colour, Normal, WHITE};
use crate::error::{Code, Error, Result};
use crate::geom::Lattice;
use crate::material::Material;
use crate::material_list::MaterialList;
use crate::source::{ScanHint, SourceStats, TriangleBatch, TriangleSource};

/// Columns that tell of an attribute that is dropped: texture coordinates.
const DROPPED_NAMES: &[&str] = &["s", "u", "texture_u"];

/// Opens the PLY file that `input` stands at the beginning of.
pub(super) fn open(mut input: Input, options: &ImportOptions) -> Result<Box<dyn TriangleSource>> {
    let header = Header::parse(&mut input)?;
    Ok(match header.form {
        Form::Ascii => {
            let text = Text::new(input, header.data_line);
            Box::new(PlySource::new(AsciiRows(text), header, options)?)
        }
        Form::Binary(order) => Box::new(PlySource::new(BinaryRows { input, order }, header, options)?),
    })
}

/// Encoding, vertices and faces as the header declares them.
pub(super) fn declared(input: &mut Input) -> Result<(Encoding, Option<u64>, Option<u64>)> {
    let header = Header::parse(input)?;
    let encoding = match header.form {
        Form::Ascii => Encoding::Ascii,
        Form::Binary(ByteOrder::Little) => Encoding::BinaryLittleEndian,
        Form::Binary(ByteOrder::Big) => Encoding::BinaryBigEndian,
    };
    let count = |is: fn(&Element) -> bool| header.elements.iter().filter(|e| is(e)).map(|e| e.count).sum();
    Ok((
        encoding,
        Some(count(|e| e.name == "vertex")),
        Some(count(|e| matches!(&*e.name, "face" | "tristrips"))),
    ))
}

/// Triangles of a PLY file.
struct PlySource<R: Rows> {
    rows: R,
    body: R::Place,
    header: Header,
    /// `None` until the first batch is asked for.
    mesh: Option<PlyMesh<R>>,
    polygon: Polygon,
    run: TriangleRun,
    materials: MaterialList,
    options: ImportOptions,
    stats: SourceStats,
    _lease: Lease,
}

/// Vertices by index.
struct PlyVertices {
    positions: VertexCache,
    /// Where they have colours: these, as they stand in the file, and the types of the channels.
    colours: Option<(VertexCache, [Scalar; 3])>,
    /// Where they have normals: these, of whatever length.
    normals: Option<VertexCache>,
}

impl PlyVertices {
    /// A vertex as a corner.
    fn corner(&mut self, index: u64) -> Result<FaceCorner> {
        Ok(FaceCorner {
            position: self.positions.get(index)?,
            colour: match &mut self.colours {
                Some((colours, types)) => colour_of(colours.get(index)?, *types),
                None => WHITE,
            },
            normal: match &mut self.normals {
                Some(normals) => Normal::from_vector(normals.get(index)?),
                None => Normal::NONE,
            },
        })
    }
}

/// A colour from values of these types.
fn colour_of(values: [f64; 3], types: [Scalar; 3]) -> Colour {
    [0, 1, 2].map(|channel| types[channel].channel(values[channel]))
}

/// What preparing finds.
struct PlyMesh<R: Rows> {
    vertices: PlyVertices,
    sections: Vec<(PlySection, R::Place)>,
    /// The section at hand, and how far it has come.
    at: usize,
    progress: SectionProgress,
}

impl<R: Rows> PlySource<R> {
    fn new(rows: R, header: Header, options: &ImportOptions) -> Result<PlySource<R>> {
        let lease = options.budget.lease("a run of faces", TriangleRun::BYTES)?;
        let mut stats = SourceStats { bytes_total: rows.input().length(), ..SourceStats::default() };
        let vertices = vertex_element(&header, rows.input())?;
        if let Some((_, element)) = vertices {
            let is_dropped = element.column(DROPPED_NAMES).is_some();
            stats.vertex_count = element.count;
            stats.dropped_attribute_count = u64::from(is_dropped) * element.count;
        }
        if !header.elements.iter().any(|element| matches!(&*element.name, "face" | "tristrips")) {
            warn(&mut stats, "the file has neither faces nor strips: it is a point cloud".into());
        }
        for element in header.elements.iter().filter(|element| element.count > 0) {
            PlySection::new(element, rows.input().path())?;
        }
        Ok(PlySource {
            body: rows.place(),
            rows,
            header,
            mesh: None,
            polygon: Polygon::new(&options.budget)?,
            run: TriangleRun {
                indices: Vec::with_capacity(TriangleBatch::TARGET_TRIANGLES),
                ..TriangleRun::default()
            },
            materials: MaterialList::from(Material::default()),
            options: options.clone(),
            stats,
            _lease: lease,
        })
    }

    /// Walks the elements up to the last one that matters.
    fn prepare(&mut self) -> Result<PlyMesh<R>> {
        self.rows.seek(self.body);
        let mut vertices = None;
        let mut sections = Vec::new();
        let elements = std::mem::take(&mut self.header.elements);
        let walked = self.walk(&elements, &mut vertices, &mut sections);
        self.header.elements = elements;
        walked?;
        let vertices = match vertices {
            Some(vertices) => vertices,
            None => {
                PlyVertices { positions: VertexCache::growing(&self.options)?, colours: None, normals: None }
            }
        };
        let progress = sections.first().map(|(section, _)| section.start()).unwrap_or_default();
        if let Some((_, place)) = sections.first() {
            self.rows.seek(*place);
        }
        Ok(PlyMesh { vertices, sections, at: 0, progress })
    }

    fn walk(
        &mut self,
        elements: &[Element],
        vertices: &mut Option<PlyVertices>,
        sections: &mut Vec<(PlySection, R::Place)>,
    ) -> Result<()> {
        let matters = |element: &Element| matches!(&*element.name, "vertex" | "face" | "tristrips");
        let count = elements.iter().rposition(matters).map_or(0, |last| last + 1);
        for (at, element) in elements[..count].iter().enumerate() {
            if element.name == "vertex" {
                *vertices = Some(self.take_vertices(element)?);
                continue;
            }
            if let Some(section) = PlySection::new(element, self.rows.input().path())? {
                if section.colour.is_some() {
                    self.polygon.lease_colours()?;
                }
                sections.push((section, self.rows.place()));
            }
            if at + 1 < count {
                self.skip_element(element)?;
            }
        }
        Ok(())
    }

    /// The vertices of `element`; afterwards the rows stand behind it.
    fn take_vertices(&mut self, element: &Element) -> Result<PlyVertices> {
        let axes = ["x", "y", "z"].map(|name| element.column(&[name]).unwrap_or_default());
        let channels = colour_columns(&element.properties);
        let types = channels.map(|columns| columns.map(|column| element.properties[column].scalar));
        let along = normal_columns(&element.properties);
        let mut options = self.options.clone();
        if channels.is_some() {
            self.polygon.lease_colours()?;
        }
        if along.is_some() {
            self.polygon.lease_normals()?;
        }
        options.vertex_cache_bytes /= 1 + u64::from(channels.is_some()) + u64::from(along.is_some());
        if let (Form::Binary(order), Some(stride @ 1..=MAX_STRIDE_BYTES)) =
            (self.header.form, element.row_bytes())
        {
            let offset = |column: usize| element.properties[..column].iter().map(|p| p.scalar.size()).sum();
            let of = |columns: [usize; 3]| VertexLayout {
                stride: stride as usize,
                axes: columns.map(|column| (offset(column), element.properties[column].scalar)),
                order,
            };
            let input = self.rows.input();
            let first_byte = input.offset();
            let cache = |columns: [usize; 3]| {
                let file = (input.second_handle()?, input.path().to_path_buf());
                VertexCache::in_input(file, first_byte, element.count, of(columns), &options)
            };
            let (positions, colours) = (cache(axes)?, channels.map(cache).transpose()?);
            let normals = along.map(cache).transpose()?;
            self.skip_element(element)?;
            return Ok(PlyVertices { positions, colours: colours.zip(types), normals });
        }
        let mut positions = VertexCache::growing(&options)?;
        let mut colours = channels.map(|_| VertexCache::growing(&options)).transpose()?;
        let mut normals = along.map(|_| VertexCache::growing(&options)).transpose()?;
        let columns = [axes, channels.unwrap_or([usize::MAX; 3]), along.unwrap_or([usize::MAX; 3])];
        for _ in 0..element.count {
            let [position, colour, normal] = self.vertex_row(element, columns)?;
            positions.push(position)?;
            if let Some(colours) = &mut colours {
                colours.push(colour)?;
            }
            if let Some(normals) = &mut normals {
                normals.push(normal)?;
            }
        }
        Ok(PlyVertices { positions, colours: colours.zip(types), normals })
    }

    /// A position, a colour and a normal, from these columns.
    fn vertex_row(&mut self, element: &Element, columns: [[usize; 3]; 3]) -> Result<[[f64; 3]; 3]> {
        let mut values = [[0.0; 3]; 3];
        self.rows.begin_row()?;
        for (column, property) in element.properties.iter().enumerate() {
            match (property.list_count, columns.as_flattened().iter().position(|&other| other == column)) {
                (Some(count), _) => self.skip_list(count, property.scalar)?,
                (None, Some(at)) => values.as_flattened_mut()[at] = self.rows.number(property.scalar)?,
                (None, None) => self.rows.skip(property.scalar, 1)?,
            }
        }
        self.end_row()?;
        Ok(values)
    }

    fn skip_element(&mut self, element: &Element) -> Result<()> {
        // An element without properties has no rows to find, whatever its count says.
        if element.properties.is_empty() || self.rows.skip_all(element)? {
            return Ok(());
        }
        for _ in 0..element.count {
            self.rows.begin_row()?;
            for property in &element.properties {
                match property.list_count {
                    Some(count) => self.skip_list(count, property.scalar)?,
                    None => self.rows.skip(property.scalar, 1)?,
                }
            }
            self.end_row()?;
        }
        Ok(())
    }

    fn skip_list(&mut self, count: Scalar, item: Scalar) -> Result<()> {
        let length = self.list_length(count)?;
        self.rows.skip(item, length)
    }

    fn list_length(&mut self, count: Scalar) -> Result<u64> {
        let length = self.rows.integer(count)?;
        u64::try_from(length).map_err(|_| {
            self.rows.error(Code::InputRange, "a list has a negative length", length.to_string())
        })
    }

    fn end_row(&mut self) -> Result<()> {
        if self.rows.end_row()? {
            warn(
                &mut self.stats,
                "rows hold more values than the header declares: the rest is not read".into(),
            );
        }
        Ok(())
    }

    /// Tells of bytes that no element accounts for, once the last element has been read.
    fn warn_of_rest(&mut self) {
        let last_is_read =
            self.header.elements.last().is_some_and(|element| matches!(&*element.name, "face" | "tristrips"));
        let left = self.rows.input().left();
        if last_is_read && left > 0 && self.header.form != Form::Ascii {
            warn(&mut self.stats, format!("{left} bytes after the last element are not read"));
        }
    }
}

impl<R: Rows> TriangleSource for PlySource<R> {
    fn name(&self) -> String {
        self.rows.input().path().display().to_string()
    }

    fn next_batch(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        batch.clear();
        let mut mesh = match self.mesh.take() {
            Some(mesh) => mesh,
            None => self.prepare()?,
        };
        let filled = self.fill(&mut mesh, batch);
        self.mesh = Some(mesh);
        filled?;
        self.stats.triangle_count += batch.len() as u64;
        Ok(!batch.is_empty())
    }

    fn rewind(&mut self) -> Result<()> {
        if let Some(mesh) = &mut self.mesh {
            mesh.at = 0;
            mesh.progress = SectionProgress::default();
            mesh.vertices.positions.reset_counters();
            if let Some((section, place)) = mesh.sections.first() {
                mesh.progress = section.start();
                self.rows.seek(*place);
            }
        }
        let stats = &mut self.stats;
        (stats.triangle_count, stats.polygon_count, stats.skipped_face_count) = (0, 0, 0);
        Ok(())
    }

    fn hint(&self) -> Option<ScanHint> {
        None
    }

    fn lattice(&self) -> Option<Lattice> {
        self.header.lattice
    }

    fn materials(&self) -> &MaterialList {
        &self.materials
    }

    fn stats(&self) -> SourceStats {
        let counters = self.mesh.as_ref().map(|mesh| mesh.vertices.positions.lookups_and_misses());
        let (vertex_lookups, vertex_cache_misses) = counters.unwrap_or_default();
        let bytes_read = self.rows.input().offset();
        SourceStats { bytes_read, vertex_lookups, vertex_cache_misses, ..self.stats.clone() }
    }
}

/// The vertex element, checked: there is at most one, it has x, y and z, and faces have one to refer to.
fn vertex_element<'a>(header: &'a Header, input: &Input) -> Result<Option<(usize, &'a Element)>> {
    let wrong =
        |what: &str| Error::new(Code::InputFormat, what).at(input.path()).next("export the mesh again");
    let mut elements = header.elements.iter().enumerate().filter(|(_, element)| element.name == "vertex");
    let found = elements.next();
    if elements.next().is_some() {
        return Err(wrong("the PLY header declares two `vertex` elements"));
    }
    if let Some((_, element)) = found {
        for name in ["x", "y", "z"] {
            match element.column(&[name]).map(|column| element.properties[column].list_count) {
                Some(None) => {}
                _ if element.count == 0 => {}
                _ => {
                    let names: Vec<&str> =
                        element.properties.iter().take(16).map(|p| p.name.as_str()).collect();
                    return Err(wrong(&format!("the vertices of the PLY file have no number `{name}`"))
                        .numbers(format!("they have {} properties: {}", names.len(), names.join(" "))));
                }
            }
        }
    }
    Ok(found)
}
