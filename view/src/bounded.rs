//! `BoundedWriter`: bytes in memory that an encoder writes, up to a bound, until it is told to stop.
//!
//! Invariants: 1. no more is allocated than the bound; 2. once `stop` says so nothing is written: the encoder's work
//! ends with an error at its next bytes.

use std::io::{self, Seek, SeekFrom, Write};

/// See the module's description.
pub(crate) struct BoundedWriter<'a> {
    bytes: &'a mut Vec<u8>,
    /// Where the next bytes go.
    at: usize,
    most: usize,
    stop: &'a dyn Fn() -> bool,
}

impl<'a> BoundedWriter<'a> {
    /// Writes behind what `bytes` hold, until these are `most`.
    pub(crate) fn new(bytes: &'a mut Vec<u8>, most: usize, stop: &'a dyn Fn() -> bool) -> BoundedWriter<'a> {
        let at = bytes.len();
        BoundedWriter { bytes, at, most, stop }
    }
}

impl Write for BoundedWriter<'_> {
    fn write(&mut self, more: &[u8]) -> io::Result<usize> {
        if (self.stop)() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        let end = self.at.saturating_add(more.len());
        if end > self.most {
            return Err(io::ErrorKind::StorageFull.into());
        }
        // Doubling would take up to twice the bound.
        if end > self.bytes.capacity() {
            let room = (2 * self.bytes.capacity()).clamp(end, self.most);
            self.bytes.reserve_exact(room - self.bytes.len());
        }
        if self.at == self.bytes.len() {
            self.bytes.extend_from_slice(more);
        } else {
            self.bytes.resize(end.max(self.bytes.len()), 0);
            self.bytes[self.at..end].copy_from_slice(more);
        }
        self.at = end;
        Ok(more.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for BoundedWriter<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let (from, by) = match to {
            SeekFrom::Start(at) => (0, at as i128),
            SeekFrom::Current(by) => (self.at, by.into()),
            SeekFrom::End(by) => (self.bytes.len(), by.into()),
        };
        let at = usize::try_from(from as i128 + by).map_err(|_| io::ErrorKind::InvalidInput)?;
        self.at = at;
        Ok(at as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    /// As a cursor does, which has no bound.
    #[test]
    fn writes_and_seeks_go_where_those_of_a_cursor_go() {
        let (mut ours, mut theirs) = (vec![], Cursor::new(vec![]));
        let mut bounded = BoundedWriter::new(&mut ours, 60, &|| false);
        for (to, text) in [
            (SeekFrom::Start(0), "magic and table"),
            (SeekFrom::Start(20), "behind a gap"),
            (SeekFrom::Current(-5), "over what is there"),
            (SeekFrom::End(-4), "end"),
            (SeekFrom::Start(6), "AND"),
        ] {
            assert_eq!(bounded.seek(to).unwrap(), theirs.seek(to).unwrap());
            bounded.write_all(text.as_bytes()).unwrap();
            theirs.write_all(text.as_bytes()).unwrap();
        }
        assert!(bounded.seek(SeekFrom::Current(-50)).is_err());
        bounded.seek(SeekFrom::Start(59)).unwrap();
        assert_eq!(bounded.write(b"xy").unwrap_err().kind(), io::ErrorKind::StorageFull);
        assert_eq!(ours, theirs.into_inner());
        assert!(ours.capacity() <= 60);
    }

    #[test]
    fn nothing_is_written_once_it_is_to_stop() {
        let mut bytes = b"head".to_vec();
        let mut bounded = BoundedWriter::new(&mut bytes, 100, &|| true);
        assert!(bounded.write_all(b"more").is_err());
        assert_eq!(bytes, b"head");
    }
}
