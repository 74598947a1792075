//! What the tests share: triangles in memory as a source, building sources in a temporary folder, decoding them.
//! What they share of the command is in `command.rs`; models that several tests look at are in `fixtures.rs`.

use crate::command::folder;
use rayon::ThreadPoolBuilder;
use std::path::Path;
use std::sync::Arc;
use trex_store::build::{BuildOptions, ExistingOutput, Precision, Voxels, build};
use trex_store::cluster::{ClusterMesh, FrameView};
use trex_store::layout::FRAME_BYTES;
use trex_store::pool::Pin;
use trex_store::{
    Budget, Interrupt, Material, MaterialList, PageFile, Result, ScanHint, SourceStats, TriangleBatch,
    TriangleSource,
};

/// A built file.
pub(crate) struct Built {
    pub(crate) file: Arc<PageFile>,
    /// Removed with the last look at the file, where the file has a folder of its own.
    _folder: Option<tempfile::TempDir>,
}

/// Options for a build without a tight limit, and without voxels: tests that need them ask for them, since on small
/// models they take most of the time.
pub(crate) fn build_options() -> BuildOptions {
    BuildOptions {
        precision: Precision::Default,
        voxels: Voxels::None,
        pool: Arc::new(ThreadPoolBuilder::new().num_threads(2).build().unwrap()),
        budget: Budget::new(1 << 30),
        temp_dir: None,
        existing: ExistingOutput::Keep,
        resume: None,
        interrupt: Interrupt::default(),
    }
}

/// A source by its `gen:` name.
pub(crate) fn source(spec: &str) -> Box<dyn TriangleSource> {
    let spec = datasets_gen::Spec::parse(spec).unwrap();
    let options = datasets_gen::GenOptions {
        threads: 2,
        budget: Budget::new(1 << 30),
        interrupt: Interrupt::default(),
    };
    datasets_gen::open(&spec, &options).unwrap()
}

/// Builds a `gen:` source.
pub(crate) fn build_spec(spec: &str) -> Built {
    build_source(&mut *source(spec), &build_options())
}

/// Builds any source in a folder of its own.
pub(crate) fn build_source(source: &mut dyn TriangleSource, options: &BuildOptions) -> Built {
    let folder = folder();
    let built = build_at(&folder.path().join("model.trex"), source, options);
    Built { _folder: Some(folder), ..built }
}

/// Builds any source; who asks takes care of the file.
pub(crate) fn build_at(path: &Path, source: &mut dyn TriangleSource, options: &BuildOptions) -> Built {
    build(source, path, options, &|_| {}, &|_| {}).unwrap();
    Built { file: Arc::new(PageFile::open(path, &Budget::unlimited()).unwrap()), _folder: None }
}

impl Built {
    /// All triangles in the order of their ids, model space.
    pub(crate) fn decode(&self) -> Vec<[[f64; 3]; 3]> {
        let lattice = self.file.superblock().lattice;
        let (mut frame, mut buffers) = (vec![0; FRAME_BYTES], [Vec::new(), Vec::new()]);
        let mut all = Vec::new();
        for page in 0..self.file.pages().len() as u32 {
            self.file.read_page(page, &mut frame, &mut buffers).unwrap();
            FrameView::new(&frame).for_each_cluster(|cluster| {
                let mesh = cluster.decode();
                for corners in &mesh.triangles {
                    all.push(corners.map(|i| lattice.position(mesh.vertices[usize::from(i)])));
                }
            });
        }
        all
    }

    /// Index of a triangle in `decode` by its store id.
    pub(crate) fn decoded_index(&self, triangle: u32) -> usize {
        triangle as usize
    }
}

/// What a page of a pool holds: its clusters, or bytes.
pub(crate) fn content(file: &PageFile, pin: &Pin<'_>) -> (Vec<ClusterMesh>, Vec<u8>) {
    if !file.has_mesh(pin.page()) {
        return (Vec::new(), pin.to_vec());
    }
    let mut clusters = Vec::new();
    FrameView::new(pin.frame()).for_each_cluster(|cluster| clusters.push(cluster.decode()));
    (clusters, Vec::new())
}

/// Triangles in memory, of one material.
pub(crate) struct Mesh {
    name: String,
    pub(crate) triangles: Vec<[[f64; 3]; 3]>,
    materials: MaterialList,
    at: usize,
}

impl Mesh {
    pub(crate) fn new(name: &str, triangles: Vec<[[f64; 3]; 3]>) -> Mesh {
        Mesh { name: name.into(), triangles, materials: Material::default().into(), at: 0 }
    }
}

impl TriangleSource for Mesh {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn next_batch(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        batch.clear();
        let end = (self.at + TriangleBatch::TARGET_TRIANGLES).min(self.triangles.len());
        self.triangles[self.at..end].iter().for_each(|&corners| batch.push(corners, 0));
        self.at = end;
        Ok(!batch.is_empty())
    }

    fn rewind(&mut self) -> Result<()> {
        self.at = 0;
        Ok(())
    }

    fn hint(&self) -> Option<ScanHint> {
        None
    }

    fn materials(&self) -> &MaterialList {
        &self.materials
    }

    fn stats(&self) -> SourceStats {
        SourceStats::default()
    }
}
