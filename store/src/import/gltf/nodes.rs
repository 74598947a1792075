//! The nodes of the scene that is drawn: where meshes stand, how often, and what lights and cameras there are.
//!
//! The walk keeps a list of what is open, not a stack of calls: a chain of a million nodes is as good as a flat list.
//!
//! Invariants: 1. no node is met twice: one that is under itself, or under two others, is refused; so the walk ends,
//! and its list has no more entries than there are nodes; 2. placements come by mesh, those of a mesh in the order of
//! the walk.

use super::accessors::{AccessorUse, Accessors};
use super::affine::Affine;
use super::buffers::wrong;
use super::json::{JsonDocument, JsonInstances, JsonNode};
use super::rows::ElementRows;
use crate::budget::Lease;
use crate::error::{Code, Error, Result};
use crate::import::ImportOptions;
use crate::source_scene::{SourceCamera, SourceLight, SourceScene};
use std::sync::Arc;

/// Bytes of an entry of the walk's list, with the marks of a node.
const WALK_BYTES: u64 = size_of::<(u32, Affine)>() as u64 + 2;
/// Bytes of a placement, and more where it has instances of its own.
const PLACEMENT_BYTES: u64 = size_of::<Placement>() as u64;
const INSTANCING_BYTES: u64 = size_of::<InstanceRows>() as u64 + 64;
/// Bytes of all lights.
const LIGHT_BYTES: u64 = size_of::<SourceLight>() as u64;
/// Range of a camera's angle in a scene, degrees.
const FOV_DEGREES: [f64; 2] = [0.001, 179.0];

/// A mesh in its place.
#[derive(Clone, Debug)]
pub(super) struct Placement {
    pub(super) mesh: u32,
    pub(super) world: Affine,
    /// Instances of the node, if it has some.
    pub(super) instancing: Option<Arc<InstanceRows>>,
}

impl Placement {
    /// How often the mesh stands there.
    pub(super) fn instance_count(&self) -> u64 {
        self.instancing.as_ref().map_or(1, |instancing| instancing.count)
    }
}

/// Instances of a node: rows of what each is moved, turned and scaled by.
#[derive(Clone, Debug)]
pub(super) struct InstanceRows {
    pub(super) count: u64,
    pub(super) translation: Option<ElementRows>,
    pub(super) rotation: Option<ElementRows>,
    pub(super) scale: Option<ElementRows>,
}

/// What the walk finds.
pub(super) struct Walk {
    pub(super) placements: Vec<Placement>,
    pub(super) scene: SourceScene,
    pub(super) has_skins: bool,
    /// Cameras and lights that no scene has room or words for.
    pub(super) other_camera_count: u64,
    pub(super) other_light_count: u64,
    pub(super) lease: Lease,
}

/// Walks the scene.
pub(super) fn walk(accessors: &mut Accessors<'_, '_>, options: &ImportOptions) -> Result<Walk> {
    let document = accessors.document;
    let nodes = &document.nodes;
    let mesh_count = nodes.iter().filter(|node| node.mesh.is_some()).count();
    let light_count = nodes.len().min(SourceScene::LIGHTS_MAX) as u64;
    // Lights are held twice: as they are found, and in the counters of the source.
    let kept_bytes = mesh_count as u64 * PLACEMENT_BYTES + 2 * light_count * LIGHT_BYTES;
    let mut walk = Walk {
        placements: Vec::new(),
        scene: SourceScene::default(),
        has_skins: false,
        other_camera_count: 0,
        other_light_count: 0,
        lease: options.budget.lease("the placed meshes of a glTF file", kept_bytes)?,
    };
    walk.placements.reserve_exact(mesh_count);
    let _lease = options.budget.lease("the nodes of a glTF file", nodes.len() as u64 * WALK_BYTES)?;
    let mut open =
        OpenNodes { list: Vec::with_capacity(nodes.len()), is_met: vec![false; nodes.len()], accessors };
    open.roots()?;
    while let Some((index, above)) = open.list.pop() {
        let node = &nodes[index as usize];
        let world = above.after(&local(node));
        let extensions = node.extensions.as_deref();
        if extensions.is_some_and(|extensions| extensions.visibility.as_ref().is_some_and(|v| !v.visible)) {
            continue;
        }
        open.push(&node.children, world)?;
        if let Some(mesh) = node.mesh {
            let instancing = extensions.and_then(|extensions| extensions.instancing.as_ref());
            let instancing = match instancing {
                Some(json) => {
                    walk.lease.grow("the instances of a glTF file", INSTANCING_BYTES)?;
                    Some(Arc::new(instances(json, index, open.accessors)?))
                }
                None => None,
            };
            check_index(open.accessors, "meshes", mesh, document.meshes.len(), index)?;
            walk.has_skins |= node.skin.is_some();
            walk.placements.push(Placement { mesh, world, instancing });
        }
        if let Some(camera) = node.camera {
            check_index(open.accessors, "cameras", camera, document.cameras.len(), index)?;
            walk.camera(document, camera, &world);
        }
        if let Some(light) = extensions.and_then(|extensions| extensions.light.as_ref()) {
            walk.light(document, light.light, &world);
        }
    }
    walk.placements.sort_by_key(|placement| placement.mesh);
    Ok(walk)
}

impl Walk {
    fn camera(&mut self, document: &JsonDocument<'_>, index: u32, world: &Affine) {
        let camera = &document.cameras[index as usize];
        let perspective =
            camera.perspective.as_ref().filter(|_| camera.kind.as_deref() != Some("orthographic"));
        let placed = perspective.and_then(|perspective| {
            let fov = perspective.yfov.to_degrees();
            Some(SourceCamera {
                position: finite(world.position([0.0; 3]))?,
                direction: unit(world.direction([0.0, 0.0, -1.0]))?,
                up: unit(world.direction([0.0, 1.0, 0.0]))?,
                fov_y_degrees: fov.is_finite().then(|| fov.clamp(FOV_DEGREES[0], FOV_DEGREES[1]))?,
            })
        });
        match placed {
            Some(placed) if self.scene.camera.is_none() => self.scene.camera = Some(placed),
            _ => self.other_camera_count += 1,
        }
    }

    fn light(&mut self, document: &JsonDocument<'_>, index: u32, world: &Affine) {
        let lights = document.extensions.as_ref().and_then(|extensions| extensions.punctual.as_ref());
        let placed = lights.and_then(|lights| lights.lights.get(index as usize)).and_then(|light| {
            let strength = light.intensity.unwrap_or(1.0);
            let colour = light.color.as_deref().copied().unwrap_or([1.0; 3]);
            let colour = finite(colour.map(|part| (part * strength).max(0.0)))?;
            Some(match &*light.kind {
                "directional" => {
                    let direction = unit(world.direction([0.0, 0.0, -1.0]))?;
                    SourceLight::Directional { direction, irradiance: colour }
                }
                kind @ ("point" | "spot") => {
                    let position = finite(world.position([0.0; 3]))?;
                    SourceLight::Point { position, intensity: colour, is_spot: kind == "spot" }
                }
                _ => return None,
            })
        });
        match placed {
            Some(placed) if self.scene.lights.len() < SourceScene::LIGHTS_MAX => {
                self.scene.lights.push(placed)
            }
            _ => self.other_light_count += 1,
        }
    }
}

/// Nodes that are to be met, each with the transform above it.
struct OpenNodes<'a, 'b, 'c> {
    list: Vec<(u32, Affine)>,
    is_met: Vec<bool>,
    accessors: &'c mut Accessors<'a, 'b>,
}

impl OpenNodes<'_, '_, '_> {
    /// The roots of the scene: the named one, else the first; where there is no scene, all nodes that are under no
    /// other.
    fn roots(&mut self) -> Result<()> {
        let document = self.accessors.document;
        match (document.scene, document.scenes.first()) {
            (Some(index), Some(_)) => match document.scenes.get(index as usize) {
                Some(scene) => self.push(&scene.nodes, Affine::IDENTITY),
                None => {
                    let count = document.scenes.len();
                    let what = "the glTF file names a scene that is not there";
                    Err(wrong(self.accessors.path, "scenes", index, what)
                        .numbers(format!("there are {count} scenes")))
                }
            },
            (None, Some(first)) => self.push(&first.nodes, Affine::IDENTITY),
            (_, None) => {
                let mut is_child = vec![false; document.nodes.len()];
                for &child in document.nodes.iter().flat_map(|node| &node.children) {
                    if let Some(is_child) = is_child.get_mut(child as usize) {
                        *is_child = true;
                    }
                }
                for index in (0..document.nodes.len()).filter(|&index| !is_child[index]) {
                    self.push(&[index as u32], Affine::IDENTITY)?;
                }
                self.list.reverse();
                Ok(())
            }
        }
    }

    /// Adds nodes, the first of which is met first.
    fn push(&mut self, nodes: &[u32], above: Affine) -> Result<()> {
        for &node in nodes.iter().rev() {
            match self.is_met.get_mut(node as usize) {
                Some(is_met) if !*is_met => *is_met = true,
                Some(_) => {
                    let what = "a node of the glTF file is under itself, or under two others";
                    return Err(wrong(self.accessors.path, "nodes", node, what)
                        .numbers(format!("there are {} nodes", self.is_met.len())));
                }
                None => {
                    let what = "the glTF file refers to a node that is not there";
                    return Err(wrong(self.accessors.path, "nodes", node, what)
                        .numbers(format!("there are {} nodes", self.is_met.len())));
                }
            }
            self.list.push((node, above));
        }
        Ok(())
    }
}

fn check_index(accessors: &Accessors<'_, '_>, list: &str, index: u32, count: usize, node: u32) -> Result<()> {
    if (index as usize) < count {
        return Ok(());
    }
    Err(wrong(accessors.path, "nodes", node, "a node of the glTF file refers to what is not there")
        .numbers(format!("{list}[{index}], and there are {count}")))
}

/// The transform of a node: its matrix, or its parts.
fn local(node: &JsonNode) -> Affine {
    match node.matrix.as_deref() {
        Some(matrix) => Affine::from_columns(matrix),
        None => Affine::from_parts(
            node.translation.as_deref().copied().unwrap_or([0.0; 3]),
            node.rotation.as_deref().copied().unwrap_or([0.0, 0.0, 0.0, 1.0]),
            node.scale.as_deref().copied().unwrap_or([1.0; 3]),
        ),
    }
}

fn instances(json: &JsonInstances, node: u32, accessors: &mut Accessors<'_, '_>) -> Result<InstanceRows> {
    let attributes = &json.attributes;
    let mut rows = |index: Option<u32>, used| index.map(|index| accessors.rows(index, used)).transpose();
    let translation = rows(attributes.translation, AccessorUse::Vectors)?;
    let rotation = rows(attributes.rotation, AccessorUse::Rotations)?;
    let scale = rows(attributes.scale, AccessorUse::Vectors)?;
    let counts = [&translation, &rotation, &scale].map(|rows| rows.as_ref().map(|rows| rows.layout.count));
    // A node without parts of instances is one.
    let count = counts.into_iter().flatten().next().unwrap_or(1);
    if let Some(other) = counts.into_iter().flatten().find(|&other| other != count) {
        return Err(Error::new(Code::InputFormat, "the instances of a node have parts of different counts")
            .at_place(format!("{}: nodes[{node}]", accessors.path.display()))
            .numbers(format!("{count} and {other}"))
            .next("check the file with a glTF validator, or export it again"));
    }
    Ok(InstanceRows { count, translation, rotation, scale })
}

fn finite(vector: [f64; 3]) -> Option<[f64; 3]> {
    vector.iter().all(|part| part.is_finite()).then_some(vector)
}

fn unit(vector: [f64; 3]) -> Option<[f64; 3]> {
    let length = vector.iter().map(|part| part * part).sum::<f64>().sqrt();
    if length > 0.0 && length.is_finite() { Some(vector.map(|part| part / length)) } else { None }
}
