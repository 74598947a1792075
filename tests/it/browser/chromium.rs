//! A headless Chromium of the test's own: started in a process group and a profile of its own, and gone with its owner.
//!
//! Invariants: 1. the whole group is killed when the owner is dropped, also by a panic; 2. nothing of a person's own
//! profile is read or written.

use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Names of the command, Debian's first.
const NAMES: [&str; 3] = ["chromium", "chromium-browser", "google-chrome"];
/// The file that says where DevTools listens.
const PORT_FILE: &str = "DevToolsActivePort";
/// A start on a machine that does much else.
const START: Duration = Duration::from_secs(60);

/// A running browser.
pub(crate) struct Chromium {
    child: Child,
    profile: tempfile::TempDir,
}

/// The browser of this machine, if it has one.
pub(crate) fn installed() -> Option<PathBuf> {
    let folders: Vec<PathBuf> = std::env::split_paths(&std::env::var_os("PATH")?).collect();
    let places = NAMES.iter().flat_map(|name| folders.iter().map(move |folder| folder.join(name)));
    places.into_iter().find(|place| place.is_file())
}

impl Chromium {
    /// Starts the browser at `command`, without a page.
    pub(crate) fn start(command: &Path) -> Chromium {
        let profile = crate::command::folder();
        let mut chromium = Command::new(command);
        chromium
            .args(["--headless=new", "--remote-debugging-port=0", "--no-first-run", "--disable-gpu"])
            .args(["--disable-extensions", "--disable-background-networking", "--disable-breakpad"])
            .args(["--disable-dev-shm-usage", "--mute-audio", "--window-size=1280,720"])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .args(is_root().then_some("--no-sandbox"))
            .arg("about:blank")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .process_group(0);
        let child = chromium.spawn().unwrap_or_else(|error| panic!("{}: {error}", command.display()));
        Chromium { child, profile }
    }

    /// Where DevTools listens: port, and path of the browser's own socket.
    pub(crate) fn devtools(&mut self) -> (u16, String) {
        let begin = Instant::now();
        let place = self.profile.path().join(PORT_FILE);
        while begin.elapsed() < START {
            let text = std::fs::read_to_string(&place).unwrap_or_default();
            if let Some((port, path)) = text.split_once('\n').filter(|(_, path)| path.starts_with('/')) {
                return (port.parse().unwrap(), path.trim().to_owned());
            }
            if let Some(status) = self.child.try_wait().unwrap() {
                panic!("chromium ended before it listened: {status}");
            }
            std::thread::sleep(Duration::from_millis(50));
        }
        panic!("chromium wrote no {PORT_FILE} within {} s", START.as_secs());
    }

    /// A folder that goes with the browser.
    pub(crate) fn folder(&self) -> &Path {
        self.profile.path()
    }
}

impl Drop for Chromium {
    fn drop(&mut self) {
        // The child leads its group: the group's number is the child's.
        let group = format!("-{}", self.child.id());
        let _ = Command::new("kill").args(["-KILL", "--", &group]).stderr(Stdio::null()).status();
        let _ = self.child.wait();
    }
}

/// Chromium's sandbox does not run for root.
fn is_root() -> bool {
    std::fs::read_to_string("/proc/self/status")
        .unwrap_or_default()
        .lines()
        .find_map(|line| line.strip_prefix("Uid:"))
        .is_some_and(|ids| ids.split_whitespace().nth(1) == Some("0"))
}
