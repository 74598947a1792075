//! Seeds of the targets that read volumes.

/// Small balls, as plain samples and packed.
pub(super) fn put_volumes(put: &dyn Fn(&str, &str, &[u8])) {
    let side = 0..6i32;
    let places = side.clone().flat_map(|z| side.clone().flat_map(move |y| (0..6).map(move |x| [x, y, z])));
    let bytes: Vec<u8> = places
        .map(|at| {
            (100 - at.iter().map(|part| 8 * (2 * part - 5) * (2 * part - 5) / 4).sum::<i32>()).max(0) as u8
        })
        .collect();
    let floats = |swap: fn(f32) -> [u8; 4]| -> Vec<u8> {
        bytes.iter().flat_map(|&byte| swap(f32::from(byte) - 0.25)).collect()
    };
    let head = "NRRD0004\n# c\nkey:=value\ndimension: 3\nsizes: 6 6 6\nspace origin: (1,2,3)\n";
    let plain = format!("{head}type: float\nendian: big\nencoding: raw\nspacings: 1 2 nan\n\n");
    put("nrrd", "plain.nrrd", &[plain.as_bytes(), &floats(f32::to_be_bytes)].concat());
    let packed = format!("{head}type: uchar\nencoding: gzip\nspace directions: (1,0,0) (0,0,1) (0,1,0)\n\n");
    // A member of gzip: head, deflate, sum and length of what was packed.
    let member =
        [&[0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 3], &*miniz_oxide::deflate::compress_to_vec(&bytes, 6)].concat();
    let sum = bytes.iter().fold(u32::MAX, |sum, &byte| {
        (0..8).fold(sum ^ u32::from(byte), |sum, _| (sum >> 1) ^ (0xedb8_8320 & (sum & 1).wrapping_neg()))
    });
    let tail = [(!sum).to_le_bytes(), (bytes.len() as u32).to_le_bytes()].concat();
    put("nrrd", "packed.nrrd", &[packed.as_bytes(), &member, &tail].concat());
    let head =
        "ObjectType = Image\nNDims = 3\nDimSize = 6 6 6\nElementType = MET_UCHAR\nElementSpacing = 1 2 1\n";
    put("mhd", "local.mhd", &[head.as_bytes(), b"ElementDataFile = LOCAL\n", &bytes].concat());
    let packed = miniz_oxide::deflate::compress_to_vec_zlib(&bytes, 6);
    put(
        "mhd",
        "packed.mhd",
        &[head.as_bytes(), b"CompressedData = True\nElementDataFile = LOCAL\n", &packed].concat(),
    );
    put("raw", "floats", &[&[6, 6, 6], &*floats(f32::to_le_bytes)].concat());
}
