//! Volumes that are not what they say: each is refused in four parts, before anything large is taken.

use super::headers::gzip;
use super::{nrrd, sampled, with_values};
use crate::budget::Budget;
use crate::error::{Code, Error};
use crate::import::tests::{Fixture, read};
use crate::import::{ByteOrder, ImportOptions, RawVolume, SampleType, VolumeOptions};

/// Fails unless `file` is refused with this code, and words of the error.
#[track_caller]
fn refused(name: &str, file: &[u8], code: Code, words: &str) -> Error {
    let fixture = Fixture::new(name, file);
    refused_with(&fixture, &with_values(&fixture, &[0.5]), code, words)
}

#[track_caller]
fn refused_with(fixture: &Fixture, options: &ImportOptions, code: Code, words: &str) -> Error {
    let mut error = None;
    let taken = allocation_counter::measure(|| error = read(&fixture.path, options).err()).bytes_max;
    let error = error.unwrap_or_else(|| panic!("{} was read", fixture.path.display()));
    assert_eq!(error.code(), code, "{error}");
    let has_numbers = !error.numbers_text().is_empty() || code == Code::InputUnreadable;
    let parts = [error.what(), error.place(), error.next_step()];
    assert!(has_numbers && parts.iter().all(|part| !part.is_empty()), "{error}");
    assert!(error.to_string().contains(words), "`{words}` is not in: {error}");
    assert!(taken < 4 << 20, "{taken} bytes were taken: {error}");
    error
}

const HEAD: &str = "NRRD0004\ntype: float\ndimension: 3\nsizes: 4 4 4\nendian: little\nencoding: raw\n";

fn with(from: &str, to: &str) -> Vec<u8> {
    assert!(HEAD.contains(from), "{from}");
    [HEAD.replace(from, to).as_bytes(), b"\n", &[0; 256]].concat()
}

#[test]
fn headers_that_make_no_sense() {
    use Code::{InputEmpty, InputFormat, InputRange, InputTruncated, InputUnreadable};
    for (file, code, words) in [
        (b"NRRD0004\n".to_vec(), InputFormat, "`type`"),
        (b"NRRX0004\n".to_vec(), InputFormat, "begins with the letters"),
        (with("NRRD0004", "NRRD0006"), InputFormat, "version 1 to 5"),
        (with("float", "block"), InputFormat, "a.nrrd:2"),
        (with("dimension: 3", "dimension: 4"), InputFormat, "another number of axes"),
        (with("4 4 4", "4 4"), InputFormat, "three numbers"),
        (with("4 4 4", "4 -4 4"), InputFormat, "a.nrrd:4"),
        (with("4 4 4", "4 4 four"), InputFormat, "it says `4 4 four`"),
        (with("4 4 4", "4 0 4"), InputEmpty, "4 x 0 x 4"),
        (with("4 4 4", "4 4 1"), InputEmpty, "two samples"),
        (with("4 4 4", "4294967296 4294967296 4"), InputRange, "too large"),
        (with("4 4 4", "1048577 2 2"), InputRange, "too large"),
        (with("4 4 4", "18446744073709551615 2 2"), InputRange, "too large"),
        (with("4 4 4", "18446744073709551616 2 2"), InputFormat, "three numbers"),
        (with("4 4 4", "4 4 5"), InputTruncated, "320 bytes, and there are 256"),
        (with("4 4 4", "1048576 1048576 4"), InputTruncated, "17592186044416 bytes"),
        (with("little", "middle"), InputFormat, "little or big"),
        (with("endian: little\n", ""), InputFormat, "`endian`"),
        (with("raw", "ascii"), InputFormat, "raw and gzip"),
        (with("raw", "raw\nspacings: 1 0 1"), InputRange, "do not span"),
        (with("raw", "raw\nspacings: 1 inf 1"), InputRange, "do not span"),
        (with("raw", "raw\nspacings: 1e308 1 1"), InputRange, "do not span"),
        (with("raw", "raw\nspace origin: (1,nan,1)"), InputRange, "do not span"),
        (with("raw", "raw\nspace directions: (1,0,0) (0,1,0) (1,1,0)"), InputRange, "do not span"),
        (with("raw", "raw\nspace directions: none (0,1,0) (1,1,0)"), InputFormat, "three vectors"),
        (with("raw", "raw\ndata file: LIST"), InputFormat, "several files"),
        (with("raw", "raw\ndata file: slice%03d.raw 1 4 1"), InputFormat, "several files"),
        (with("raw", "raw\ndata file: not-there.raw"), InputUnreadable, "not-there.raw"),
        (with("raw", "raw\ndata file: ."), InputUnreadable, "regular file"),
        (with("raw", "raw\nbyte skip: 1"), InputTruncated, "there are 255"),
        (with("raw", "raw\nbyte skip: -2"), InputFormat, "byte skip"),
        (with("raw", "raw\nbyte skip: 9223372036854775807"), InputTruncated, "there are 0"),
        (with("raw", "raw\nline skip: 1"), InputTruncated, "fewer lines"),
        (with("raw", "raw\nline skip: 18446744073709551615"), InputRange, "too many lines"),
        (with("raw", "raw\nnonsense"), InputFormat, "a.nrrd:7"),
        (HEAD.as_bytes().to_vec(), InputTruncated, "within its header"),
    ] {
        refused("a.nrrd", &file, code, words);
    }
    let long = [HEAD.as_bytes(), &[b'#'; 2 << 20]].concat();
    refused("a.nrrd", &long, InputFormat, "does not end");
    let unnamed = b"NDims = 3\nDimSize = 4 4 4\nElementType = MET_FLOAT\n";
    refused("a.mhd", unnamed, InputFormat, "`ElementDataFile`");
    let mhd =
        "ObjectType = Image\nNDims = 3\nDimSize = 4 4 4\nElementType = MET_FLOAT\nElementDataFile = LOCAL\n";
    for (from, to, code, words) in [
        ("Image", "Tube", InputFormat, "another thing"),
        ("NDims = 3", "NDims = 2", InputFormat, "another number of axes"),
        ("MET_FLOAT", "MET_FLOAT_ARRAY", InputFormat, "a.mhd:4"),
        ("LOCAL", "LIST", InputFormat, "several files"),
        ("NDims = 3", "ElementNumberOfChannels = 3", InputFormat, "several numbers"),
        ("NDims = 3", "BinaryData = False", InputFormat, "as text"),
        ("NDims = 3", "CompressedData = perhaps", InputFormat, "neither True nor False"),
        ("NDims = 3", "TransformMatrix = 1 0 0", InputFormat, "nine numbers"),
        ("NDims = 3", "no field", InputFormat, "a.mhd:2"),
        ("4 4 4", "4 4 400", InputTruncated, "25600 bytes"),
    ] {
        assert!(mhd.contains(from));
        refused("a.mhd", &[mhd.replace(from, to).as_bytes(), &[0; 256]].concat(), code, words);
    }
}

#[test]
fn packed_samples_are_bounded_and_checked() {
    let head = HEAD.replace("raw", "gzip") + "\n";
    let join = |head: &str, packed: &[u8]| [head.as_bytes(), packed].concat();
    let packed = gzip(&[1; 256], 1);
    // Sixteen MiB in 16 kB: no more comes out than the header says.
    let bomb = join(&head, &gzip(&vec![0; 16 << 20], 1));
    let fixture = Fixture::new("a.nrrd", &bomb);
    let mesh = read(&fixture.path, &with_values(&fixture, &[0.5])).unwrap();
    assert!(mesh.stats.warnings[0].contains("unpack to more"), "{:?}", mesh.stats.warnings);
    let large = head.replace("4 4 4", "100 100 100");
    refused("a.nrrd", &join(&large, &packed), Code::InputTruncated, "4000000 bytes");
    refused("a.nrrd", &join(&head.replace("4 4 4", "4 4 9"), &packed), Code::InputTruncated, "256 bytes");
    refused("a.nrrd", &join(&head, &packed[..packed.len() - 12]), Code::InputTruncated, "end early");
    let mut changed = packed.clone();
    let sum = changed.len() - 8;
    changed[sum] ^= 1;
    refused("a.nrrd", &join(&head, &changed), Code::InputFormat, "damaged");
    refused("a.nrrd", &join(&head, &[0; 60]), Code::InputFormat, "damaged");
    let to_end = head.replace("encoding", "byte skip: -1\nencoding");
    refused("a.nrrd", &join(&to_end, &packed), Code::InputFormat, "no known place");
}

#[test]
fn values_and_descriptions_are_asked_for() {
    let samples = sampled([4, 4, 4], |at| at[0]);
    let fixture = Fixture::new("a.nrrd", &nrrd([4, 4, 4], &samples, ""));
    refused_with(&fixture, &fixture.options(), Code::Usage, "none was named");
    for value in [f64::NAN, f64::INFINITY] {
        refused_with(&fixture, &with_values(&fixture, &[1.0, value]), Code::Usage, "no finite number");
    }
    let many: Vec<f64> = (0..65).map(f64::from).collect();
    refused_with(&fixture, &with_values(&fixture, &many), Code::Usage, "too many surfaces");
    let fixture = Fixture::new("a.raw", &[0; 64]);
    refused_with(&fixture, &with_values(&fixture, &[0.5]), Code::InputFormat, "does not say");
    let raw = |size| {
        let raw = RawVolume { size, sample: SampleType::Uint8, order: ByteOrder::Little, spacing: [1.0; 3] };
        let volumes = VolumeOptions { iso_values: vec![0.5], raw: Some(raw) };
        ImportOptions { volumes, ..fixture.options() }
    };
    refused_with(&fixture, &raw([4, 4, 3]), Code::InputFormat, "48 bytes, and the file has 64");
    refused_with(&fixture, &raw([4, 4, 5]), Code::InputTruncated, "80 bytes");
    refused_with(&fixture, &raw([u64::MAX, 2, 2]), Code::InputRange, "too large");
}

#[test]
fn slices_that_the_limit_has_no_room_for_are_refused() {
    let file = [HEAD.replace("4 4 4", "2048 1024 2").as_bytes(), b"\n", &vec![0; 16 << 20]].concat();
    let fixture = Fixture::new("a.nrrd", &file);
    let mut options = with_values(&fixture, &[0.5]);
    options.budget = Budget::new(30 << 20);
    let error = refused_with(&fixture, &options, Code::MemoryLimit, "two slices");
    assert!((40 << 20..44 << 20).contains(&error.smallest_limit_bytes().unwrap()), "{error}");
    // A ledger that only counts takes no more than there is.
    options.budget = Budget::unlimited();
    options.held_bytes = 8 << 20;
    refused_with(&fixture, &options, Code::MemoryLimit, "two slices");
}
