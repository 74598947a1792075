//! GLB, the binary form of glTF 2.0: a mesh for each part of a material that stands together, and a node that moves it
//! to its place.
//!
//! ```text
//! header | JSON: nodes, meshes, accessors, views, materials | for each part: vertices, then indices
//! vertex = position 3 x f32, from the part's least corner | colour 4 x u16, linear | normal 3 x f32
//! ```
//!
//! The least corner of a part is its node's translation, in double precision: so vertices of a lattice are written
//! without loss where a part is less than 2^24 steps wide, and others as near as single precision is to the part. The
//! asset's generator states the lattice. Materials are written as what a Phong one comes closest to in
//! metallic-roughness, and in `KHR_materials_pbrSpecularGlossiness` for our own reader.
//!
//! The stream runs twice, since the JSON stands before the parts: once for their sizes, and once for what is in them.

use super::window::WindowVertex;
use super::{Draft, Job, WriteReport, push};
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use trex_store::cluster::{Colour, Normal, WHITE};
use trex_store::srgb::linear_of;
use trex_store::stated_lattice::comment;
use trex_store::{Material, Result, TriangleBatch, TriangleSource};

/// A text that grows holds up to twice its content, and half of that again while it moves.
const GROWTH: u64 = 3;
/// Most bytes of JSON for a part, and for a material beside its name, of which a character takes six at most.
const PART_TEXT_BYTES: u64 = 900 * GROWTH;
const MATERIAL_TEXT_BYTES: u64 = 700 * GROWTH;
const CHARACTER_BYTES: u64 = 6 * GROWTH;
/// Bytes for each triangle of a batch while its parts are made: its place, and three vertices with their indices, in
/// tables that grow.
const TRIANGLE_BYTES: u64 = 600;
/// Memory of the parts of a batch.
pub(super) const BYTES: u64 = 2 * TriangleBatch::TARGET_TRIANGLES as u64 * TRIANGLE_BYTES;

/// The least roughness of what is no mirror: our reader takes what has less for one.
const SMOOTHEST: f64 = 0.0501;

const U16: u32 = 5123;
const U32: u32 = 5125;
const F32: u32 = 5126;

/// What is known of a part before it is written.
struct PartFacts {
    material: u32,
    is_coloured: bool,
    has_normals: bool,
    vertex_count: usize,
    triangle_count: usize,
    origin: [f64; 3],
    /// The far corner of its box, from `origin`.
    hi: [f64; 3],
}

impl PartFacts {
    fn vertex_bytes(&self) -> usize {
        12 + if self.is_coloured { 8 } else { 0 } + if self.has_normals { 12 } else { 0 }
    }

    fn vertices_bytes(&self) -> u64 {
        (self.vertex_bytes() * self.vertex_count) as u64
    }

    /// The type of its indices; the greatest is never one.
    fn index_type(&self) -> u32 {
        if self.vertex_count < usize::from(u16::MAX) { U16 } else { U32 }
    }

    /// Bytes of its indices, and behind these up to a multiple of four.
    fn indices_bytes(&self) -> [u64; 2] {
        let size = if self.index_type() == U16 { 2 } else { 4 };
        let bytes = (3 * size * self.triangle_count) as u64;
        [bytes, bytes.next_multiple_of(4) - bytes]
    }

    fn bytes(&self) -> u64 {
        self.vertices_bytes() + self.indices_bytes().iter().sum::<u64>()
    }
}

/// Triangles of a batch that have one material, and normals all or none.
struct MeshPart {
    facts: PartFacts,
    vertices: Vec<WindowVertex>,
    triangles: Vec<[u32; 3]>,
}

pub(super) fn write(source: &mut dyn TriangleSource, job: &Job) -> Result<WriteReport> {
    let mut draft = Draft::create(job.path, job.options.existing)?;
    let _lease = job.options.budget.lease("the writer's parts", BYTES)?;
    let mut lease = job.options.budget.lease("the list of parts", 0)?;
    let mut parts: Vec<PartFacts> = Vec::new();
    for_each_part(source, job, "survey", |part| {
        job.check_single(part.facts.hi.into_iter().fold(0.0, f64::max))?;
        lease.grow("the list of parts", 2 * size_of::<PartFacts>() as u64 + PART_TEXT_BYTES)?;
        parts.push(part.facts);
        Ok(())
    })?;
    let materials = source.materials();
    let names: usize = (0..materials.len()).map(|index| materials.name(index).len()).sum();
    let text_bytes = materials.len() as u64 * MATERIAL_TEXT_BYTES + names as u64 * CHARACTER_BYTES;
    lease.grow("materials as text", text_bytes)?;
    let mut json = document(source, &parts);
    json.extend(std::iter::repeat_n(' ', json.len().next_multiple_of(4) - json.len()));
    let binary_bytes: u64 = parts.iter().map(PartFacts::bytes).sum();
    let bytes = 12 + 8 + json.len() as u64 + 8 + binary_bytes;
    if bytes > u64::from(u32::MAX) {
        return Err(job.too_many("bytes", bytes, u32::MAX.into()));
    }
    let chunk = |kind: &[u8; 4], bytes: u64| [(bytes as u32).to_le_bytes(), *kind].concat();
    draft.write(&[*b"glTF", 2u32.to_le_bytes(), (bytes as u32).to_le_bytes()].concat())?;
    draft.write(&chunk(b"JSON", json.len() as u64))?;
    draft.write(json.as_bytes())?;
    draft.write(&chunk(b"BIN\0", binary_bytes))?;
    let (mut next, mut triangle_count) = (parts.iter(), 0);
    let is_written = |part: &MeshPart, facts: &PartFacts| {
        (part.facts.vertex_count, part.facts.triangle_count) == (facts.vertex_count, facts.triangle_count)
    };
    for_each_part(source, job, "triangles", |part| {
        triangle_count += part.facts.triangle_count as u64;
        match next.next() {
            Some(facts) if is_written(&part, facts) => write_part(&part, &mut draft),
            _ => Err(job.changed("the parts of the mesh have other sizes")),
        }
    })?;
    if next.next().is_some() {
        return Err(job.changed("the parts of the mesh have other sizes"));
    }
    let bytes = draft.finish()?.publish()?;
    Ok(WriteReport { triangle_count, bytes })
}

/// Hands all parts to `visit`, each time the same ones.
fn for_each_part(
    source: &mut dyn TriangleSource,
    job: &Job,
    phase: &'static str,
    mut visit: impl FnMut(MeshPart) -> Result<()>,
) -> Result<()> {
    job.for_each_batch(source, phase, |_, batch| {
        let key = |&at: &u32| {
            let has_normals = !batch.attributes.of(at as usize).normals.contains(&Normal::NONE);
            (batch.material[at as usize], has_normals)
        };
        let mut order: Vec<u32> = (0..batch.len() as u32).collect();
        order.sort_by_key(key);
        order
            .chunk_by(|a, b| key(a) == key(b))
            .try_for_each(|group| visit(part_of(batch, group, key(&group[0]))))
    })
}

/// The part of some triangles of a batch.
fn part_of(batch: &TriangleBatch, group: &[u32], (material, has_normals): (u32, bool)) -> MeshPart {
    let mut index_of: HashMap<([u64; 3], Colour, Normal), u32> = HashMap::new();
    let (mut vertices, mut triangles) = (Vec::new(), Vec::with_capacity(group.len()));
    for &at in group {
        let mut attributes = batch.attributes.of(at as usize);
        if !has_normals {
            attributes.normals = [Normal::NONE; 3];
        }
        let corners = WindowVertex::of_triangle(&batch.corners[at as usize], &attributes);
        triangles.push(corners.map(|corner| {
            let key = (corner.position.map(f64::to_bits), corner.colour, corner.normal);
            match index_of.entry(key) {
                Entry::Occupied(known) => *known.get(),
                Entry::Vacant(new) => {
                    vertices.push(corner);
                    *new.insert(vertices.len() as u32 - 1)
                }
            }
        }));
    }
    let coordinates = |axis: usize| vertices.iter().map(move |vertex: &WindowVertex| vertex.position[axis]);
    let origin = [0, 1, 2].map(|axis| coordinates(axis).fold(f64::INFINITY, f64::min));
    let hi = [0, 1, 2].map(|axis| coordinates(axis).map(|v| v - origin[axis]).fold(0.0, f64::max));
    let facts = PartFacts {
        material,
        is_coloured: vertices.iter().any(|vertex| vertex.colour != WHITE),
        has_normals,
        vertex_count: vertices.len(),
        triangle_count: triangles.len(),
        origin,
        hi,
    };
    MeshPart { facts, vertices, triangles }
}

fn write_part(part: &MeshPart, draft: &mut Draft) -> Result<()> {
    let MeshPart { facts, vertices, triangles } = part;
    for vertex in vertices {
        let position = [0, 1, 2].map(|axis| (vertex.position[axis] - facts.origin[axis]) as f32);
        draft.write(position.map(f32::to_le_bytes).as_flattened())?;
        if facts.is_coloured {
            let linear = vertex.colour.map(|byte| (linear_of(byte) * f64::from(u16::MAX)).round() as u16);
            let [r, g, b] = linear;
            draft.write([r, g, b, u16::MAX].map(u16::to_le_bytes).as_flattened())?;
        }
        if facts.has_normals {
            let normal = vertex.normal.vector().unwrap_or_default();
            draft.write(normal.map(f32::to_le_bytes).as_flattened())?;
        }
    }
    for triangle in triangles {
        match facts.index_type() {
            U16 => draft.write(triangle.map(|index| (index as u16).to_le_bytes()).as_flattened())?,
            _ => draft.write(triangle.map(u32::to_le_bytes).as_flattened())?,
        }
    }
    draft.write(&[0; 3][..facts.indices_bytes()[1] as usize])
}

/// The JSON of a file of these parts.
fn document(source: &dyn TriangleSource, parts: &[PartFacts]) -> String {
    let generator = match source.lattice() {
        Some(lattice) => format!("trex, {}", comment(&lattice)),
        None => "trex".into(),
    };
    let all: Vec<String> = (0..parts.len()).map(|index| index.to_string()).collect();
    let mut json = format!(
        "{{\"asset\":{{\"version\":\"2.0\",\"generator\":\"{generator}\"}},\
         \"extensionsUsed\":[\"KHR_materials_pbrSpecularGlossiness\",\"KHR_materials_emissive_strength\"],\
         \"scene\":0,\"scenes\":[{{\"nodes\":[{}]}}],\"nodes\":[",
        all.join(",")
    );
    list(&mut json, parts, |json, index, part| {
        let [x, y, z] = part.origin;
        push(json, format_args!("{{\"mesh\":{index},\"translation\":[{x:?},{y:?},{z:?}]}}"));
    });
    json.push_str("],\"meshes\":[");
    let mut accessor = 0;
    list(&mut json, parts, |json, _, part| mesh(json, part, &mut accessor));
    json.push_str("],\"accessors\":[");
    list(&mut json, parts, |json, index, part| accessors(json, part, 2 * index));
    json.push_str("],\"bufferViews\":[");
    let mut offset = 0;
    list(&mut json, parts, |json, _, part| views(json, part, &mut offset));
    push(&mut json, format_args!("],\"buffers\":[{{\"byteLength\":{offset}}}],\"materials\":["));
    let materials = source.materials();
    for (index, (name, of)) in materials.named().enumerate() {
        json.push_str(if index > 0 { "," } else { "" });
        material(&mut json, name, of);
    }
    json.push_str("]}");
    json
}

/// Adds a text for each item, with commas between.
fn list<T>(json: &mut String, items: &[T], mut add: impl FnMut(&mut String, usize, &T)) {
    for (index, item) in items.iter().enumerate() {
        if index > 0 {
            json.push(',');
        }
        add(json, index, item);
    }
}

fn mesh(json: &mut String, part: &PartFacts, accessor: &mut usize) {
    let mut next = || {
        *accessor += 1;
        *accessor - 1
    };
    push(json, format_args!("{{\"primitives\":[{{\"attributes\":{{\"POSITION\":{}", next()));
    if part.is_coloured {
        push(json, format_args!(",\"COLOR_0\":{}", next()));
    }
    if part.has_normals {
        push(json, format_args!(",\"NORMAL\":{}", next()));
    }
    push(json, format_args!("}},\"indices\":{},\"material\":{}}}]}}", next(), part.material));
}

/// The accessors of a part, in the order in which its mesh names them; its vertices are in view `view`.
fn accessors(json: &mut String, part: &PartFacts, view: usize) {
    let [x, y, z] = part.hi.map(|far| f64::from(far as f32));
    let count = part.vertex_count;
    push(
        json,
        format_args!(
            "{{\"bufferView\":{view},\"componentType\":{F32},\"count\":{count},\"type\":\"VEC3\",\
             \"min\":[0,0,0],\"max\":[{x:?},{y:?},{z:?}]}}"
        ),
    );
    if part.is_coloured {
        let kind = format!("\"componentType\":{U16},\"normalized\":true,\"type\":\"VEC4\"");
        push(json, format_args!(",{{\"bufferView\":{view},\"byteOffset\":12,\"count\":{count},{kind}}}"));
    }
    if part.has_normals {
        let offset = part.vertex_bytes() - 12;
        let kind = format!("\"componentType\":{F32},\"type\":\"VEC3\"");
        push(
            json,
            format_args!(",{{\"bufferView\":{view},\"byteOffset\":{offset},\"count\":{count},{kind}}}"),
        );
    }
    let (view, kind, count) = (view + 1, part.index_type(), 3 * part.triangle_count);
    push(
        json,
        format_args!(
            ",{{\"bufferView\":{view},\"componentType\":{kind},\"count\":{count},\"type\":\"SCALAR\"}}"
        ),
    );
}

/// The views of a part: vertices, and indices. Targets say what a graphics card is to take them for.
fn views(json: &mut String, part: &PartFacts, offset: &mut u64) {
    let (vertices, [indices, padding]) = (part.vertices_bytes(), part.indices_bytes());
    let stride = part.vertex_bytes();
    push(
        json,
        format_args!(
            "{{\"buffer\":0,\"byteOffset\":{offset},\"byteLength\":{vertices},\"byteStride\":{stride},\
             \"target\":34962}},"
        ),
    );
    *offset += vertices;
    push(
        json,
        format_args!("{{\"buffer\":0,\"byteOffset\":{offset},\"byteLength\":{indices},\"target\":34963}}"),
    );
    *offset += indices + padding;
}

fn material(json: &mut String, name: &str, material: &Material) {
    let most = material.ks.iter().copied().fold(0.0, f32::max).clamp(0.0, 1.0);
    // What a reader of the extension takes away from the diffuse part.
    let rest = 1.0 - f64::from(most);
    let of_lobe = || (2.0 / (4.0 * f64::from(material.ns) + 2.0)).powf(0.25).max(SMOOTHEST);
    let roughness = if material.mirror { 0.0 } else { of_lobe() };
    let rgb = |of: [f64; 3]| of.map(|v| format!("{v:?}")).join(",");
    let wide = |of: [f32; 3]| of.map(f64::from);
    let diffuse = wide(material.kd).map(|kd| if rest > 0.0 { (kd / rest).min(1.0) } else { 0.0 });
    let base = if material.mirror { material.ks } else { material.kd };
    let (metallic, alpha) = (u32::from(material.mirror), f64::from(material.d));
    push(json, format_args!("{{\"name\":{}", serde_json::Value::from(name)));
    push(
        json,
        format_args!(
            ",\"pbrMetallicRoughness\":{{\"baseColorFactor\":[{},{alpha:?}],\"metallicFactor\":{metallic},\
             \"roughnessFactor\":{roughness:?}}}",
            rgb(wide(base).map(|v| v.clamp(0.0, 1.0)))
        ),
    );
    let strength = wide(material.ke).into_iter().fold(1.0, f64::max);
    push(json, format_args!(",\"emissiveFactor\":[{}]", rgb(wide(material.ke).map(|v| v / strength))));
    if material.d < 1.0 {
        json.push_str(",\"alphaMode\":\"BLEND\"");
    }
    push(
        json,
        format_args!(
            ",\"extensions\":{{\"KHR_materials_pbrSpecularGlossiness\":{{\"diffuseFactor\":[{},{alpha:?}],\
             \"specularFactor\":[{}],\"glossinessFactor\":{:?}}}",
            rgb(diffuse),
            rgb(wide(material.ks).map(|v| v.clamp(0.0, 1.0))),
            1.0 - roughness
        ),
    );
    if strength > 1.0 {
        push(
            json,
            format_args!(",\"KHR_materials_emissive_strength\":{{\"emissiveStrength\":{strength:?}}}"),
        );
    }
    json.push_str("}}");
}
