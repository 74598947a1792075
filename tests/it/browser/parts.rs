//! Sections and hidden materials at the page: each changes the picture as it should, and the command that is copied
//! makes them.

use super::{MIDDLE, act, open_panel, settle};
use crate::browser::devtools::Tab;

/// Colours of a pixel of the picture, 0 to 255, at a place of the window.
fn colour(tab: &mut Tab, [x, y]: [f64; 2]) -> [f64; 3] {
    let pixels = format!(
        "read_picture().slice(3 * ({y} * trex.last.width + {x}), 3 * ({y} * trex.last.width + {x}) + 3)"
    );
    let value = tab.value(&format!("[...{pixels}]"));
    [0, 1, 2].map(|channel| value[channel].as_f64().unwrap())
}

/// Presses the button of the open panel with this text or label.
fn press(tab: &mut Tab, text: &str) {
    let button = format!(
        "[...document.querySelectorAll('#panel-body button')]
            .find((button) => [button.textContent, button.getAttribute('aria-label')].includes('{text}')).click()"
    );
    tab.value(&button);
}

fn materials_hide(tab: &mut Tab) {
    settle(tab);
    let whole = colour(tab, MIDDLE);
    open_panel(tab, "materials");
    tab.wait_for("document.querySelector('[aria-label=\"Hide tent\"]')");
    act(tab, |tab| press(tab, "Hide tent"));
    tab.wait_for("trex.app.state.parts.hidden_count === 1");
    assert_ne!(colour(tab, MIDDLE), whole, "the tent is gone");
    act(tab, |tab| press(tab, "Show tent"));
    assert_eq!(colour(tab, MIDDLE), whole);
    // With the tool in hand a click hides what it hits.
    press(tab, "Hide by a click");
    act(tab, |tab| tab.click(MIDDLE, 0));
    tab.wait_for("trex.app.panels.parts.hidden.size === 1");
    assert_ne!(colour(tab, MIDDLE), whole);
    tab.key("Escape", "Escape", std::time::Duration::ZERO);
    act(tab, |tab| press(tab, "Show all"));
    assert_eq!(colour(tab, MIDDLE), whole);
}

fn sections_cut(tab: &mut Tab) {
    let whole = colour(tab, MIDDLE);
    open_panel(tab, "parts");
    act(tab, |tab| press(tab, "+ Section"));
    let plane = |tab: &mut Tab| -> Vec<f64> {
        let value = tab.value("trex.app.state.parts.section[0]");
        value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
    };
    // The view looks down the -z axis at the side of the tent, so what is nearer goes.
    let first = plane(tab);
    assert_eq!(first[3..], [0.0, 0.0, -1.0], "{first:?}");
    assert!((0.0..0.7).contains(&first[2]), "through what the middle sees: {first:?}");
    let put_back = |tab: &mut Tab| super::fill(tab, "Section 1, offset", "-1.5", "change");
    act(tab, put_back);
    assert_eq!(plane(tab)[2], -1.5);
    assert_ne!(colour(tab, MIDDLE), whole, "the tent is cut away");
    // Its handle stands before the middle; the view sees its normal end on, so a hand that goes down brings it nearer.
    let handle =
        ["x", "y"].map(|axis| tab.number(&format!("trex.app.panels.section_handles.last[0].{axis}")));
    act(tab, |tab| tab.drag(handle, [handle[0], handle[1] + 20.0], 4));
    assert!(plane(tab)[2] > -1.5, "a handle moves its plane");
    act(tab, put_back);
    act(tab, |tab| press(tab, "Flip Section 1"));
    assert_eq!(plane(tab)[2..], [-1.5, 0.0, 0.0, 1.0]);
    // What is cut away now lies behind the tent, and no longer sends light there.
    tab.value("trex.app.panels.measure.hit = null");
    tab.click(MIDDLE, 2);
    tab.wait_for("trex.app.panels.measure.hit?.name === 'tent'");
    tab.value("trex.app.panels.open('parts')");
}

/// Leaves a section and a hidden material, which the copied command has to have.
pub(super) fn parts_change_the_picture(tab: &mut Tab) {
    materials_hide(tab);
    sections_cut(tab);
    super::fill(tab, "Section 1, offset", "0.123", "change");
    tab.wait_for("trex.app.state.parts.section[0]?.[2] === 0.123");
    open_panel(tab, "materials");
    act(tab, |tab| press(tab, "Hide floor"));
    tab.wait_for("trex.app.state.scene?.includes('hide = [\"floor\"')");
    let scene = tab.value("trex.app.state.scene");
    let scene = scene.as_str().unwrap();
    assert!(scene.contains("hide = [\"floor\", ]") && scene.contains("0.123, 0.0, 0.0, 1.0"), "{scene}");
}
