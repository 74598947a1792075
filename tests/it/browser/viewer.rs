//! `trex view` as a process: started, its address read, told to end.

use crate::command::trex_in;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::time::{Duration, Instant};

/// From the command to its address, on a machine that does much else.
const START: Duration = Duration::from_secs(60);
/// From the signal to the end.
const END: Duration = Duration::from_secs(30);

/// A running viewer; killed when dropped.
pub(crate) struct Viewer {
    child: Child,
    said: PathBuf,
    /// The address that it printed, with the token.
    pub(crate) address: String,
}

impl Viewer {
    /// Runs `trex view LINE --no-open` in `folder` and waits for its address.
    pub(crate) fn start(folder: &Path, line: &str) -> Viewer {
        let said = folder.join("viewer.txt");
        let output = File::create(&said).unwrap();
        let mut command = trex_in(folder, &format!("view {line} --no-open"));
        let child = command.stdout(output.try_clone().unwrap()).stderr(output).spawn().unwrap();
        let mut viewer = Viewer { child, said, address: String::new() };
        let begin = Instant::now();
        while begin.elapsed() < START {
            let text = viewer.said();
            // A whole word: what follows it has been written, too.
            let rest = text.find("http://").map(|at| &text[at..]);
            if let Some(end) = rest.and_then(|rest| rest.find(char::is_whitespace)) {
                viewer.address = rest.unwrap()[..end].to_owned();
                return viewer;
            }
            let status = viewer.child.try_wait().unwrap();
            assert!(status.is_none(), "trex view {line} ended: {status:?}\n{text}");
            std::thread::sleep(Duration::from_millis(20));
        }
        panic!("trex view {line} told no address:\n{}", viewer.said());
    }

    /// All that it has said.
    pub(crate) fn said(&self) -> String {
        std::fs::read_to_string(&self.said).unwrap()
    }

    /// Interrupts it, and gives its exit status.
    pub(crate) fn end(mut self) -> Option<i32> {
        Command::new("kill").args(["-INT", &self.child.id().to_string()]).status().unwrap();
        let begin = Instant::now();
        while begin.elapsed() < END {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.code();
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        panic!("trex view did not end:\n{}", self.said());
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
