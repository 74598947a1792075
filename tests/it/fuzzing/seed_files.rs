//! Seeds of the targets that read volumes and texts.

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

/// Seeds of materials, scenes and views.
pub(super) fn put_texts(put: &dyn Fn(&str, &str, &[u8])) {
    let materials = "newmtl a b\nKd 0.5 0.25 0\nKs 0.1 0.1 0.1\nNs 30\nd 0.5\nmap_Kd wood.png\n# c\n\
                     newmtl a\nKe 4 5 6\nillum 5\nTr 0.25\nnewmtl b\nKd spectral x.rfl\n";
    put("mtl", "odd.mtl", materials.as_bytes());
    let all = "model = \"a.trex\"\n[camera]\nposition = [1, 2, 3.5]\ntarget = [0, 0, 0]\nup = [0, 1, 0]\nfov_x = 44.0\n\
               [[light]]\ntype = \"rect\"\ncorner = [-4.0, 4.0, -2]\nedge_u = [2, 0, 0]\nedge_v = [0, 0, 2]\n\
               radiance = [2, 1.9, 1e1]\n[material.floor]\nkd = [0.5, 0.5, 0]\nmirror = true\n\
               [render]\nresolution = [512, 256]\nspp = 64\nintegrator = \"photon\"\n";
    put("scene", "all.toml", all.as_bytes());
    let views = "[[view]]\nposition = [1, 2, 3]\ntarget = [0, 0, 0]\n[[view]]\nposition = [1, 0, 0]\n\
                 target = [0, 0, 0]\nup = [0, 0, 1]\n";
    put("views", "two.toml", views.as_bytes());
}
