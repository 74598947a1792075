//! Tests of what flags accept.

use super::*;

#[test]
fn units_are_literal() {
    for (text, expected) in [
        ("1B", 1),
        ("65536B", 65_536),
        ("1kB", 1_000),
        ("1KiB", 1_024),
        ("2MB", 2_000_000),
        ("512MiB", 512 << 20),
        ("512mib", 512 << 20),
        ("1.5GiB", 3 << 29),
        ("2GB", 2_000_000_000),
        ("2GiB", 2 << 30),
        (" 3 TiB ", 3 << 40),
    ] {
        assert_eq!(bytes(text), Ok(Bytes(expected)), "{text}");
    }
    for text in
        ["", "B", "512", "512M", "2G", "-1MiB", "1e3MiB", "0MiB", "0.1B", "9999999999TiB", "1.2.3MB", "inf B"]
    {
        let why = bytes(text).expect_err(text);
        assert!(why.contains("accepted are"), "{text}: {why}");
    }
}

#[test]
fn memory_limits_are_amounts_shares_or_auto() {
    assert_eq!(memory_limit("auto"), Ok(MemoryLimit::AUTO));
    assert_eq!(memory_limit("100%"), Ok(MemoryLimit::Percent(100)));
    assert_eq!(memory_limit("256MiB"), Ok(MemoryLimit::Bytes(256 << 20)));
    for text in ["0%", "101%", "50.5%", "%", "-5%", "Auto", "lots", "256"] {
        assert!(memory_limit(text).is_err(), "{text}");
    }
    assert!(memory_limit("256").unwrap_err().contains("50%"));
    assert_eq!(MemoryLimit::Percent(50).resolve(u64::MAX), u64::MAX / 2);
    assert_eq!(MemoryLimit::Bytes(7).resolve(3), 7);
}

#[test]
fn counts_have_decimal_units() {
    for (text, expected) in
        [("1", 1), ("250_000", 250_000), ("250k", 250_000), ("1.5M", 1_500_000), ("1G", 1_000_000_000)]
    {
        assert_eq!(count(text), Ok(expected), "{text}");
    }
    for text in ["", "0", "-1", "M", "5MM", "1e6", "5G", "five", "5MiB", "1.4", ".5", "1."] {
        assert!(count(text).is_err(), "{text}");
    }
    // As a float this would be 2^63.
    assert_eq!((whole("0"), whole("9223372036854775807")), (Ok(0), Ok((1 << 63) - 1)));
    assert!(whole("18446744073709551616").is_err() && whole("99999999999G").is_err());
}

#[test]
fn resolutions_are_bounded() {
    assert_eq!(resolution("1024x768"), Ok(Resolution { width: 1024, height: 768 }));
    assert_eq!(resolution("1X65536"), Ok(Resolution { width: 1, height: 65_536 }));
    for text in ["", "x", "1024", "0x5", "5x0", "65537x1", "5x5x5", "-5x5", "1024 x 768"] {
        assert!(resolution(text).unwrap_err().contains("WIDTHxHEIGHT"), "{text}");
    }
}

#[test]
fn voxels_are_one_or_two_resolutions() {
    let voxels_of =
        |upper, factor| Ok(Voxels { upper, refinement: Refinement::from_factor(factor).unwrap() });
    for (text, upper, factor) in
        [("64", 64, 1), ("512/512", 512, 1), ("256/1024", 256, 4), ("1024/16384", 1024, 16)]
    {
        assert_eq!(voxels(text), voxels_of(upper, factor), "{text}");
    }
    for text in
        ["", "0", "128", "512/", "/512", "512/1024", "512/4096/1", "1024/512", "256/16384", "512/0", "-64"]
    {
        assert!(voxels(text).unwrap_err().contains("RU/RFINEST"), "{text}");
    }
}

#[test]
fn vectors_have_three_finite_parts() {
    assert_eq!(vec3("1.5,-2,1e3"), Ok(Vec3([1.5, -2.0, 1000.0])));
    for text in ["", "1,2", "1,2,3,4", "1,2,nan", "1,inf,3", "1,,3", "(1,2,3)"] {
        assert!(vec3(text).is_err(), "{text}");
    }
}

#[test]
fn times_angles_and_lengths_are_above_zero() {
    for (text, expected) in [("90", 90.0), ("90s", 90.0), ("2min", 120.0), ("1500ms", 1.5)] {
        assert_eq!(seconds(text), Ok(Seconds(expected)), "{text}");
    }
    for text in ["", "0", "-1s", "nan", "inf", "1h"] {
        assert!(seconds(text).is_err(), "{text}");
    }
    assert_eq!((milliseconds("33"), milliseconds("1.5ms")), (Ok(Milliseconds(33.0)), Ok(Milliseconds(1.5))));
    assert!(milliseconds("0").is_err() && milliseconds("1s").is_err());
    assert_eq!(
        (fetch_block("1"), fetch_block("adaptive")),
        (Ok(FetchBlock::Tiles(1)), Ok(FetchBlock::Adaptive))
    );
    assert!(fetch_block("0").is_err() && fetch_block("1048577").is_err() && fetch_block("x").is_err());
    assert_eq!(positive("0.001"), Ok(0.001));
    assert!(positive("0").is_err() && positive("inf").is_err() && positive("x").is_err());
    assert_eq!(degrees("45"), Ok(45.0));
    assert!(degrees("0").is_err() && degrees("180").is_err());
}

#[test]
fn inputs_are_files_or_generators() {
    assert_eq!(Input::from(OsString::from("gen:pipes:5M")), Input::Generated("gen:pipes:5M".into()));
    assert_eq!(Input::from(OsString::from("./gen:odd.ply")), Input::File("./gen:odd.ply".into()));
}

#[test]
fn sections_are_a_point_and_a_normal() {
    assert_eq!(section("1,-2,0.5,0,0,-3"), Ok(SectionPlane([1.0, -2.0, 0.5, 0.0, 0.0, -3.0])));
    for text in ["", "1,2,3", "0,0,0,0,0,0", "0,0,0,0,0,inf", "nan,0,0,0,0,1", "0,0,0,0,0,1,1"] {
        assert!(section(text).unwrap_err().contains("accepted are"), "{text}");
    }
}

#[test]
fn boxes_are_not_empty() {
    let bounds = ModelBox { lo: [-1.0, 0.0, 2.0], hi: [1.0, 0.5, 3.0] };
    assert_eq!(model_box("-1,0,2,1,0.5,3"), Ok(bounds));
    for text in ["", "1,2,3", "0,0,0,1,1,0", "0,0,0,1,1,-1", "0,0,0,1,1,inf", "0,0,0,1,1,1,1"] {
        assert!(model_box(text).unwrap_err().contains("accepted are"), "{text}");
    }
}
