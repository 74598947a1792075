//! Builds in shards against the build of one: the same bytes, whatever the number of shards; and what is refused.

use super::*;
use crate::build::shards::{self, MergeWork, ScanWork, ShardPlan, ShardReport, ShardWork};
use crate::octree::Refinement;
use std::path::Path;

/// A model, its build by one, and the files of its shards.
struct Yard {
    folder: tempfile::TempDir,
    mesh: MemoryMesh,
    options: BuildOptions,
    whole: Vec<u8>,
    facts: Vec<(String, String)>,
    /// Whether the plan holds the triangles; then shards are built of it alone.
    keeps_triangles: bool,
}

impl Yard {
    fn new(mut mesh: MemoryMesh, voxels: Voxels) -> Yard {
        let options = BuildOptions { voxels, ..options(2, 1 << 30) };
        let (whole, _) = build_bytes(&mut mesh, &options);
        let facts = vec![("input 1".to_owned(), "a mesh".to_owned())];
        let folder = tempfile::tempdir().unwrap();
        Yard { folder, mesh, options, whole, facts, keeps_triangles: false }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn scan(&mut self, name: &str) -> Result<ShardPlan> {
        let output = self.path(name);
        self.mesh.rewind().unwrap();
        let keeps_triangles = self.keeps_triangles;
        let work = ScanWork { output: &output, facts: &self.facts, keeps_triangles, options: &self.options };
        shards::scan(&mut self.mesh, &work, &|_| {})?;
        ShardPlan::read(&output, &self.options.budget)
    }

    fn shard(&mut self, plan: &ShardPlan, share: (u32, u32), output: &Path) -> Result<ShardReport> {
        self.mesh.rewind().unwrap();
        let work = ShardWork {
            plan,
            plan_path: &self.folder.path().join("plan"),
            share,
            facts: (!self.keeps_triangles).then_some(&self.facts[..]),
            output,
            options: &self.options,
            on_plan: &|_| {},
        };
        let mesh: Option<&mut dyn TriangleSource> = match self.keeps_triangles {
            true => None,
            false => Some(&mut self.mesh),
        };
        shards::build(mesh, &work, &|_| {})
    }

    fn shards(&mut self, plan: &ShardPlan, count: u32) -> Vec<PathBuf> {
        let paths: Vec<PathBuf> = (1..=count).map(|number| self.path(&format!("{number}-{count}"))).collect();
        for (number, path) in (1..).zip(&paths) {
            self.shard(plan, (number, count), path).unwrap();
        }
        paths
    }

    fn merge(&self, fragments: &[PathBuf]) -> Result<Vec<u8>> {
        let output = self.path("merged.trex");
        let _ = std::fs::remove_file(&output);
        shards::merge(&MergeWork { fragments, output: &output, options: &self.options }, &|_| {})?;
        Ok(std::fs::read(output).unwrap())
    }
}

/// Sheets and loose triangles, some of them lamps, in several chunks; in cells that are cut again, where `is_dense`.
fn model(is_dense: bool) -> MemoryMesh {
    let mut mesh = mesh(420, 9_000, 11);
    if is_dense {
        let small = mesh.triangles.clone().into_iter();
        let shrink = |corners: [[f64; 3]; 3]| corners.map(|corner| corner.map(|v| v * 1e-3));
        mesh.triangles.extend(small.map(|(corners, material)| (shrink(corners), material)));
    }
    mesh
}

#[test]
fn shards_merge_to_the_bytes_of_one_build() {
    let units = Voxels::Refined { upper: 64, refinement: Refinement::By4 };
    for (is_dense, voxels) in [(false, Voxels::default()), (true, units), (false, Voxels::None)] {
        let mut yard = Yard::new(model(is_dense), voxels);
        let mut ids = vec![];
        for (keeps_triangles, counts) in [(false, vec![1, 3, 8]), (true, vec![1, 5])] {
            yard.keeps_triangles = keeps_triangles;
            let plan = yard.scan(if keeps_triangles { "full plan" } else { "plan" }).unwrap();
            ids.push(plan.id());
            for count in counts {
                let mut fragments = yard.shards(&plan, count);
                fragments.reverse();
                let merged = yard.merge(&fragments).unwrap();
                assert!(merged == yard.whole, "{count} shards, {voxels:?}, {keeps_triangles}: other bytes");
                fragments.iter().for_each(|fragment| std::fs::remove_file(fragment).unwrap());
            }
        }
        assert_eq!(ids[0], ids[1], "a plan is another with its triangles");
        assert_eq!(yard.options.budget.used_bytes(), 0, "a lease is left over");
    }
}

/// The first chunk of a fragment, as it is drawn in `fragment`: where its content begins, and how long it is.
fn first_chunk(fragment: &[u8]) -> (usize, usize) {
    const HEAD: usize = 16;
    let word = |at: usize| u64::from_le_bytes(*fragment[at..].first_chunk().unwrap()) as usize;
    let record = word(fragment.len() - 16);
    // Hash, count of parts, lengths of four parts; then head and materials, behind which lengths of chunks stand.
    let lengths = record + 48 + word(record + 16) + word(record + 24);
    let bytes = u32::from_le_bytes(*fragment[lengths..].first_chunk().unwrap()) as usize;
    (HEAD + 8, bytes - 8)
}

/// Bits of a chunk that somebody has turned, who made its hash right: refused, or built without a panic.
#[test]
fn forged_chunks_are_refused_or_merged() {
    let mut yard = Yard::new(mesh(110, 300, 3), Voxels::Resolution(64));
    let plan = yard.scan("plan").unwrap();
    let [path] = <[PathBuf; 1]>::try_from(yard.shards(&plan, 1)).unwrap();
    let fragment = std::fs::read(&path).unwrap();
    let (at, length) = first_chunk(&fragment);
    assert!(u32::from_le_bytes(*fragment[at..].first_chunk().unwrap()) >= 2, "there are no whole pages");
    let mut rng = rand_pcg::Pcg64::seed_from_u64(9);
    let mut below = |most: usize| rng.next_u32() as usize % most;
    // Numbers of the first page, anything, and the roots at the end.
    let numbers = (0..44).map(|byte| 8 * byte);
    let (some, roots): (Vec<usize>, Vec<usize>) = (
        (0..120).map(|_| below(8 * length)).collect(),
        (0..60).map(|_| 8 * length - 1 - below(4000)).collect(),
    );
    let mut refused = 0;
    for bit in numbers.chain(some).chain(roots) {
        let mut forged = fragment.clone();
        forged[at + bit / 8] ^= 1 << (bit % 8);
        let hash = xxhash_rust::xxh3::xxh3_64_with_seed(&forged[at..at + length], at as u64 - 8);
        forged[at - 8..at].copy_from_slice(&hash.to_le_bytes());
        std::fs::write(&path, &forged).unwrap();
        match yard.merge(std::slice::from_ref(&path)) {
            Ok(_) => {}
            Err(error) => {
                refused += 1;
                assert!([Code::Damaged, Code::Io].contains(&error.code()), "bit {bit}: {error}");
            }
        }
    }
    assert!(refused > 80, "{refused} were refused");
    std::fs::write(&path, &fragment).unwrap();
    assert!(yard.merge(&[path]).unwrap() == yard.whole);
}

/// A shard is the same file, whoever builds it; one that is there is left alone, and one of other inputs is not built.
#[test]
fn fragments_follow_from_plan_and_share() {
    let mut yard = Yard::new(model(false), Voxels::Resolution(64));
    let plan = yard.scan("plan").unwrap();
    let paths = yard.shards(&plan, 2);
    let before: Vec<Vec<u8>> = paths.iter().map(|path| std::fs::read(path).unwrap()).collect();
    assert!(yard.shard(&plan, (2, 2), &paths[1]).unwrap().was_there);
    yard.options = BuildOptions { voxels: Voxels::Resolution(64), ..options(3, 200 << 20) };
    for (number, path) in (1..).zip(&paths) {
        std::fs::remove_file(path).unwrap();
        assert!(!yard.shard(&plan, (number, 2), path).unwrap().was_there);
    }
    let after: Vec<Vec<u8>> = paths.iter().map(|path| std::fs::read(path).unwrap()).collect();
    assert!(before == after, "a shard that was built again is another");
    let other = yard.path("other");
    // A triangle more, a triangle that is moved, and another fact.
    let last = yard.mesh.triangles.len() - 1;
    let (corners, material) = yard.mesh.triangles[last];
    for triangles in [vec![(corners, material); 2], vec![(corners, material + 1)]] {
        yard.mesh.triangles.splice(last.., triangles);
        assert_eq!(yard.shard(&plan, (1, 2), &other).unwrap_err().code(), Code::Usage);
        yard.mesh.triangles.truncate(last);
        yard.mesh.triangles.push((corners, material));
    }
    yard.facts[0].1.push('!');
    assert_eq!(yard.shard(&plan, (1, 2), &other).unwrap_err().code(), Code::InputMismatch);
    for share in [(0, 2), (3, 2), (1, shards::SHARDS + 1)] {
        assert_eq!(yard.shard(&plan, share, &other).unwrap_err().code(), Code::Usage);
    }
    assert!(!other.exists());
}
