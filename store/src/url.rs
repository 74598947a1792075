//! Addresses of the web, which stand where paths do.

use std::path::Path;

/// True for a path that is an address of the web: `http://..`, `https://..` or `s3://..`.
pub fn is_url(path: &Path) -> bool {
    ["http://", "https://"].into_iter().any(|scheme| begins_with(path, scheme)) || is_s3(path)
}

/// True for an address of an object in S3: `s3://..`.
pub(crate) fn is_s3(path: &Path) -> bool {
    begins_with(path, "s3://")
}

/// True where a path begins with `scheme`, which is the same in capitals.
fn begins_with(path: &Path, scheme: &str) -> bool {
    let head = path.as_os_str().as_encoded_bytes().get(..scheme.len());
    head.is_some_and(|head| head.eq_ignore_ascii_case(scheme.as_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_told_from_paths() {
        for (path, is_address) in [
            ("http://host/x.trex", true),
            ("HTTPS://host/x.trex", true),
            ("https:/host", false),
            ("http:", false),
            ("models/http://x", false),
            ("s3://bucket/x", true),
            ("s3:bucket/x", false),
        ] {
            assert_eq!(is_url(Path::new(path)), is_address, "{path}");
        }
    }
}
