//! Intel Embree 3 (Debian: `libembree-dev`) as a contender: modes default, compact, robust; single rays and packets
//! of 8.
//!
//! The mesh is ours, decoded, welded, in lattice units: coordinates below 2^24, exact in f32. Buffers are shared by
//! the three scenes, so that Embree's memory monitor counts the tree alone.
//!
//! The declarations are those of Embree 3.13 in its default configuration (one level of instances, no minimal width),
//! the fifteen functions that are used here. Invariants: 1. a scene outlives every query; 2. buffers outlive the
//! scenes; 3. handles are released in the reverse order.
#![allow(unsafe_code)]

use crate::rays::{
    BenchRay, Contender, MISS, ModeFigures, PeerSetup, Query, RayAnswer, RaySet, decode, spread,
};
use anyhow::{Context, ensure};
use std::collections::HashMap;
use std::ffi::{CString, c_char, c_void};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{Duration, Instant};
use trex_store::PageFile;
use trex_store::layout::NARROW_BITS;

/// Rays of a packet.
const PACKET: usize = 8;
/// `RTC_INVALID_GEOMETRY_ID`.
const INVALID: u32 = u32::MAX;
/// `RTC_GEOMETRY_TYPE_TRIANGLE`, `RTC_BUFFER_TYPE_*`, `RTC_FORMAT_UINT3`, `RTC_FORMAT_FLOAT3`.
const TRIANGLES: u32 = 0;
const BUFFER_INDEX: u32 = 0;
const BUFFER_VERTEX: u32 = 1;
const UINT3: u32 = 0x5003;
const FLOAT3: u32 = 0x9003;
/// `RTC_SCENE_FLAG_COMPACT`, `RTC_SCENE_FLAG_ROBUST`.
const SCENE_COMPACT: u32 = 2;
const SCENE_ROBUST: u32 = 4;
/// `RTC_INTERSECT_CONTEXT_FLAG_COHERENT`.
const CONTEXT_COHERENT: u32 = 1;
/// `RTC_DEVICE_PROPERTY_VERSION_MAJOR` and the two after it.
const VERSION_PARTS: [u32; 3] = [1, 2, 3];

/// `RTCIntersectContext`.
#[repr(C)]
struct QueryContext {
    flags: u32,
    filter: *const c_void,
    instance: [u32; 1],
}

/// `RTCRay`, and of packets `RTCRay8`: `F` and `U` are one or eight numbers.
#[repr(C)]
#[derive(Clone, Copy)]
struct RtcRay<F, U> {
    origin: [F; 3],
    t_near: F,
    direction: [F; 3],
    time: F,
    t_far: F,
    mask: U,
    id: U,
    flags: U,
}

/// `RTCHit`, `RTCHit8`.
#[repr(C)]
#[derive(Clone, Copy)]
struct RtcHit<F, U> {
    normal: [F; 3],
    u: F,
    v: F,
    primitive: U,
    geometry: U,
    instance: [U; 1],
}

/// `RTCRayHit`.
#[repr(C, align(16))]
struct RayHit1 {
    ray: RtcRay<f32, u32>,
    hit: RtcHit<f32, u32>,
}

/// `RTCRayHit8`.
#[repr(C, align(32))]
struct RayHit8 {
    ray: RtcRay<[f32; PACKET], [u32; PACKET]>,
    hit: RtcHit<[f32; PACKET], [u32; PACKET]>,
}

const _: () = assert!(size_of::<RayHit1>() == 80 && size_of::<RayHit8>() == 8 * 80);

/// Lanes of a packet that are asked: -1.
#[repr(C, align(32))]
struct Valid([i32; PACKET]);

type Handle = *mut c_void;
type MemoryMonitor = extern "C" fn(*mut c_void, isize, bool) -> bool;

// SAFETY: as declared in rtcore_device.h, rtcore_geometry.h and rtcore_scene.h of Embree 3.13.
#[link(name = "embree3")]
unsafe extern "C" {
    fn rtcNewDevice(config: *const c_char) -> Handle;
    fn rtcReleaseDevice(device: Handle);
    fn rtcGetDeviceProperty(device: Handle, property: u32) -> isize;
    fn rtcGetDeviceError(device: Handle) -> u32;
    fn rtcSetDeviceMemoryMonitorFunction(device: Handle, monitor: Option<MemoryMonitor>, user: *mut c_void);
    fn rtcNewGeometry(device: Handle, kind: u32) -> Handle;
    fn rtcSetSharedGeometryBuffer(
        geometry: Handle,
        kind: u32,
        slot: u32,
        format: u32,
        bytes: *const c_void,
        offset: usize,
        stride: usize,
        count: usize,
    );
    fn rtcCommitGeometry(geometry: Handle);
    fn rtcReleaseGeometry(geometry: Handle);
    fn rtcNewScene(device: Handle) -> Handle;
    fn rtcSetSceneFlags(scene: Handle, flags: u32);
    fn rtcAttachGeometry(scene: Handle, geometry: Handle) -> u32;
    fn rtcCommitScene(scene: Handle);
    fn rtcReleaseScene(scene: Handle);
    fn rtcIntersect1(scene: Handle, context: *mut QueryContext, ray: *mut RayHit1);
    fn rtcIntersect8(valid: *const i32, scene: Handle, context: *mut QueryContext, ray: *mut RayHit8);
    fn rtcOccluded1(scene: Handle, context: *mut QueryContext, ray: *mut RtcRay<f32, u32>);
    fn rtcOccluded8(
        valid: *const i32,
        scene: Handle,
        context: *mut QueryContext,
        ray: *mut RtcRay<[f32; PACKET], [u32; PACKET]>,
    );
}

/// Counts what Embree allocates and frees.
extern "C" fn count_memory(user: *mut c_void, bytes: isize, _post: bool) -> bool {
    // SAFETY: `user` is the counter of the device's `EmbreeScene`, which lives until the device has been released.
    let counter = unsafe { &*user.cast::<AtomicI64>() };
    counter.fetch_add(bytes as i64, Ordering::Relaxed);
    true
}

/// Positions and indices, shared by the scenes.
struct Mesh {
    /// One more than are used: Embree reads 16 bytes of each.
    positions: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// The mesh of a file, vertices welded over clusters.
    fn new(file: &PageFile) -> anyhow::Result<Mesh> {
        let mut places: HashMap<[i32; 3], u32> = HashMap::new();
        let mut mesh = Mesh { positions: Vec::new(), triangles: Vec::new() };
        for corners in decode(file)? {
            mesh.triangles.push(corners.map(|corner| {
                *places.entry(corner).or_insert_with(|| {
                    mesh.positions.push(corner.map(|q| q as f32));
                    mesh.positions.len() as u32 - 1
                })
            }));
        }
        mesh.positions.push([0.0; 3]);
        Ok(mesh)
    }

    fn bytes(&self) -> u64 {
        (size_of_val(&self.positions[..]) + size_of_val(&self.triangles[..])) as u64
    }
}

/// A device with one committed scene.
struct EmbreeScene {
    device: Handle,
    scene: Handle,
    allocated: Box<AtomicI64>,
    _mesh: Arc<Mesh>,
}

// SAFETY: queries of a committed scene may run on any number of threads (Embree API documentation, `rtcIntersect1`);
// nothing else is done with the handles until the last owner drops them.
unsafe impl Send for EmbreeScene {}
// SAFETY: as above.
unsafe impl Sync for EmbreeScene {}

impl EmbreeScene {
    fn build(mesh: &Arc<Mesh>, flags: u32, threads: usize) -> anyhow::Result<EmbreeScene> {
        let config = CString::new(format!("threads={threads}")).expect("no zero in it");
        let allocated = Box::new(AtomicI64::new(0));
        // SAFETY: arguments are as the headers ask; the buffers and the counter live as long as the scene, since
        // `EmbreeScene` owns them; counts are those of the buffers, the last position serving as padding.
        unsafe {
            let device = rtcNewDevice(config.as_ptr());
            ensure!(
                !device.is_null(),
                "Embree gives no device: error {}",
                rtcGetDeviceError(std::ptr::null_mut())
            );
            let counter: *const AtomicI64 = &*allocated;
            rtcSetDeviceMemoryMonitorFunction(device, Some(count_memory), counter.cast_mut().cast());
            let geometry = rtcNewGeometry(device, TRIANGLES);
            let (points, corners) = (mesh.positions.as_ptr().cast(), mesh.triangles.as_ptr().cast());
            rtcSetSharedGeometryBuffer(
                geometry,
                BUFFER_VERTEX,
                0,
                FLOAT3,
                points,
                0,
                12,
                mesh.positions.len() - 1,
            );
            rtcSetSharedGeometryBuffer(
                geometry,
                BUFFER_INDEX,
                0,
                UINT3,
                corners,
                0,
                12,
                mesh.triangles.len(),
            );
            rtcCommitGeometry(geometry);
            let scene = rtcNewScene(device);
            rtcSetSceneFlags(scene, flags);
            rtcAttachGeometry(scene, geometry);
            rtcReleaseGeometry(geometry);
            rtcCommitScene(scene);
            let tree = EmbreeScene { device, scene, allocated, _mesh: mesh.clone() };
            let error = rtcGetDeviceError(device);
            ensure!(error == 0, "Embree cannot build: error {error}");
            Ok(tree)
        }
    }

    fn version(&self) -> String {
        // SAFETY: the device lives.
        let part = |property| unsafe { rtcGetDeviceProperty(self.device, property) }.to_string();
        VERSION_PARTS.map(part).join(".")
    }
}

impl Drop for EmbreeScene {
    fn drop(&mut self) {
        // SAFETY: each handle is owned here and released once, the scene before its device.
        unsafe {
            rtcReleaseScene(self.scene);
            rtcReleaseDevice(self.device);
        }
    }
}

/// A mode as contender.
struct Mode {
    label: String,
    tree: Arc<EmbreeScene>,
    is_packet: bool,
    threads: usize,
}

impl Contender for Mode {
    fn label(&self) -> &str {
        &self.label
    }

    fn trace(&mut self, set: &RaySet, answers: &mut [RayAnswer]) -> Duration {
        let (tree, is_packet) = (&*self.tree, self.is_packet);
        let flags = if set.is_coherent { CONTEXT_COHERENT } else { 0 };
        let mut workers = vec![(); self.threads];
        spread(&mut workers, set, answers, |(), rays, answers| {
            let mut context = QueryContext { flags, filter: std::ptr::null(), instance: [INVALID] };
            if is_packet {
                for (rays, answers) in rays.chunks(PACKET).zip(answers.chunks_mut(PACKET)) {
                    packet(tree, &mut context, set.query, rays, answers);
                }
            } else {
                for (ray, answer) in rays.iter().zip(answers) {
                    *answer = single(tree, &mut context, set.query, ray);
                }
            }
        })
    }
}

fn single(tree: &EmbreeScene, context: &mut QueryContext, query: Query, ray: &BenchRay) -> RayAnswer {
    let mut asked = RayHit1 {
        ray: RtcRay {
            origin: ray.origin,
            t_near: 0.0,
            direction: ray.direction,
            time: 0.0,
            t_far: ray.t_max,
            mask: u32::MAX,
            id: 0,
            flags: 0,
        },
        hit: RtcHit {
            normal: [0.0; 3],
            u: 0.0,
            v: 0.0,
            primitive: INVALID,
            geometry: INVALID,
            instance: [INVALID],
        },
    };
    // SAFETY: the scene is committed; the structs have the layout and the alignment that Embree asks for.
    unsafe {
        match query {
            Query::Closest => rtcIntersect1(tree.scene, context, &mut asked),
            Query::Any => rtcOccluded1(tree.scene, context, &mut asked.ray),
        }
    }
    answer(query, asked.hit.geometry, asked.hit.primitive, asked.ray.t_far)
}

fn packet(
    tree: &EmbreeScene,
    context: &mut QueryContext,
    query: Query,
    rays: &[BenchRay],
    answers: &mut [RayAnswer],
) {
    let mut valid = Valid([0; PACKET]);
    let mut asked = RayHit8 {
        ray: RtcRay {
            origin: [[0.0; PACKET]; 3],
            t_near: [0.0; PACKET],
            direction: [[0.0; PACKET]; 3],
            time: [0.0; PACKET],
            t_far: [0.0; PACKET],
            mask: [u32::MAX; PACKET],
            id: [0; PACKET],
            flags: [0; PACKET],
        },
        hit: RtcHit {
            normal: [[0.0; PACKET]; 3],
            u: [0.0; PACKET],
            v: [0.0; PACKET],
            primitive: [INVALID; PACKET],
            geometry: [INVALID; PACKET],
            instance: [[INVALID; PACKET]],
        },
    };
    for (lane, ray) in rays.iter().enumerate() {
        valid.0[lane] = -1;
        for a in 0..3 {
            asked.ray.origin[a][lane] = ray.origin[a];
            asked.ray.direction[a][lane] = ray.direction[a];
        }
        asked.ray.t_far[lane] = ray.t_max;
    }
    // SAFETY: as in `single`; the lanes without a ray are masked out.
    unsafe {
        match query {
            Query::Closest => rtcIntersect8(valid.0.as_ptr(), tree.scene, context, &mut asked),
            Query::Any => rtcOccluded8(valid.0.as_ptr(), tree.scene, context, &mut asked.ray),
        }
    }
    for (lane, slot) in answers.iter_mut().enumerate() {
        let hit = &asked.hit;
        *slot = answer(query, hit.geometry[lane], hit.primitive[lane], asked.ray.t_far[lane]);
    }
}

/// Embree marks occlusion by a negative infinite end, and a hit by the geometry's id.
fn answer(query: Query, geometry: u32, primitive: u32, t_far: f32) -> RayAnswer {
    match query {
        Query::Any => RayAnswer { t: 0.0, triangle: if t_far == f32::NEG_INFINITY { 0 } else { MISS } },
        Query::Closest if geometry == INVALID => RayAnswer::NONE,
        Query::Closest => RayAnswer { t: t_far, triangle: primitive },
    }
}

/// Builds the mesh of `file` in every mode.
pub(crate) fn set_up(file: &PageFile, threads: usize) -> anyhow::Result<PeerSetup> {
    let bits = file.superblock().lattice_bits;
    ensure!(bits <= NARROW_BITS, "Embree takes f32: the lattice has {bits} bits, {NARROW_BITS} fit");
    let mesh = Arc::new(Mesh::new(file)?);
    let mut modes: Vec<(Box<dyn Contender>, ModeFigures)> = Vec::new();
    let mut version = String::new();
    for (name, flags) in [("robust", SCENE_ROBUST), ("default", 0), ("compact", SCENE_COMPACT)] {
        let start = Instant::now();
        let tree = Arc::new(
            EmbreeScene::build(&mesh, flags, threads).with_context(|| format!("Embree, mode {name}"))?,
        );
        let figures = ModeFigures {
            tree_bytes: tree.allocated.load(Ordering::Relaxed).max(0) as u64,
            build_ms: start.elapsed().as_secs_f64() * 1e3,
            ..ModeFigures::default()
        };
        version = tree.version();
        for (width, is_packet) in [("single", false), ("packet8", true)] {
            let label = format!("{name}_{width}");
            let mode = Mode { label, tree: tree.clone(), is_packet, threads };
            modes.push((Box::new(mode), figures.clone()));
        }
    }
    Ok(PeerSetup {
        name: "embree".to_owned(),
        version,
        reference: "robust_single".to_owned(),
        mesh_bytes: mesh.bytes(),
        modes,
    })
}
