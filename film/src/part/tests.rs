//! Part files that are not what they were, and heads that do not belong together.

use super::*;
use crate::tile::tile;
use trex_store::Budget;

const RESOLUTION: [u32; 2] = [21, 19];

pub(crate) fn head(portion: Portion, layers: Layers) -> PartHead {
    PartHead {
        resolution: RESOLUTION,
        portion,
        spp: 4,
        layers,
        exposure: 1.5,
        damaged_page_count: 0,
        camera: std::array::from_fn(|index| index as f64 / 7.0),
        facts: vec![("file".to_owned(), "0123".to_owned()), ("device".to_owned(), "cpu = all".to_owned())],
    }
}

/// A part file of some tiles and samples.
fn part() -> (PartHead, Vec<u8>) {
    let layers = Layers { filter: true, depth: true, ..Layers::default() };
    let portion = Portion { tiles: [2, 8], samples: [0, 2] };
    let lease = Budget::unlimited().lease("a film", 1 << 20).unwrap();
    let mut film = Film::of_portion(RESOLUTION, layers, portion, lease);
    for tile in (2..8).map(|index| tile(RESOLUTION, index)) {
        let lights = vec![[0.5, 0.25, tile.index as f32]; 2 * tile.pixel_count() as usize];
        film.add(&tile, &lights);
        film.add_indirect(&tile, &lights);
    }
    let (head, mut bytes) = (head(portion, layers), vec![]);
    write_part(&film, &head, &mut bytes).unwrap();
    (head, bytes)
}

/// Reads all of a part file.
fn read_all(bytes: &[u8]) -> Result<PartHead> {
    let (path, mut reader) = (Path::new("a.trexpart"), bytes);
    let (head, hash) = PartHead::read(path, &mut reader, bytes.len() as u64)?;
    for row in head.portion.tile_rows(head.resolution) {
        let mut block = vec![0; block_bytes(head.resolution, head.layers, &head.portion, row) as usize];
        read_block(path, &mut reader, (hash, row, 0), &mut block)?;
    }
    Ok(head)
}

#[test]
fn a_head_comes_back() {
    let (head, bytes) = part();
    assert_eq!(read_all(&bytes).unwrap(), head);
    assert_eq!((head.file_bytes(), &bytes[..8]), (bytes.len() as u64, &PART_MAGIC[..]));
}

/// Every byte is under a hash: whichever changes, and however short the file becomes, is told in four parts.
#[test]
fn a_changed_byte_is_found_wherever_it_stands() {
    let (_, bytes) = part();
    let check = |bytes: &[u8], what: &str| {
        let error = read_all(bytes).expect_err(what);
        assert!([Code::Damaged, Code::InputFormat, Code::Version].contains(&error.code()), "{what}: {error}");
        assert!(
            !error.numbers_text().is_empty() && !error.next_step().is_empty() && !error.place().is_empty()
        );
    };
    for at in 0..bytes.len() {
        let mut changed = bytes.clone();
        changed[at] ^= 1 << (at % 8);
        check(&changed, &format!("byte {at}"));
    }
    for length in (0..bytes.len()).step_by(7) {
        check(&bytes[..length], &format!("{length} bytes"));
    }
    check(&[&bytes[..], &[0]].concat(), "a byte more");
}

/// Hashed numbers that make no sense: who writes a hash may lie.
#[test]
fn lies_under_a_hash_are_refused() {
    let (_, bytes) = part();
    let end = u32_at(&bytes, 12) as usize + FIXED_BYTES;
    let fields: [(usize, u32); 12] = [
        (16, 0),
        (16, SIDE_MOST + 1),
        (24, 8),
        (28, 10),
        (28, u32::MAX),
        (32, 2),
        (36, 5),
        (40, u32::MAX),
        (44, 32),
        (48, f32::NAN.to_bits()),
        (48, 0),
        (12, 1 << 30),
    ];
    for (at, value) in fields {
        let mut changed = bytes.clone();
        changed[at..at + 4].copy_from_slice(&value.to_le_bytes());
        let hash = xxh3_64(&changed[..end]);
        changed[end..end + 8].copy_from_slice(&hash.to_le_bytes());
        let error = read_all(&changed).expect_err(&format!("{value} at {at}"));
        assert_eq!(error.code(), Code::Damaged, "{value} at {at}: {error}");
    }
}

/// A block of another part with the same pixels, or of another row, has another hash.
#[test]
fn blocks_of_other_parts_and_rows_are_found() {
    let (mut head, bytes) = part();
    let first = head_bytes(&head) as usize;
    head.camera[0] += 1.0;
    let mut other = head.to_bytes();
    other.extend(&bytes[first..]);
    assert_eq!(read_all(&other).unwrap_err().code(), Code::Damaged);
}

#[test]
fn what_differs_is_named() {
    let whole = head(Portion::whole(RESOLUTION, 4), Layers::default());
    let part = head(Portion { tiles: [1, 2], samples: [0, 3] }, Layers::default());
    assert_eq!(whole.difference(&PartHead { damaged_page_count: 7, ..part.clone() }), None);
    let names = |other: PartHead| whole.difference(&other).unwrap().name;
    assert_eq!(names(PartHead { spp: 5, ..part.clone() }), "spp");
    assert_eq!(names(PartHead { exposure: 2.0, ..part.clone() }), "exposure");
    assert_eq!(names(PartHead { resolution: [21, 20], ..part.clone() }), "resolution");
    assert_eq!(names(PartHead { camera: [0.0; 11], ..part.clone() }), "camera");
    assert_eq!(
        names(PartHead { layers: Layers { id: true, ..Layers::default() }, ..part.clone() }),
        "layers"
    );
    let mut facts = part.facts.clone();
    facts[1].1 = "gpu".to_owned();
    let found = whole.difference(&PartHead { facts, ..part }).unwrap();
    assert_eq!((found.name.as_str(), found.values), ("device", ["cpu = all".to_owned(), "gpu".to_owned()]));
}
