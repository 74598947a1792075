//! Names from files on their way to a terminal: whatever they hold, nothing that a terminal obeys comes out.

use crate::command::{document_in, folder, run_in};

/// Clears the screen, sets a colour by one byte and by an 8-bit one, turns the direction, ends a line, rings.
const HOSTILE: &str = "a\u{1b}[2J\u{1b}[31m\u{9b}1mgnp.\u{202e}x\u{2066}\nerror:\u{7}\u{7f}\u{feff}";

/// Whether a terminal does something else with it than to draw it; by the Unicode tables of Cc, Cf and Zl.
fn is_obeyed(c: char) -> bool {
    let code = u32::from(c);
    code < 0x20
        || (0x7f..0xa0).contains(&code)
        || [0x61c, 0xfeff].contains(&code)
        || [0x200b..0x2010, 0x2028..0x202f, 0x2060..0x2070].iter().any(|range| range.contains(&code))
}

#[track_caller]
fn check_tame(line: &str, stream: &str) {
    let bad: Vec<char> = stream.chars().filter(|&c| c != '\n' && is_obeyed(c)).collect();
    assert!(bad.is_empty(), "{line}: {bad:?} in {stream:?}");
    // A line of ours may say so; the name must not make one of its own.
    assert!(!stream.contains("\nerror:\\u"), "{line}: a name begins a line: {stream:?}");
}

/// Error messages and reports gave names to the terminal as they were.
#[test]
fn names_of_files_and_materials_are_told_by_number() {
    let inside = folder();
    let path = |name: &str| inside.path().join(name);
    let name = |ending: &str| format!("{HOSTILE}{ending}");
    std::fs::write(path(&name(".mtl")), format!("newmtl {}\nKd 1 0 0\n", HOSTILE.replace('\n', ""))).unwrap();
    let triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    std::fs::write(path("named.obj"), format!("usemtl {}\n{triangle}", HOSTILE.replace('\n', ""))).unwrap();
    std::fs::write(path(&name(".obj")), format!("mtllib no\u{1b}[31m.mtl\n{triangle}")).unwrap();
    std::fs::write(path(&name(".ply")), "ply\nformat \u{1b}[2J 1.0\nend_header\n").unwrap();
    std::fs::write(path(&name(".toml")), "model = 'x\u{1b}[2J'\n[camera]\n\"\u{1b}[2J\" = 3\n").unwrap();
    std::fs::write(path("bad.trex"), [0x1b; 3000]).unwrap();
    // Words of a command that `split_whitespace` must not cut.
    let run = |words: &[&str]| {
        let mut command = std::process::Command::new(crate::command::TREX);
        command.current_dir(inside.path()).stdin(std::process::Stdio::null());
        let words: Vec<String> = words.iter().map(|word| word.replace('@', HOSTILE)).collect();
        crate::command::ran(&words.join(" "), command.args(&words).output().unwrap())
    };
    let ran = [
        (0, run(&["build", "named.obj", "-o", "@.trex", "-v"])),
        (0, run(&["info", "@.trex"])),
        (0, run(&["info", "@.obj"])),
        (0, run(&["verify", "@.trex"])),
        (0, run(&["render", "@.trex", "-o", "@.png", "--resolution", "8x8", "--integrator", "ao"])),
        (0, run(&["gen", "soup", "--triangles", "10k", "-o", "@.stl"])),
        (2, run(&["build", "named.obj", "-o", "@.trex"])),
        (3, run(&["build", "@.ply", "-o", "out.trex"])),
        (3, run(&["render", "@.toml", "-o", "out.png"])),
        (3, run(&["info", "bad.trex"])),
        (3, run(&["info", "@/no"])),
        (2, run(&["info", &format!("--{}", HOSTILE.replace('\n', ""))])),
        (2, run(&["no\u{1b}[2J\u{9b}1m"])),
    ];
    for (code, ran) in ran {
        assert_eq!(ran.code, Some(code), "{:?}: {}{}", ran.line, ran.stdout, ran.stderr);
        check_tame(&ran.line, &ran.stdout);
        check_tame(&ran.line, &ran.stderr);
    }
    // A document has the name itself, written as JSON does.
    let listed = run(&["info", "@.trex", "--json", "-q"]);
    check_tame(&listed.line, &listed.stdout);
    assert_eq!(listed.document()["scene"], format!("{HOSTILE}.trex"));
    // Others are as they were.
    std::fs::rename(path(&name(".trex")), path("Gr\u{f6}\u{df}e.trex")).unwrap();
    assert!(run_in(inside.path(), "info Gr\u{f6}\u{df}e.trex").stdout.starts_with("Gr\u{f6}\u{df}e.trex:"));
    assert_eq!(document_in(inside.path(), "info Gr\u{f6}\u{df}e.trex")["scene"], "Gr\u{f6}\u{df}e.trex");
}
