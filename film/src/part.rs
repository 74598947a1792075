//! `PartHead`: the head of a part file, which holds the sums of a portion of a picture until all portions are there.
//! Layout: `docs/format.md`.
//!
//! ```text
//! | fixed 144 | facts | hash 8 | block | hash 8 | block | hash 8 | ...      a block for each row of tiles
//! ```
//!
//! Facts are names and values of what decides the picture beside what stands in fixed places: who writes a part states
//! them, and parts whose facts differ make no picture. Their meaning is no matter of this file.
//!
//! Invariants: 1. bytes pass [`PartHead::read`] before any is believed; a length is compared with a maximum before it
//! is used; 2. all bytes are under a hash: that of a block is seeded with the head's and with its row, so that a block
//! of another part or place is found; 3. the length of a file follows from its head.

use crate::film::{Film, Layers, block_bytes, block_bytes_most};
use crate::portion::Portion;
use crate::tile::tile_count;
use std::fmt::{self, Debug, Write as _};
use std::io::{self, Read, Write};
use std::path::Path;
use trex_store::{Code, Error, Result};
use xxhash_rust::xxh3::{Xxh3, xxh3_64, xxh3_64_with_seed};

/// First bytes of a part file.
pub const PART_MAGIC: [u8; 8] = *b"TREXPART";
/// Version of the layout.
pub const PART_VERSION: u32 = 1;
/// Bytes of the fields in fixed places.
const FIXED_BYTES: usize = 144;
/// Most bytes of the facts: some lines.
const FACTS_BYTES_MOST: usize = 64 << 10;
/// Bytes of a hash.
const HASH_BYTES: u64 = 8;
/// Most pixels of a side, and most samples of a pixel: those of the renderer.
const SIDE_MOST: u32 = 1 << 16;
const SPP_MOST: u32 = 1_000_000_000;
/// Numbers of a camera: position, target and up, the angle of view in degrees, and 0 or 1 for its axis.
pub const CAMERA_NUMBERS: usize = 11;

/// What a part file says of itself.
#[derive(Clone, Debug, PartialEq)]
pub struct PartHead {
    /// Width and height of the picture, pixels.
    pub resolution: [u32; 2],
    /// The part of the picture that it holds.
    pub portion: Portion,
    /// Samples of a pixel in the whole picture.
    pub spp: u32,
    /// Layers of the picture, with the filter's input where it is to be filtered.
    pub layers: Layers,
    /// Factor of a PNG of the picture.
    pub exposure: f32,
    /// Pages that were left out, since they are damaged.
    pub damaged_page_count: u32,
    /// The camera, through which the filter looks.
    pub camera: [f64; CAMERA_NUMBERS],
    /// Names and values, each one line, without `=` in a name.
    pub facts: Vec<(String, String)>,
}

/// What of two parts is not the same.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PartDifference {
    /// What it is of.
    pub name: String,
    /// The values of both.
    pub values: [String; 2],
}

impl PartHead {
    /// The bytes of the head, its hash included.
    ///
    /// # Panics
    /// When facts are no lines, or too long.
    pub fn to_bytes(&self) -> Vec<u8> {
        let facts: String = self.facts.iter().map(|(name, value)| format!("{name} = {value}\n")).collect();
        assert!(facts.lines().count() == self.facts.len() && facts.len() <= FACTS_BYTES_MOST, "{facts}");
        let mut bytes = PART_MAGIC.to_vec();
        let [width, height] = self.resolution;
        let Portion { tiles, samples } = self.portion;
        let numbers =
            [PART_VERSION, facts.len() as u32, width, height, tiles[0], tiles[1], samples[0], samples[1]];
        let more = [self.spp, bits_of(self.layers), self.exposure.to_bits(), self.damaged_page_count];
        numbers.into_iter().chain(more).for_each(|number| bytes.extend(number.to_le_bytes()));
        self.camera.iter().for_each(|number| bytes.extend(number.to_le_bytes()));
        assert_eq!(bytes.len(), FIXED_BYTES);
        bytes.extend(facts.as_bytes());
        bytes.extend(xxh3_64(&bytes).to_le_bytes());
        bytes
    }

    /// Reads and checks the head of the part file `path`, of `file_bytes`; `reader` stands before the first block then.
    /// Gives its hash, too.
    ///
    /// # Errors
    /// [`Code::InputFormat`], [`Code::Version`], [`Code::Damaged`]; those of reading.
    pub fn read(path: &Path, reader: &mut impl Read, file_bytes: u64) -> Result<(PartHead, u64)> {
        let mut bytes = vec![0; FIXED_BYTES];
        let other = || {
            Error::new(Code::InputFormat, "this is no part of a picture")
                .at(path)
                .numbers(format!("{file_bytes} bytes, which do not begin as a part file does"))
                .next("name files that were rendered as parts")
        };
        if file_bytes < FIXED_BYTES as u64 {
            return Err(other());
        }
        read_exact(path, reader, &mut bytes)?;
        if bytes[..8] != PART_MAGIC {
            return Err(other());
        }
        let word = |index: usize| u32_at(&bytes, 8 + 4 * index);
        if word(0) != PART_VERSION {
            return Err(Error::new(Code::Version, "a part of another version")
                .at(path)
                .numbers(format!("version {}, this is for version {PART_VERSION}", word(0)))
                .next("render all parts and merge them with the same trex"));
        }
        let facts_bytes = word(1) as usize;
        if facts_bytes > FACTS_BYTES_MOST {
            return Err(damaged(
                path,
                12,
                format!("{facts_bytes} bytes of facts, at most {FACTS_BYTES_MOST}"),
            ));
        }
        bytes.resize(FIXED_BYTES + facts_bytes + HASH_BYTES as usize, 0);
        read_exact(path, reader, &mut bytes[FIXED_BYTES..])?;
        let (hashed, stored) = bytes.split_at(FIXED_BYTES + facts_bytes);
        let (hash, stored) = (xxh3_64(hashed), u64_at(stored, 0));
        if hash != stored {
            let numbers = format!("hash {stored:016x} stored, {hash:016x} found");
            return Err(damaged(path, hashed.len() as u64, numbers));
        }
        let head = PartHead::parse(hashed).map_err(|numbers| damaged(path, 0, numbers))?;
        let expected = head.file_bytes();
        if file_bytes != expected {
            return Err(damaged(
                path,
                file_bytes.min(expected),
                format!("{file_bytes} bytes, {expected} expected"),
            ));
        }
        Ok((head, hash))
    }

    /// The head of these bytes, which are all that are hashed; else what of them is out of range.
    fn parse(bytes: &[u8]) -> Result<PartHead, String> {
        let word = |index: usize| u32_at(bytes, 8 + 4 * index);
        let pair = |index: usize| [word(index), word(index + 1)];
        let (resolution, portion) = (pair(2), Portion { tiles: pair(4), samples: pair(6) });
        let (spp, layer_bits, exposure) = (word(8), word(9), f32::from_bits(word(10)));
        let Portion { tiles, samples } = portion;
        if resolution.iter().any(|side| !(1..=SIDE_MOST).contains(side)) {
            return Err(format!("{} x {} pixels", resolution[0], resolution[1]));
        }
        if tiles[0] >= tiles[1] || tiles[1] > tile_count(resolution) {
            return Err(format!("tiles {}..{} of {}", tiles[0], tiles[1], tile_count(resolution)));
        }
        if samples[0] >= samples[1] || samples[1] > spp || spp > SPP_MOST {
            return Err(format!("samples {}..{} of {spp}", samples[0], samples[1]));
        }
        let layers = layers_of(layer_bits).ok_or_else(|| format!("layers {layer_bits:#x}"))?;
        if !(exposure > 0.0 && exposure.is_finite()) {
            return Err(format!("exposure {exposure}"));
        }
        let text = str::from_utf8(&bytes[FIXED_BYTES..]).map_err(|error| format!("facts: {error}"))?;
        let fact = |line: &str| {
            let (name, value) = line.split_once(" = ").ok_or_else(|| "a fact without a value".to_owned())?;
            Ok((name.to_owned(), value.to_owned()))
        };
        Ok(PartHead {
            resolution,
            portion,
            spp,
            layers,
            exposure,
            damaged_page_count: word(11),
            camera: std::array::from_fn(|index| f64::from_bits(u64_at(bytes, 56 + 8 * index))),
            facts: text.lines().map(fact).collect::<Result<_, String>>()?,
        })
    }

    /// Length of the file that it is the head of.
    pub fn file_bytes(&self) -> u64 {
        let facts: usize = self.facts.iter().map(|(name, value)| name.len() + value.len() + 4).sum();
        let head = FIXED_BYTES as u64 + facts as u64 + HASH_BYTES;
        // All rows of tiles but the first and the last are alike.
        let rows = self.portion.tile_rows(self.resolution);
        let bytes = |row| block_bytes(self.resolution, self.layers, &self.portion, row) + HASH_BYTES;
        head + rows.map(bytes).sum::<u64>()
    }

    /// The first of what decides a picture, by name and values, that this part and `other` do not share; `None` when
    /// both are of one picture.
    pub fn difference(&self, other: &PartHead) -> Option<PartDifference> {
        let size = |head: &PartHead| format!("{}x{}", head.resolution[0], head.resolution[1]);
        let fixed = |head: &PartHead| {
            let PartHead { spp, layers, exposure, camera, .. } = head;
            [
                ("resolution", size(head)),
                ("spp", spp.to_string()),
                ("layers", layers.to_string()),
                ("exposure", exposure.to_string()),
                ("camera", format!("{camera:?}")),
            ]
        };
        // What says most comes first: another file has another camera, too.
        let facts = |head: &PartHead| head.facts.clone().into_iter();
        let all = |head: &PartHead| {
            let fixed = fixed(head).into_iter().map(|(name, value)| (name.to_owned(), value));
            facts(head).chain(fixed).collect::<Vec<_>>()
        };
        let (ours, theirs) = (all(self), all(other));
        if ours.len() != theirs.len() {
            let values = [ours.len(), theirs.len()].map(|count| format!("{count} facts"));
            return Some(PartDifference { name: "facts".to_owned(), values });
        }
        let both = ours.into_iter().zip(theirs).find(|(one, two)| one != two);
        both.map(|((name, one), (_, two))| PartDifference { name, values: [one, two] })
    }
}

/// Writes the part file of a portion: the head, and the sums and layers of `film`, which has all samples of it.
/// Takes a block of memory, which is less than what an encoder takes.
///
/// # Errors
/// Those of the writer.
///
/// # Panics
/// When the film is of another portion than the head, or lacks samples.
pub fn write_part(film: &Film, head: &PartHead, writer: &mut impl Write) -> io::Result<()> {
    let of_film = (film.resolution(), film.layers(), film.portion().tiles, film.portion().samples[0]);
    assert_eq!(of_film, (head.resolution, head.layers, head.portion.tiles, head.portion.samples[0]));
    assert_eq!(film.samples(), head.portion.samples[1], "a part has all of its samples");
    let bytes = head.to_bytes();
    let head_hash = u64_at(&bytes, bytes.len() - HASH_BYTES as usize);
    writer.write_all(&bytes)?;
    let mut block = Vec::with_capacity(block_bytes_most(head.resolution, head.layers) as usize);
    for row in head.portion.tile_rows(head.resolution) {
        block.clear();
        film.write_block(row, &mut block);
        writer.write_all(&block)?;
        writer.write_all(&block_hash(&block, head_hash, row).to_le_bytes())?;
    }
    Ok(())
}

/// Reads the next block of a part file, of a row of tiles, to `block`; the byte where it begins is for the message.
///
/// # Errors
/// [`Code::Damaged`]; those of reading.
pub(crate) fn read_block(
    path: &Path,
    reader: &mut impl Read,
    (head_hash, row, at): (u64, u32, u64),
    block: &mut [u8],
) -> Result<()> {
    let mut stored = [0; HASH_BYTES as usize];
    read_exact(path, reader, block)?;
    read_exact(path, reader, &mut stored)?;
    let (hash, stored) = (block_hash(block, head_hash, row), u64::from_le_bytes(stored));
    if hash == stored {
        return Ok(());
    }
    Err(damaged(path, at, format!("row {row} of tiles: hash {stored:016x} stored, {hash:016x} found")))
}

/// Bytes of the head of a part file.
pub(crate) fn head_bytes(head: &PartHead) -> u64 {
    head.to_bytes().len() as u64
}

/// Bytes that a block takes in a file beside its pixels.
pub(crate) const BLOCK_HASH_BYTES: u64 = HASH_BYTES;

/// The error of a part whose bytes are not what they were.
pub(crate) fn damaged(path: &Path, at: u64, numbers: String) -> Error {
    Error::new(Code::Damaged, "a part of a picture is damaged")
        .at_byte(path, at)
        .numbers(numbers)
        .next("render this part again")
}

/// A hash of what `value` shows for debugging: equal values of one version of this program have one.
pub fn digest(value: &impl Debug) -> u64 {
    struct Hasher(Xxh3);
    impl fmt::Write for Hasher {
        fn write_str(&mut self, text: &str) -> fmt::Result {
            self.0.update(text.as_bytes());
            Ok(())
        }
    }
    let mut hasher = Hasher(Xxh3::new());
    write!(hasher, "{value:?}").expect("hashing does not fail");
    hasher.0.digest()
}

fn block_hash(block: &[u8], head_hash: u64, row: u32) -> u64 {
    xxh3_64_with_seed(block, head_hash ^ u64::from(row))
}

fn read_exact(path: &Path, reader: &mut impl Read, bytes: &mut [u8]) -> Result<()> {
    reader.read_exact(bytes).map_err(|error| match error.kind() {
        io::ErrorKind::UnexpectedEof => damaged(path, 0, "it ends before its last byte".to_owned()),
        _ => Error::io("read the part", path, &error),
    })
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"))
}

/// Layers as bits: depth, normal, albedo, id, filter.
fn bits_of(layers: Layers) -> u32 {
    let Layers { depth, normal, albedo, id, filter } = layers;
    (0..).zip([depth, normal, albedo, id, filter]).map(|(bit, is_kept)| u32::from(is_kept) << bit).sum()
}

fn layers_of(bits: u32) -> Option<Layers> {
    let is = |bit: u32| bits >> bit & 1 == 1;
    let layers = Layers { depth: is(0), normal: is(1), albedo: is(2), id: is(3), filter: is(4) };
    (bits_of(layers) == bits).then_some(layers)
}

impl fmt::Display for Layers {
    /// Their names, `none` without any.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Layers { depth, normal, albedo, id, filter } = *self;
        let all = [(depth, "depth"), (normal, "normal"), (albedo, "albedo"), (id, "id"), (filter, "filter")];
        let names: Vec<&str> =
            all.into_iter().filter_map(|(is_kept, name)| is_kept.then_some(name)).collect();
        f.write_str(if names.is_empty() { "none" } else { "" })?;
        f.write_str(&names.join(", "))
    }
}

#[cfg(test)]
mod tests;
