//! The viewer as a person has it: `trex view`, a real browser, a hand.
//!
//! One browser and one viewer, since each takes seconds to start; the steps build on each other, and each says what it
//! asks of the page. The page publishes what tests read as `window.trex` (`view/page/app.js`).

mod chromium;
mod devtools;
mod drag;
mod link;
mod parts;
mod saved;
mod viewer;

use crate::command::{cannot_run_without, document_in, folder, pixels, said};
use devtools::{PATIENCE, Tab};
use std::path::Path;
use std::time::{Duration, Instant};
use viewer::Viewer;

/// Of the window. A panel leaves the middle of the picture free from here on.
const SIZE: [u32; 2] = [840, 480];
const MIDDLE: [f64; 2] = [420.0, 240.0];
/// Distance of the camera from what it looks at.
const DISTANCE: &str =
    "(({ position, target }) => Math.hypot(...position.map((x, at) => x - target[at])))(trex.app.camera)";
/// All has come that is to come, of the last event.
const IS_DONE: &str = "trex.last.is_done && trex.last.kind === 2 && trex.last.seq >= trex.seq";
/// Gives tests the picture's colours, from a copy: the page's own canvas is not made for reading.
const READ_PICTURE: &str = "window.read_picture = () => {
    const { width, height } = trex.app.picture.canvas;
    const copy = new OffscreenCanvas(width, height).getContext('2d', { willReadFrequently: true });
    copy.drawImage(trex.app.picture.canvas, 0, 0);
    return copy.getImageData(0, 0, width, height).data.filter((_, at) => at % 4 < 3);
}";
/// Mean of the picture's red, green and blue, 0 to 255.
const MEANS: &str = "[0, 1, 2].map((channel) => {
    const values = read_picture().filter((_, at) => at % 3 === channel);
    return values.reduce((sum, value) => sum + value, 0) / values.length;
})";
/// FNV-1a of the picture's colours, 32 bits.
const HASH: &str =
    "read_picture().reduce((hash, value) => Math.imul(hash ^ value, 0x01000193), 0x811c9dc5) >>> 0";

/// The wheel is given away after ten seconds without an event of the page that has it.
const HANDS_OFF: Duration = Duration::from_millis(10_500);

/// Two materials, a lamp and a floor: enough for each panel to have something to change.
const MODEL: &str = "mtllib room.mtl
v -2 0 -2\nv 2 0 -2\nv 2 0 2\nv -2 0 2
v -0.7 0 0.7\nv 0.7 0 0.7\nv 0.7 0 -0.7\nv -0.7 0 -0.7\nv 0 1.6 0
usemtl floor\nf 1 4 3\nf 1 3 2
usemtl tent\nf 5 6 9\nf 6 7 9\nf 7 8 9\nf 8 5 9\n";
const MATERIALS: &str = "newmtl floor\nKd 0.6 0.6 0.6\nnewmtl tent\nKd 0.5 0.5 0.5\n";
const SCENE: &str = "model = 'room.trex'
[camera]
position = [0, 2, 5]
target = [0, 0.6, 0]
up = [0, 1, 0]
fov_y = 40
[[light]]
type = 'point'
position = [-1.2, 2, 2]
intensity = [12, 12, 12]
[[light]]
type = 'sky'
radiance = [0.2, 0.2, 0.2]
[render]
integrator = 'photon'
photons = 20000
spp = 4
resolution = [840, 480]
";

#[test]
fn a_hand_at_the_page() {
    let Some(command) = chromium::installed() else {
        cannot_run_without("chromium");
        return;
    };
    let inside = folder();
    for (name, text) in [("room.obj", MODEL), ("room.mtl", MATERIALS), ("room.toml", SCENE)] {
        std::fs::write(inside.path().join(name), text).unwrap();
    }
    document_in(inside.path(), "build room.obj -o room.trex");
    let viewer = Viewer::start(inside.path(), "room.toml --memory-limit 256MiB");
    let mut tab = Tab::open(&command, SIZE);
    std::fs::create_dir_all(tab.downloads()).unwrap();
    tab.go(&viewer.address);
    the_picture_comes(&mut tab);
    the_settled_picture_is_the_commands(&mut tab, inside.path(), "first");
    the_hand_moves_the_view(&mut tab);
    fingers_move_the_view(&mut tab);
    keys_move_the_view(&mut tab);
    a_pick_says_what_is_there(&mut tab);
    edits_change_the_picture(&mut tab);
    parts::parts_change_the_picture(&mut tab);
    the_settled_picture_is_the_commands(&mut tab, inside.path(), "cut");
    a_lost_connection_comes_back(&mut tab);
    a_reload_comes_back(&mut tab);
    another_page_takes_the_wheel(&mut tab, &command, &viewer.address);
    the_settled_picture_is_the_commands(&mut tab, inside.path(), "last");
    saved::a_picture_is_saved(&mut tab, inside.path());
    a_settled_page_is_quiet(&mut tab);
    assert_eq!(tab.number("trex.failed"), 0.0);
    assert_eq!(tab.take_complaints(), Vec::<String>::new());
    drop(tab);
    assert_eq!(viewer.end(), Some(0));
}

#[track_caller]
fn settle(tab: &mut Tab) {
    tab.wait_for(IS_DONE);
}

/// Does what changes the picture, waits until the page has sent it, and until all has come that comes of it.
#[track_caller]
fn act(tab: &mut Tab, action: impl FnOnce(&mut Tab)) {
    let before = tab.number("trex.seq");
    action(tab);
    tab.wait_for(&format!("trex.seq > {before} && !trex.app.input.is_busy"));
    tab.listen(Duration::from_millis(50));
    settle(tab);
}

fn the_picture_comes(tab: &mut Tab) {
    tab.wait_for("trex.link === 'driving' && trex.drawn > 0");
    tab.value(READ_PICTURE);
    // The picture follows the window.
    tab.wait_for(&format!("trex.last.width === {} && trex.last.height === {}", SIZE[0], SIZE[1]));
    settle(tab);
    // Whoever reads the address over a shoulder, or in a history, learns no token.
    assert!(!tab.value("location.href").as_str().unwrap().contains("token"));
    // Whoever listens to the page has a name for each button and field.
    let nameless = tab.value(
        "[...document.querySelectorAll('button, input, select, textarea')]
            .filter((part) => !part.getAttribute('aria-label') && !part.textContent.trim() && !part.labels?.length)
            .length",
    );
    assert_eq!(nameless, 0);
}

/// The command line that the page copies makes the picture that the page shows.
fn the_settled_picture_is_the_commands(tab: &mut Tab, inside: &Path, name: &str) {
    settle(tab);
    tab.wait_for("trex.app.state.command.startsWith('trex render ')");
    tab.listen(Duration::from_millis(500));
    // What flags cannot say, lights and materials, is in the scene's text.
    let scene = tab.value("trex.app.state.scene");
    std::fs::write(inside.join("view.toml"), scene.as_str().unwrap()).unwrap();
    let line = tab.value("trex.app.state.command");
    let shown = tab.number(HASH);
    let words = split(line.as_str().unwrap());
    let picture = format!("{name}.png");
    let mut command = crate::command::trex_in(inside, "");
    let output = words.iter().position(|word| word == "-o").map(|at| at + 1);
    for (at, word) in words.iter().enumerate().skip(1) {
        command.arg(if Some(at) == output { &picture } else { word });
    }
    let ran =
        crate::command::ran(line.as_str().unwrap(), command.args(["--overwrite", "-q"]).output().unwrap());
    ran.expect(0);
    let (width, height, bytes) = pixels(&inside.join(&picture));
    assert_eq!([width, height], SIZE, "{line}");
    assert_eq!(shown, f64::from(fnv(&bytes)), "{line}");
}

/// The words of a line for a shell: quotes of both kinds, a backslash before a character.
fn split(line: &str) -> Vec<String> {
    let (mut words, mut quote, mut is_in_word) = (vec![String::new()], None, false);
    let mut characters = line.chars();
    while let Some(character) = characters.next() {
        let word = words.last_mut().unwrap();
        match (quote, character) {
            (Some(open), _) if character == open => quote = None,
            (None, '\'' | '"') => (quote, is_in_word) = (Some(character), true),
            (None | Some('"'), '\\') => word.extend(characters.next().filter(|&next| next != '\n')),
            (None, _) if character.is_whitespace() => {
                if is_in_word {
                    words.push(String::new());
                }
                is_in_word = false;
            }
            _ => {
                word.push(character);
                is_in_word = true;
            }
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

fn fnv(bytes: &[u8]) -> u32 {
    bytes.iter().fold(0x811c_9dc5, |hash, &byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193))
}

fn the_hand_moves_the_view(tab: &mut Tab) {
    let before = tab.value("trex.app.camera");
    let drawn = tab.number("trex.drawn");
    let distance = tab.number(DISTANCE);
    act(tab, |tab| tab.drag(MIDDLE, [560.0, 200.0], 20));
    assert_ne!(tab.value("trex.app.camera"), before);
    assert!(tab.number("trex.drawn") - drawn >= 5.0, "a drag shows pictures on its way");
    assert!((tab.number(DISTANCE) / distance - 1.0).abs() < 1e-9, "a turn keeps the distance");
    assert!(tab.value("location.hash").as_str().unwrap().starts_with("#view="));
    let of_drag = "trex.times.filter(({ flags }) => (flags & 2) !== 0).length";
    said(&format!("pictures while the view moved: {}", tab.number(of_drag)));
    act(tab, |tab| tab.wheel(MIDDLE, -400.0));
    assert!(tab.number(DISTANCE) < 0.7 * distance, "the wheel comes nearer");
    act(tab, |tab| tab.key("Backspace", "Backspace", Duration::ZERO));
    assert!((tab.number(DISTANCE) / distance - 1.0).abs() < 1e-9, "the view before");
    act(tab, |tab| tab.key("r", "KeyR", Duration::ZERO));
    assert_eq!(tab.value("trex.same(trex.app.camera, trex.app.state.home)"), true);
}

fn fingers_move_the_view(tab: &mut Tab) {
    let before = tab.value("trex.app.camera");
    let distance = tab.number(DISTANCE);
    act(tab, |tab| {
        tab.touch("touchStart", &[MIDDLE]);
        for step in 1..=8 {
            tab.touch("touchMove", &[[MIDDLE[0] + 6.0 * f64::from(step), MIDDLE[1]]]);
        }
        tab.touch("touchEnd", &[]);
    });
    assert_ne!(tab.value("trex.app.camera"), before, "one finger turns");
    assert!((tab.number(DISTANCE) / distance - 1.0).abs() < 1e-9);
    let fingers = |apart: f64| [[MIDDLE[0] - apart, MIDDLE[1]], [MIDDLE[0] + apart, MIDDLE[1]]];
    act(tab, |tab| {
        tab.touch("touchStart", &fingers(40.0));
        for step in 1..=8 {
            tab.touch("touchMove", &fingers(40.0 + 5.0 * f64::from(step)));
        }
        tab.touch("touchEnd", &[]);
    });
    let nearer = tab.number(DISTANCE) / distance;
    assert!((0.4..0.6).contains(&nearer), "fingers twice as far apart: half of the way, not {nearer}");
}

fn keys_move_the_view(tab: &mut Tab) {
    act(tab, |tab| tab.key("1", "Digit1", Duration::ZERO));
    let front = tab.value("trex.app.camera");
    act(tab, |tab| tab.key("w", "KeyW", Duration::from_millis(300)));
    let flown = tab.value("trex.app.camera");
    assert_ne!(front["position"], flown["position"]);
    assert_ne!(front["target"], flown["target"], "who flies takes the target along");
    for (key, code) in [("3", "Digit3"), ("7", "Digit7"), ("9", "Digit9")] {
        let before = tab.value("trex.app.camera");
        tab.key(key, code, Duration::ZERO);
        assert_ne!(tab.value("trex.app.camera"), before, "{key}");
    }
    tab.key("?", "Slash", Duration::ZERO);
    tab.wait_for("document.getElementById('help').open");
    tab.key("Escape", "Escape", Duration::ZERO);
    tab.wait_for("!document.getElementById('help').open");
    act(tab, |tab| tab.key("r", "KeyR", Duration::ZERO));
}

fn a_pick_says_what_is_there(tab: &mut Tab) {
    tab.click(MIDDLE, 2);
    tab.wait_for("trex.app.panels.measure.hit");
    assert_eq!(tab.value("trex.app.panels.measure.hit.name"), "tent");
    let [x, y, z] =
        [0, 1, 2].map(|axis| tab.number(&format!("trex.app.panels.measure.hit.position[{axis}]")));
    assert!(x.abs() < 0.05 && (0.2..1.4).contains(&y) && (0.0..0.7).contains(&z), "{x} {y} {z}");
    tab.key("m", "KeyM", Duration::ZERO);
    tab.click([MIDDLE[0] - 60.0, 290.0], 0);
    tab.wait_for("trex.app.panels.measure.first");
    tab.click([MIDDLE[0], 290.0], 0);
    tab.wait_for("trex.app.panels.measure.measures.length === 1");
    tab.key("Escape", "Escape", Duration::ZERO);
}

/// Puts `value` into the field labelled `label` of the open panel, as a hand would.
fn fill(tab: &mut Tab, label: &str, value: &str, event: &str) {
    tab.value(&format!(
        "(() => {{
            const fields = [...document.querySelectorAll('#panel-body :is(input, select)')];
            const text = (field) => field.getAttribute('aria-label') ?? field.labels[0]?.textContent;
            const field = fields.find((field) => text(field) === '{label}');
            field.focus();
            field.value = '{value}';
            field.dispatchEvent(new Event('{event}'));
        }})()"
    ));
}

fn open_panel(tab: &mut Tab, name: &str) {
    tab.value(&format!("document.querySelector('[data-panel={name}]').click()"));
    tab.wait_for(&format!("trex.app.panels.open_name === '{name}'"));
}

fn edits_change_the_picture(tab: &mut Tab) {
    let means = |tab: &mut Tab| {
        let values = tab.value(MEANS);
        [0, 1, 2].map(|channel| values[channel].as_f64().unwrap())
    };
    let before = means(tab);
    open_panel(tab, "materials");
    // The list is the server's; what was picked is chosen in it.
    tab.wait_for("document.querySelector('#panel-body legend')?.textContent === 'tent'");
    act(tab, |tab| fill(tab, "Diffuse, colour", "#ff2000", "input"));
    let red = means(tab);
    assert!(red[0] - red[1] > before[0] - before[1] + 5.0, "a red tent: {before:?}, then {red:?}");
    open_panel(tab, "lights");
    tab.wait_for("trex.app.panels.handles.last.length > 0");
    let [x, y] = ["x", "y"].map(|axis| tab.number(&format!("trex.app.panels.handles.last[0].{axis}")));
    let place = tab.value("trex.app.state.lights[0].position");
    act(tab, |tab| tab.drag([x, y], [x + 60.0, y + 20.0], 6));
    assert_ne!(tab.value("trex.app.state.lights[0].position"), place, "a handle moves its lamp");
    let count = tab.number("trex.app.state.lights.length");
    let sky =
        "[...document.querySelectorAll('#panel-body button')].find((b) => b.textContent === '+ Sky').click()";
    act(tab, |tab| drop(tab.value(sky)));
    assert_eq!(tab.number("trex.app.state.lights.length"), count + 1.0);
    let bright = means(tab);
    assert!(bright[1] > red[1] + 3.0, "with one sky more: {red:?}, then {bright:?}");
    open_panel(tab, "settings");
    act(tab, |tab| fill(tab, "Samples a pixel", "6", "change"));
    tab.wait_for("trex.app.state.stats.samples === 6");
    open_panel(tab, "statistics");
    tab.wait_for("document.getElementById('panel-body').innerText.includes('MiB')");
    // A page that is alone need not be told who drives.
    assert_eq!(tab.value("document.getElementById('role').innerText"), "");
}

fn a_lost_connection_comes_back(tab: &mut Tab) {
    let shown = tab.number(HASH);
    let connections = tab.number("trex.counts.connections");
    tab.value("trex.app.connection.drop()");
    tab.wait_for(&format!("trex.counts.connections > {connections} && trex.link === 'driving'"));
    tab.listen(Duration::from_millis(300));
    settle(tab);
    assert_eq!(tab.number(HASH), shown, "the picture is as it was");
}

fn a_reload_comes_back(tab: &mut Tab) {
    let shown = tab.number(HASH);
    tab.value("window.is_old = true");
    tab.call("Page.reload", serde_json::json!({}));
    tab.wait_for("!window.is_old && trex.link === 'driving' && trex.drawn > 0");
    tab.value(READ_PICTURE);
    settle(tab);
    assert_eq!(tab.number(HASH), shown, "the picture is as it was");
}

/// A second page sees the same picture, and drives once the first has let go for long enough.
fn another_page_takes_the_wheel(first: &mut Tab, command: &Path, address: &str) {
    settle(first);
    let mut second = Tab::open(command, SIZE);
    second.go(address);
    second.wait_for("trex.link === 'watching' && trex.drawn > 0");
    second.value(READ_PICTURE);
    let shown = first.number(HASH);
    second.wait_for(&format!("{HASH} === {shown}"));
    let view = second.value("trex.app.camera");
    second.drag(MIDDLE, [560.0, 200.0], 3);
    assert_eq!(second.value("trex.app.camera"), view, "who watches moves nothing");
    second.listen(HANDS_OFF);
    second.value("document.getElementById('drive').click()");
    second.wait_for("trex.link === 'driving'");
    first.wait_for("trex.link === 'watching'");
    act(&mut second, |second| second.drag(MIDDLE, [560.0, 200.0], 5));
    let shown = second.number(HASH);
    first.wait_for(&format!("{HASH} === {shown}"));
    assert_eq!(second.take_complaints(), Vec::<String>::new());
    drop(second);
    // A page that is alone drives.
    first.wait_for("trex.link === 'driving'");
}

/// Once all has come, nothing is sent.
fn a_settled_page_is_quiet(tab: &mut Tab) {
    let begin = Instant::now();
    let mut before = -1.0;
    while begin.elapsed() < PATIENCE {
        let received = tab.number("trex.counts.received_bytes");
        if received == before {
            return assert_eq!(tab.value("trex.last.is_done && trex.last.kind === 2"), true);
        }
        before = received;
        tab.listen(Duration::from_secs(3));
    }
    panic!("bytes still come {} s after the last event", PATIENCE.as_secs());
}
