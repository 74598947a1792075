//! Pictures that a page saves: PNG and EXR.

use super::devtools::{PATIENCE, Tab};
use super::{SIZE, open_panel};
use std::path::Path;
use std::time::{Duration, Instant};

/// A picture saved by the page holds the bytes that the command writes.
pub(super) fn a_picture_is_saved(tab: &mut Tab, inside: &Path) {
    tab.value("window.saved = null; trex.app.listen('saved', (file) => { window.saved = file; })");
    open_panel(tab, "export");
    let samples = tab.number("trex.app.state.settings.spp");
    // The command wrote a PNG of this view before; the same as EXR.
    let line = format!("render view.toml -o last.exr --spp {samples} --overwrite -q");
    crate::command::run_in(inside, &line).expect(0);
    for format in ["png", "exr"] {
        tab.value("window.saved = null");
        tab.value(&format!("trex.app.panels.export.take('{format}', trex.app.state.size, {samples})"));
        tab.wait_for(&format!("window.saved && window.saved.format === '{format}'"));
        wait_for_download(tab, &inside.join(format!("last.{format}")));
    }
    let picture = exr::prelude::read_all_flat_layers_from_file(inside.join("last.exr")).unwrap();
    let exr::math::Vec2(width, height) = picture.attributes.display_window.size;
    assert_eq!([width, height], SIZE.map(|side| side as usize));
}

/// Waits for a file that was saved by the page and holds what is in `expected`.
fn wait_for_download(tab: &mut Tab, expected: &Path) {
    let (begin, bytes) = (Instant::now(), std::fs::read(expected).unwrap());
    while begin.elapsed() < PATIENCE {
        let files = std::fs::read_dir(tab.downloads()).unwrap().map(|entry| entry.unwrap().path());
        let mut found = files.filter(|path| path.extension() == expected.extension());
        if found.any(|path| std::fs::read(path).is_ok_and(|found| found == bytes)) {
            return;
        }
        tab.listen(Duration::from_millis(100));
    }
    panic!("no file with the bytes of {} in {}", expected.display(), tab.downloads().display());
}
