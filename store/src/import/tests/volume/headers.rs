//! Headers of each kind lead to the same samples: types, orders of bytes, packing, detached files, what is left out.

use super::{check_closed, nrrd, sampled, surfaces, with_values};
use crate::import::tests::{Fixture, SourceTriangle, read, same};
use crate::import::{ByteOrder, Encoding, Format, RawVolume, SamplePacking, SampleType, info};
use std::os::unix::ffi::OsStringExt;

const SIZE: [usize; 3] = [13, 14, 15];
const VALUE: f64 = 49.5;

/// Integers from 0 to 100: each type holds them.
fn integers() -> Vec<f64> {
    let far = |at: [f64; 3]| (0..3).map(|axis| (at[axis] - 6.2).powi(2)).sum::<f64>();
    sampled(SIZE, |at| (100.0 - 3.0 * far(at)).max(0.0).round())
}

fn expected() -> Vec<SourceTriangle> {
    let triangles = surfaces("a.nrrd", &nrrd(SIZE, &integers(), ""), &[VALUE]).unwrap().triangles;
    check_closed(&triangles);
    triangles
}

/// The samples as bytes.
fn bytes(sample: SampleType, order: ByteOrder) -> Vec<u8> {
    let bytes = |value: f64| -> Vec<u8> {
        let mut bytes = match sample {
            SampleType::Int8 => (value as i8).to_le_bytes().to_vec(),
            SampleType::Uint8 => (value as u8).to_le_bytes().to_vec(),
            SampleType::Int16 => (value as i16).to_le_bytes().to_vec(),
            SampleType::Uint16 => (value as u16).to_le_bytes().to_vec(),
            SampleType::Int32 => (value as i32).to_le_bytes().to_vec(),
            SampleType::Uint32 => (value as u32).to_le_bytes().to_vec(),
            SampleType::Int64 => (value as i64).to_le_bytes().to_vec(),
            SampleType::Uint64 => (value as u64).to_le_bytes().to_vec(),
            SampleType::Float32 => (value as f32).to_le_bytes().to_vec(),
            SampleType::Float64 => value.to_le_bytes().to_vec(),
        };
        if order == ByteOrder::Big {
            bytes.reverse();
        }
        bytes
    };
    integers().into_iter().flat_map(bytes).collect()
}

/// A gzip file, in members of which the sum of each is computed bit by bit.
pub(super) fn gzip(content: &[u8], members: usize) -> Vec<u8> {
    let mut file = Vec::new();
    for part in content.chunks(content.len().div_ceil(members)) {
        file.extend([0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 3]);
        file.extend(miniz_oxide::deflate::compress_to_vec(part, 6));
        let sum = part.iter().fold(u32::MAX, |sum, &byte| {
            (0..8).fold(sum ^ u32::from(byte), |sum, _| (sum >> 1) ^ (0xedb8_8320 & (sum & 1).wrapping_neg()))
        });
        file.extend((!sum).to_le_bytes());
        file.extend((part.len() as u32).to_le_bytes());
    }
    file
}

/// Fails unless `file`, with others beside it, has the surface.
#[track_caller]
fn check(name: &str, file: &[u8], beside: &[(&str, &[u8])]) {
    let fixture = Fixture::new(name, file);
    for (name, content) in beside {
        std::fs::write(fixture.path.with_file_name(name), content).unwrap();
    }
    let mesh = read(&fixture.path, &with_values(&fixture, &[VALUE]));
    let mesh = mesh.unwrap_or_else(|error| panic!("{error}\n{}", String::from_utf8_lossy(file)));
    assert!(same(&mesh.triangles, &expected()), "{}", String::from_utf8_lossy(file));
    let named: Vec<_> = mesh.stats.named_files.iter().map(|(path, _)| path.clone()).collect();
    let there = beside.iter().map(|(name, _)| fixture.path.with_file_name(name).into_os_string().into_vec());
    assert_eq!(named, there.collect::<Vec<_>>());
    let told = info(&fixture.path, &with_values(&fixture, &[VALUE])).unwrap();
    let told = told.named_files.into_iter().map(|path| path.into_os_string().into_vec());
    assert_eq!(told.collect::<Vec<_>>(), named);
}

#[test]
fn types_and_orders_give_the_same_surface() {
    let types = ["int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float", "double"];
    for name in types {
        let sample = SampleType::from_name(name).unwrap();
        for (order, word) in [(ByteOrder::Little, "little"), (ByteOrder::Big, "BIG")] {
            let head = format!(
                "NRRD0005\n# c\r\ntype: {name}\ndimension: 3\nsizes: 13 14 15\nkey:=a: value\nendian: {word}\n\
                 encoding: raw\n\n"
            );
            check("a.nrrd", &[head.as_bytes(), &bytes(sample, order)].concat(), &[]);
            let fixture = Fixture::new("a.RAW", &bytes(sample, order));
            let mut options = with_values(&fixture, &[VALUE]);
            let size = SIZE.map(|side| side as u64);
            options.volumes.raw = Some(RawVolume { size, sample, order, spacing: [1.0; 3] });
            assert!(same(&read(&fixture.path, &options).unwrap().triangles, &expected()), "{name} {word}");
        }
    }
}

#[test]
fn samples_may_be_packed_or_in_another_file() {
    let plain = bytes(SampleType::Int16, ByteOrder::Big);
    let head = "NRRD0001\ntype: short\ndimension: 3\nsizes: 13 14 15\nendian: big\n";
    let join = |fields: &str, samples: &[u8]| [head.as_bytes(), fields.as_bytes(), samples].concat();
    for members in [1, 3] {
        check("a.nrrd", &join("encoding: gzip\n\n", &gzip(&plain, members)), &[]);
    }
    check("a.nrrd", &join("encoding: raw\nbyte skip: 5\n\n", &[b"12345", &plain[..]].concat()), &[]);
    check("a.nrrd", &join("encoding: raw\nbyteskip: -1\n\n", &[b"12345", &plain[..]].concat()), &[]);
    check("a.nhdr", &join("encoding: raw\ndata file: b c.bin\n", &[]), &[("b c.bin", &plain)]);
    // Lines before what is packed, bytes within it.
    let skipped = gzip(&[b"12345", &plain[..]].concat(), 1);
    check(
        "a.nhdr",
        &join("encoding: gz\nlineskip: 2\nbyte skip: 5\ndatafile: b.gz\n\n", &[]),
        &[("b.gz", &[b"one\ntwo\n", &skipped[..]].concat())],
    );
}

#[test]
fn metaimage_has_its_own_words() {
    let plain = bytes(SampleType::Uint16, ByteOrder::Big);
    let head = "ObjectType = Image\nNDims = 3\nDimSize = 13 14 15\nElementType = MET_USHORT\n\
                BinaryDataByteOrderMSB = True\n";
    let join = |fields: &str, samples: &[u8]| [head.as_bytes(), fields.as_bytes(), samples].concat();
    check("a.mhd", &join("ElementDataFile = b.raw\nComment = more\n", &[]), &[("b.raw", &plain)]);
    check(
        "a.mhd",
        &join("HeaderSize = -1\nElementDataFile=b.raw", &[]),
        &[("b.raw", &[b"header", &plain[..]].concat())],
    );
    check("a.mha", &join("HeaderSize = 3\nElementDataFile = LOCAL\n", &[b"123", &plain[..]].concat()), &[]);
    let packed = miniz_oxide::deflate::compress_to_vec_zlib(&plain, 6);
    check("a.mha", &join("CompressedData = True\nElementDataFile = LOCAL\n", &packed), &[]);
    let moved = "Offset = 5 6 7\nElementSpacing = 2 3 4\nTransformMatrix = 0 1 0 1 0 0 0 0 1\n\
                 ElementDataFile = LOCAL\n";
    let mesh = surfaces("a.mha", &join(moved, &plain), &[VALUE]).unwrap();
    for (moved, plain) in mesh.triangles.iter().zip(&expected()) {
        let mut expected = plain.map(|[x, y, z]| [5.0 + 3.0 * y, 6.0 + 2.0 * x, 7.0 + 4.0 * z]);
        expected.swap(1, 2);
        assert_eq!(*moved, expected);
    }
}

#[test]
fn info_tells_what_a_header_says() {
    let fixture =
        Fixture::new("a.nrrd", &nrrd(SIZE, &integers(), "spacings: 1 2 nan\nspace origin: (3,4,5)\n"));
    let told = info(&fixture.path, &fixture.options()).unwrap();
    assert_eq!((told.format, told.encoding), (Format::Nrrd, Encoding::BinaryLittleEndian));
    let volume = told.volume.unwrap();
    assert_eq!(
        (volume.size, volume.sample_type, volume.packing),
        (SIZE, SampleType::Float64, SamplePacking::None)
    );
    assert_eq!(volume.origin, [3.0, 4.0, 5.0]);
    assert_eq!(volume.steps, [[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]]);
    assert_eq!(volume.sample_file, fixture.path.display().to_string());
}
