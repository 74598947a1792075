//! Addresses of the web, which stand where paths do.

use std::path::Path;

/// True for a path that is an address of the web: `http://..` or `https://..`.
pub fn is_url(path: &Path) -> bool {
    let starts = |scheme: &str| {
        path.as_os_str().as_encoded_bytes().get(..scheme.len()).is_some_and(|head| {
            // Schemes are the same in capitals.
            head.eq_ignore_ascii_case(scheme.as_bytes())
        })
    };
    starts("http://") || starts("https://")
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
            ("s3://bucket/x", false),
        ] {
            assert_eq!(is_url(Path::new(path)), is_address, "{path}");
        }
    }
}
