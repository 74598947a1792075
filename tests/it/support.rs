//! What the tests share: building generated models in a temporary folder, decoding them.
//! What they share of the command is in `command.rs`.

use trex_store::build::{BuildOptions, Existing, Precision, Voxels, build};
use trex_store::cluster::FrameView;
use trex_store::layout::FRAME_BYTES;
use trex_store::{Budget, Interrupt, PageFile, TriangleSource};

/// A built file in its temporary folder.
pub(crate) struct Built {
    pub(crate) file: PageFile,
    /// Removed with the last look at the file.
    _folder: tempfile::TempDir,
}

/// Options for a build without a tight limit, and without voxels: tests that need them ask for them, since on small
/// models they take most of the time.
pub(crate) fn build_options() -> BuildOptions {
    BuildOptions {
        precision: Precision::Default,
        voxels: Voxels::None,
        threads: 2,
        budget: Budget::new(1 << 30),
        temp_dir: None,
        existing: Existing::Keep,
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

/// Builds any source.
pub(crate) fn build_source(source: &mut dyn TriangleSource, options: &BuildOptions) -> Built {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.trex");
    build(source, &path, options, &|_| {}, &|_| {}).unwrap();
    let file = PageFile::open(&path, &Budget::unlimited()).unwrap();
    Built { file, _folder: folder }
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
