//! A file whose pages are damaged: what pages of the browser are told.

use crate::client::Page;
use crate::stage::{Play, PlayModel, SIZE, Server};
use std::collections::BTreeSet;

/// A file of which every page had a flipped bit was shown as finished: "done", all light there, not a word of what was
/// missing. Pages are told how many, which and where, and the picture is never called done.
#[test]
fn a_damaged_file_is_never_called_done() {
    let server = Server::start(Play { shown: PlayModel::DamagedWave, ..Play::default() });
    let mut page = Page::new(&server, SIZE);
    // It is said anew, since a page may have come from a file that was damaged.
    assert_eq!(page.welcome["damage"]["page_count"], 0, "no page was asked for yet");
    let damage = loop {
        let state = page.text("state");
        if !state["damage"].is_null() {
            break state["damage"].clone();
        }
    };
    let pages = damage["pages"].as_array().unwrap();
    assert!(!pages.is_empty() && damage["page_count"].as_u64().unwrap() >= pages.len() as u64, "{damage}");
    // The model is a wave over the square from 0 to 1, less than 0.11 high; boxes are a little larger than triangles.
    for page in pages {
        assert_eq!(page["drawn"], "as empty", "{page}");
        // The error would tell where the file is.
        let keys: BTreeSet<&str> = page.as_object().unwrap().keys().map(String::as_str).collect();
        assert_eq!(keys, ["bounds", "drawn", "page"].into());
        for (axis, (least, most)) in [(-0.1, 1.1), (-0.2, 0.2), (-0.1, 1.1)].into_iter().enumerate() {
            let [lo, hi] = ["lo", "hi"].map(|end| page["bounds"][end][axis].as_f64().unwrap());
            assert!(least < lo && lo < hi && hi < most, "axis {axis}: {page}");
        }
    }
    // The picture may have come before the list: what is waited for is the last of the two.
    let last = loop {
        let stats = page.text("stats");
        if ["done", "damaged"].contains(&stats["progress"].as_str().unwrap()) {
            break stats;
        }
    };
    assert_eq!(last["progress"], "damaged", "{last}");
    // Who comes late knows, too.
    let late = Page::new(&server, SIZE);
    assert!(late.welcome["damage"]["page_count"].as_u64().unwrap() >= pages.len() as u64);
}
