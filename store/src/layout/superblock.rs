//! `Superblock`: the head of the file and its copy at the end: what the file holds, and where.
//!
//! Invariants: 1. what is read passes [`Superblock::parse`] before any field is believed; 2. counts agree with each
//! other, so that no sum of them is too large; 3. a slot of the sections that is not used is zero, and no kind stands
//! twice.

use super::fields::{Cursor, FieldWriter};
use super::*;
use crate::attributes::AttributeSet;
use crate::error::{Code, Error, Result};
use crate::geom::{Aabb, Lattice};
use crate::next_step::NextStep;
use std::path::Path;
use xxhash_rust::xxh3::xxh3_64;

/// Where a section stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Section {
    /// A [`SectionKind`]; 0 = slot not used, all of it zero.
    pub kind: u32,
    /// Items in it.
    pub count: u32,
    /// Where it begins.
    pub offset: u64,
    /// Its length.
    pub bytes: u64,
    /// XXH3-64 of its bytes, seeded with the file id.
    pub hash: u64,
}

/// The head of the file: what it holds and where.
#[derive(Clone, Debug, PartialEq)]
pub struct Superblock {
    /// Length of the whole file.
    pub file_bytes: u64,
    /// Hash of the input's content and the options.
    pub file_id: u64,
    /// The lattice of all positions.
    pub lattice: Lattice,
    /// Most lattice steps along any axis, in bits.
    pub lattice_bits: u32,
    /// Node origins are lattice coordinates shifted right by this (0 up to 30 lattice bits).
    pub node_shift: u32,
    /// Largest distance, per axis, between an input vertex and its lattice point; model units.
    pub error_bound: f64,
    /// Box of all stored vertices, model units.
    pub bounds: Aabb,
    /// Box of all stored vertices, lattice coordinates: least corner, greatest corner.
    pub lattice_bounds: [[i64; 3]; 2],
    /// Median edge of the input that the lattice was chosen by; model units.
    pub median_edge: f64,
    /// Triangles of the input.
    pub input_triangle_count: u64,
    /// Triangles stored.
    pub triangle_count: u64,
    /// Vertices stored, counted once per cluster.
    pub vertex_count: u64,
    /// Clusters.
    pub cluster_count: u64,
    /// Wide clusters among them.
    pub wide_cluster_count: u64,
    /// Triangles left out: two equal corners after the snap.
    pub rejected_degenerate: u64,
    /// Those of them that had area in the input: smaller than the lattice can tell.
    pub rejected_collapsed: u64,
    /// Triangles left out: a coordinate is no finite number.
    pub rejected_non_finite: u64,
    /// Frame bytes in use, summed over the pages of the mesh.
    pub resident_bytes: u64,
    /// Bytes of in-page nodes, on disk before packing.
    pub page_tree_bytes: u64,
    /// Pages of colours.
    pub colour_page_count: u64,
    /// Pages of normals.
    pub normal_page_count: u64,
    /// Where the root of the top tree leads, in the encoding of [`crate::cluster::TopRef`].
    pub root: u32,
    /// The sections.
    pub sections: [Section; SECTIONS],
}

impl Superblock {
    /// The bytes as they stand on disk.
    pub fn to_bytes(&self) -> [u8; SUPERBLOCK_BYTES] {
        let mut w = FieldWriter(Vec::with_capacity(SUPERBLOCK_BYTES));
        w.0.extend_from_slice(&MAGIC);
        w.u32(VERSION);
        w.u32(FRAME_BYTES as u32);
        w.u64(self.features());
        w.u64(0); // optional features
        w.u64(self.file_bytes);
        w.u64(self.file_id);
        self.lattice.origin.iter().for_each(|&v| w.f64(v));
        w.u32(self.lattice.exponent as u32);
        w.u32(self.lattice_bits);
        w.u32(self.node_shift);
        w.u32(self.root);
        w.f64(self.error_bound);
        w.f64(self.median_edge);
        self.bounds.lo.iter().chain(&self.bounds.hi).for_each(|&v| w.f64(v));
        self.lattice_bounds.as_flattened().iter().for_each(|&v| w.u64(v as u64));
        for value in [
            self.input_triangle_count,
            self.triangle_count,
            self.vertex_count,
            self.cluster_count,
            self.wide_cluster_count,
            self.rejected_degenerate,
            self.rejected_non_finite,
            self.resident_bytes,
            self.page_tree_bytes,
        ] {
            w.u64(value);
        }
        for section in &self.sections {
            w.u32(section.kind);
            w.u32(section.count);
            w.u64(section.offset);
            w.u64(section.bytes);
            w.u64(section.hash);
        }
        w.u64(self.rejected_collapsed);
        w.u64(self.colour_page_count);
        w.u64(self.normal_page_count);
        let mut bytes = [0; SUPERBLOCK_BYTES];
        assert!(w.0.len() <= SUPERBLOCK_BYTES - 8, "the superblock outgrew its bytes");
        bytes[..w.0.len()].copy_from_slice(&w.0);
        let hash = xxh3_64(&bytes[..SUPERBLOCK_BYTES - 8]);
        bytes[SUPERBLOCK_BYTES - 8..].copy_from_slice(&hash.to_le_bytes());
        bytes
    }

    /// The gate for foreign bytes: magic, hash, version and features, then the fields' ranges.
    ///
    /// # Errors
    /// [`Code::InputFormat`] for another magic, [`Code::Version`], [`Code::Damaged`] for the rest.
    pub fn parse(bytes: &[u8; SUPERBLOCK_BYTES], path: &Path) -> Result<Superblock> {
        if bytes[..8] != MAGIC {
            return Err(Error::new(Code::InputFormat, "this is no trex file")
                .at_byte(path, 0)
                .numbers(format!("magic {:02x?}, expected {MAGIC:02x?}", &bytes[..8]))
                .next(NextStep::Build));
        }
        let stored = u64::from_le_bytes(bytes[SUPERBLOCK_BYTES - 8..].try_into().expect("eight bytes"));
        let found = xxh3_64(&bytes[..SUPERBLOCK_BYTES - 8]);
        if stored != found {
            return Err(damaged("the superblock does not match its hash", path)
                .numbers(format!("hash {found:016x}, expected {stored:016x}")));
        }
        let mut r = Cursor { bytes, at: 8 };
        let (version, frame_bytes, required) = (r.u32(), r.u32(), r.u64());
        r.u64(); // optional features: unknown ones are passed over
        if version != VERSION || required & !REQUIRED_FEATURES != 0 || frame_bytes != FRAME_BYTES as u32 {
            return Err(Error::new(Code::Version, "this trex file needs another version of trex")
                .at(path)
                .numbers(format!(
                    "version {version}, features {required:x}; this build knows {VERSION}, {REQUIRED_FEATURES:x}"
                ))
                .next(if version < VERSION {
                    NextStep::Rebuild
                } else {
                    NextStep::OpenNewerOrRebuild
                }));
        }
        let mut block = Superblock {
            file_bytes: r.u64(),
            file_id: r.u64(),
            lattice: Lattice { origin: [r.f64(), r.f64(), r.f64()], exponent: r.u32() as i32 },
            lattice_bits: r.u32(),
            node_shift: r.u32(),
            root: r.u32(),
            error_bound: r.f64(),
            median_edge: r.f64(),
            bounds: Aabb { lo: [r.f64(), r.f64(), r.f64()], hi: [r.f64(), r.f64(), r.f64()] },
            lattice_bounds: [[0; 3]; 2],
            input_triangle_count: 0,
            triangle_count: 0,
            vertex_count: 0,
            cluster_count: 0,
            wide_cluster_count: 0,
            rejected_degenerate: 0,
            rejected_non_finite: 0,
            rejected_collapsed: 0,
            resident_bytes: 0,
            page_tree_bytes: 0,
            colour_page_count: 0,
            normal_page_count: 0,
            sections: [Section::default(); SECTIONS],
        };
        block.lattice_bounds.as_flattened_mut().iter_mut().for_each(|v| *v = r.u64() as i64);
        for field in [
            &mut block.input_triangle_count,
            &mut block.triangle_count,
            &mut block.vertex_count,
            &mut block.cluster_count,
            &mut block.wide_cluster_count,
            &mut block.rejected_degenerate,
            &mut block.rejected_non_finite,
            &mut block.resident_bytes,
            &mut block.page_tree_bytes,
        ] {
            *field = r.u64();
        }
        block.sections.fill_with(|| read_section(&mut r));
        let Superblock { rejected_collapsed, colour_page_count, normal_page_count, .. } = &mut block;
        [rejected_collapsed, colour_page_count, normal_page_count].into_iter().for_each(|v| *v = r.u64());
        if bytes[r.at..SUPERBLOCK_BYTES - 8].iter().any(|&byte| byte != 0) {
            let numbers = format!("bytes {} to {} must be zero", r.at, SUPERBLOCK_BYTES - 8);
            return Err(damaged("the superblock goes on behind its end", path).numbers(numbers));
        }
        if block.features() != required {
            return Err(damaged("the superblock's features are not those of its parts", path)
                .numbers(format!("features {required:x}")));
        }
        block.check(path).map(|()| block)
    }

    /// Pages of one of [`PageKind::OF_CORNERS`].
    pub fn page_count(&self, kind: PageKind) -> u64 {
        match kind {
            PageKind::Colours => self.colour_page_count,
            PageKind::Normals => self.normal_page_count,
            PageKind::Mesh | PageKind::Units => 0,
        }
    }

    /// The field of [`Self::page_count`].
    pub(crate) fn page_count_mut(&mut self, kind: PageKind) -> &mut u64 {
        match kind {
            PageKind::Normals => &mut self.normal_page_count,
            _ => &mut self.colour_page_count,
        }
    }

    /// What the corners of its triangles have beside their places.
    pub fn attributes(&self) -> AttributeSet {
        AttributeSet { colours: self.colour_page_count > 0, normals: self.normal_page_count > 0 }
    }

    /// The section of `kind`, if the file has it.
    pub fn find_section(&self, kind: SectionKind) -> Option<Section> {
        self.sections.iter().find(|s| s.kind == kind as u32).copied()
    }

    /// The required features that follow from what the file has.
    fn features(&self) -> u64 {
        let lower = if self.has_lower() { FEATURE_LOWER } else { 0 };
        let colours = if self.colour_page_count > 0 { FEATURE_COLOURS } else { 0 };
        let normals = if self.normal_page_count > 0 { FEATURE_NORMALS } else { 0 };
        lower | colours | normals
    }

    fn has_lower(&self) -> bool {
        self.find_section(SectionKind::Lower).is_some()
    }

    /// The section of `kind`, one of [`SectionKind::ALL`].
    pub fn section(&self, kind: SectionKind) -> Section {
        self.find_section(kind).expect("checked by parse")
    }

    /// Whether the counts agree with each other; no sum of them can be too large then.
    fn has_counts(&self) -> bool {
        let rejected = self.rejected_degenerate.checked_add(self.rejected_non_finite);
        rejected.and_then(|n| n.checked_add(self.triangle_count)) == Some(self.input_triangle_count)
            && self.rejected_collapsed <= self.rejected_degenerate
            && self.has_counts_below(TRIANGLES)
    }

    /// Whether the counts of what is stored can be true together, of at most so many triangles.
    pub(crate) fn has_counts_below(&self, triangles_most: u64) -> bool {
        let frame_bytes_most = u64::from(PAGES) * FRAME_BYTES as u64;
        self.triangle_count <= triangles_most
            && self.vertex_count <= 3 * self.triangle_count
            && self.cluster_count <= self.triangle_count
            && self.wide_cluster_count <= self.cluster_count
            && self.colour_page_count <= u64::from(PAGES)
            && self.normal_page_count <= u64::from(PAGES)
            && self.resident_bytes <= frame_bytes_most
            && self.page_tree_bytes <= frame_bytes_most
    }

    /// Whether its lattice and its counts can be those of a model.
    pub(crate) fn has_sound_numbers(&self) -> bool {
        let finite = self.lattice.origin.iter().chain(&self.bounds.lo).chain(&self.bounds.hi);
        finite.chain([&self.error_bound, &self.median_edge]).all(|v| v.is_finite())
            && (-900..=900).contains(&self.lattice.exponent)
            && self.lattice_bits <= Lattice::MAX_BITS
            && self.node_shift == node_shift(self.lattice_bits)
            && self.lattice_bounds.as_flattened().iter().all(|&q| (0..=1 << Lattice::MAX_BITS).contains(&q))
            && self.has_counts()
    }

    fn check(&self, path: &Path) -> Result<()> {
        if !self.has_sound_numbers() {
            return Err(damaged("a field of the superblock is out of its range", path).numbers(format!(
                "{} of {} triangles, {} and {} rejected, {} vertices, {} clusters, {} lattice bits",
                self.triangle_count,
                self.input_triangle_count,
                self.rejected_degenerate,
                self.rejected_non_finite,
                self.vertex_count,
                self.cluster_count,
                self.lattice_bits
            )));
        }
        // A slot that is not used holds nothing: no number in it could be believed.
        let used = || self.sections.iter().filter(|&&section| section != Section::default());
        let is_once = |kind: u32| used().filter(|other| other.kind == kind).count() == 1;
        let has_all = SectionKind::ALL.iter().all(|&kind| self.find_section(kind).is_some());
        if !has_all || !used().all(|section| section.kind != 0 && is_once(section.kind)) {
            let kinds: Vec<u32> = used().map(|section| section.kind).collect();
            let numbers = format!("kinds {kinds:?}; 1 to 4 must be there, none twice, none 0");
            return Err(
                damaged("the superblock's sections are not those of a page file", path).numbers(numbers)
            );
        }
        for section in used() {
            let end = section.offset.checked_add(section.bytes);
            if end.is_none_or(|end| end > self.file_bytes) {
                return Err(damaged("a section ends behind the end of the file", path).numbers(format!(
                    "offset {} + {} bytes, file of {}",
                    section.offset, section.bytes, self.file_bytes
                )));
            }
        }
        Ok(())
    }
}

fn read_section(r: &mut Cursor<'_>) -> Section {
    Section { kind: r.u32(), count: r.u32(), offset: r.u64(), bytes: r.u64(), hash: r.u64() }
}

fn damaged(what: &str, path: &Path) -> Error {
    Error::new(Code::Damaged, what).at(path).next(NextStep::Verify)
}
