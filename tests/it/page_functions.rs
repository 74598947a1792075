//! Functions of the viewer's page, without a browser: node runs the tests of `view/tests/page/`.

use crate::command::{cannot_run, cannot_run_without, said};
use crate::tidy::{files, root};
use std::process::Command;

const NODE: &str = "node";
/// The first version, major and minor, whose loader takes hooks from a test.
const NODE_VERSION: [u32; 2] = [20, 6];

/// Major and minor version of the node of this machine, if it has one.
fn node_version() -> Option<[u32; 2]> {
    let output = Command::new(NODE).arg("--version").output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    let mut numbers = text.trim().strip_prefix('v')?.split('.').map(|number| number.parse().ok());
    Some([numbers.next()??, numbers.next()??])
}

#[test]
fn functions_of_the_page_pass_their_tests() {
    let Some(version) = node_version() else {
        return cannot_run_without(NODE);
    };
    if version < NODE_VERSION {
        let [found, needed] = [version, NODE_VERSION].map(|[major, minor]| format!("{major}.{minor}"));
        return cannot_run(&format!("node {found} is older than {needed}"));
    }
    let is_test = |path: &str| path.starts_with("view/tests/page/") && path.ends_with(".test.js");
    let scripts = files("js").into_iter().map(|source| source.path).filter(|path| is_test(path));
    let scripts: Vec<String> = scripts.collect();
    assert!(!scripts.is_empty(), "no tests of the page: they have moved");
    let mut node = Command::new(NODE);
    node.args(["--test", "--test-reporter=tap"]).args(&scripts).current_dir(root());
    // Options of whoever runs the tests are not meant for these.
    let output = node.env_remove("NODE_OPTIONS").output().unwrap();
    let [told, complained] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes));
    assert!(output.status.success(), "{node:?}: {}\n{told}\n{complained}", output.status);
    // A file whose tests are not found counts as one test that passes.
    let count = told.lines().find_map(|line| line.strip_prefix("# pass ")?.parse().ok());
    assert!(count > Some(scripts.len()), "{count:?} tests in {} files:\n{told}", scripts.len());
    said(&format!("tests of the page: {}", count.unwrap_or_default()));
}
