//! The result on stdout: text for people, or one JSON document with `--json`. Nothing else writes to stdout.
//!
//! Invariants: 1. with `--json` stdout holds exactly one document, also after a failure: the first that is said; 2. a
//! reader that hangs up (`trex info x | head -1`) ends the output, not the program, and is no error; 3. all notes go to
//! stderr; 4. names from files reach a terminal with what it would obey told by number.

use serde::Serialize;
use std::fmt::Display;
use std::io::{self, BufWriter, ErrorKind, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use trex_store::printable::{is_obeyed, lines};

/// Where results go, and in which form.
#[derive(Clone, Debug)]
pub struct Output {
    json: bool,
    command: String,
    /// Something was printed: a second document would be one too many.
    said: Arc<AtomicBool>,
}

/// The envelope of every document: what it is, what made it, then the verb's own keys.
#[derive(Serialize)]
struct Document<'a, T> {
    schema: String,
    command: &'a str,
    version: &'static str,
    #[serde(flatten)]
    body: &'a T,
}

impl Output {
    /// `command` is the command line as typed, for the document.
    pub fn new(json: bool, command: String) -> Output {
        Output { json, command, said: Arc::default() }
    }

    /// Prints the result of `verb`, unless something was said before: its `Display` text, or the document
    /// `trex.<verb>/1` of its fields.
    ///
    /// # Errors
    /// Stdout cannot be written (a full disk behind `>`); a closed pipe is no error.
    pub fn result<T: Serialize + Display>(&self, verb: &str, result: &T) -> io::Result<()> {
        if self.said.swap(true, Ordering::SeqCst) {
            return Ok(());
        }
        quietly(self.write(verb, result, &mut io::stdout().lock()))
    }

    /// The document of an error, if documents are asked for.
    pub fn error_document<T: Serialize>(&self, body: &T) {
        if self.json && !self.said.swap(true, Ordering::SeqCst) {
            // The error itself is already on stderr: a failure here has nobody left to tell.
            let _ = quietly(self.write_document("error", body, &mut io::stdout().lock()));
        }
    }

    fn write<T: Serialize + Display>(&self, verb: &str, result: &T, to: &mut impl Write) -> io::Result<()> {
        if self.json {
            return self.write_document(verb, result, to);
        }
        let mut text = lines(&result.to_string()).into_owned();
        if !text.is_empty() && !text.ends_with('\n') {
            text.push('\n');
        }
        to.write_all(text.as_bytes())?;
        to.flush()
    }

    /// Writes a document piece by piece: it may list more names than there is memory for their text.
    fn write_document<T: Serialize>(&self, name: &str, body: &T, to: &mut impl Write) -> io::Result<()> {
        let document = Document {
            schema: format!("trex.{name}/1"),
            command: &self.command,
            version: env!("CARGO_PKG_VERSION"),
            body,
        };
        let mut escaped = EscapingWriter(BufWriter::new(to));
        serde_json::to_writer_pretty(&mut escaped, &document)?;
        escaped.write_all(b"\n")?;
        escaped.flush()
    }
}

/// A document in which what terminals obey stands by its number, as JSON has it: outside of strings there is none.
struct EscapingWriter<W>(W);

impl<W: Write> Write for EscapingWriter<W> {
    /// Takes all of `text`, which is a piece of a document between two characters.
    fn write(&mut self, text: &[u8]) -> io::Result<usize> {
        let is_bad = |c: char| is_obeyed(c) && c != '\n';
        let mut rest = std::str::from_utf8(text).map_err(io::Error::other)?;
        while let Some(at) = rest.find(is_bad) {
            let (fine, from_bad) = rest.split_at(at);
            let mut after = from_bad.chars();
            let bad = after.next().expect("one was found");
            write!(self.0, "{fine}\\u{:04x}", u32::from(bad))?;
            rest = after.as_str();
        }
        self.0.write_all(rest.as_bytes())?;
        Ok(text.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

/// A closed pipe counts as written.
fn quietly(written: io::Result<()>) -> io::Result<()> {
    match written {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        other => other,
    }
}

/// The command line for documents: `trex` and the arguments, quoted where a shell would need it.
pub fn command_line(arguments: impl Iterator<Item = std::ffi::OsString>) -> String {
    let mut line = String::from("trex");
    for argument in arguments.skip(1) {
        let text = argument.to_string_lossy();
        line.push(' ');
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_./:,=%+".contains(c);
        if !text.is_empty() && text.chars().all(plain) {
            line.push_str(&text);
        } else {
            line.push_str(&format!("'{}'", text.replace('\'', "'\\''")));
        }
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize)]
    struct TriangleCount {
        triangle_count: u64,
    }

    impl Display for TriangleCount {
        fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            write!(f, "{} triangles", self.triangle_count)
        }
    }

    /// Fails like stdout does once the reader has gone, or the disk is full.
    struct Broken(ErrorKind);

    impl Write for Broken {
        fn write(&mut self, _: &[u8]) -> io::Result<usize> {
            Err(self.0.into())
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn text_of(output: &Output, result: &TriangleCount) -> String {
        let mut bytes = Vec::new();
        output.write("info", result, &mut bytes).unwrap();
        String::from_utf8(bytes).unwrap()
    }

    #[test]
    fn text_is_one_line_and_json_one_document() {
        let result = TriangleCount { triangle_count: 7 };
        assert_eq!(text_of(&Output::new(false, String::new()), &result), "7 triangles\n");
        let text = text_of(&Output::new(true, "trex info x".into()), &result);
        let document: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(document["schema"], "trex.info/1");
        assert_eq!(document["command"], "trex info x");
        assert_eq!(document["triangle_count"], 7);
    }

    #[test]
    fn documents_keep_names_and_hide_them_from_terminals() {
        let name = "a\u{1b}[2J\u{9b}\u{202e}\u{feff}\n\"";
        let text = text_of(&Output::new(true, name.into()), &TriangleCount { triangle_count: 7 });
        assert!(text.chars().all(|c| c == '\n' || c == '"' || !is_obeyed(c)), "{text:?}");
        let document: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(document["command"], name);
    }

    #[test]
    fn a_closed_pipe_is_no_error_and_a_full_disk_is() {
        for is_json in [false, true] {
            let output = Output::new(is_json, String::new());
            let written =
                |kind| output.write("info", &TriangleCount { triangle_count: 7 }, &mut Broken(kind));
            assert!(quietly(written(ErrorKind::BrokenPipe)).is_ok());
            assert!(quietly(written(ErrorKind::StorageFull)).is_err());
        }
    }

    #[test]
    fn command_lines_can_be_pasted() {
        let line = ["/usr/bin/trex", "info", "my model.ply", "it's", "--memory-limit", "50%", ""];
        assert_eq!(
            command_line(line.iter().map(Into::into)),
            r"trex info 'my model.ply' 'it'\''s' --memory-limit 50% ''"
        );
    }
}
