//! The page: its files, embedded, and the numbers of the protocol as a module. What is not in this table is not there.

use crate::wire;
use std::borrow::Cow;

/// A file of the page.
struct PageFile {
    path: &'static str,
    media_type: &'static str,
    bytes: &'static [u8],
}

/// The answer to a path that is there.
pub(crate) struct PageAnswer {
    pub(crate) media_type: &'static str,
    pub(crate) bytes: Cow<'static, [u8]>,
}

/// Where the numbers of the protocol are.
const WIRE_PATH: &str = "/wire.js";

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";
const PICTURE: &str = "image/svg+xml";

macro_rules! page {
    ($($path:literal, $file:literal, $media_type:expr;)*) => {
        [$(PageFile { path: $path, media_type: $media_type, bytes: include_bytes!(concat!("../page/", $file)) }),*]
    };
}

const FILES: &[PageFile] = &page! {
    "/", "index.html", HTML;
    "/index.html", "index.html", HTML;
    "/style.css", "style.css", STYLE;
    "/icon.svg", "icon.svg", PICTURE;
    "/app.js", "app.js", SCRIPT;
    "/camera.js", "camera.js", SCRIPT;
    "/connection.js", "connection.js", SCRIPT;
    "/export.js", "export.js", SCRIPT;
    "/handles.js", "handles.js", SCRIPT;
    "/help.js", "help.js", SCRIPT;
    "/input.js", "input.js", SCRIPT;
    "/keys.js", "keys.js", SCRIPT;
    "/lights.js", "lights.js", SCRIPT;
    "/materials.js", "materials.js", SCRIPT;
    "/measure.js", "measure.js", SCRIPT;
    "/notices.js", "notices.js", SCRIPT;
    "/panels.js", "panels.js", SCRIPT;
    "/parts.js", "parts.js", SCRIPT;
    "/picture.js", "picture.js", SCRIPT;
    "/plot.js", "plot.js", SCRIPT;
    "/section_handles.js", "section_handles.js", SCRIPT;
    "/settings.js", "settings.js", SCRIPT;
    "/stage.js", "stage.js", SCRIPT;
    "/statistics.js", "statistics.js", SCRIPT;
    "/status.js", "status.js", SCRIPT;
    "/vector.js", "vector.js", SCRIPT;
    "/views.js", "views.js", SCRIPT;
    "/widgets.js", "widgets.js", SCRIPT;
    "/wishes.js", "wishes.js", SCRIPT;
};

/// What is at `path`, if there is something.
pub(crate) fn find(path: &str) -> Option<PageAnswer> {
    if path == WIRE_PATH {
        return Some(PageAnswer { media_type: SCRIPT, bytes: wire::module().into_bytes().into() });
    }
    let file = FILES.iter().find(|file| file.path == path)?;
    Some(PageAnswer { media_type: file.media_type, bytes: file.bytes.into() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;
    use std::path::Path;

    #[test]
    fn every_file_of_the_folder_is_in_the_table() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("page");
        let names = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
        let there: BTreeSet<String> = names.map(|name| format!("/{}", name.into_string().unwrap())).collect();
        let listed = FILES.iter().map(|file| file.path.to_owned()).filter(|path| path != "/").collect();
        assert_eq!(there, listed);
    }

    #[test]
    fn nothing_else_is_found() {
        for path in
            ["", "/..", "/../Cargo.toml", "/page/app.js", "//app.js", "/app.js/", "/APP.JS", "/%61pp.js"]
        {
            assert!(find(path).is_none(), "{path}");
        }
    }

    /// Kinds, lengths and limits stood in both languages, alike by care alone.
    #[test]
    fn numbers_of_the_protocol_stand_in_the_server_alone() {
        let module = String::from_utf8(find("/wire.js").unwrap().bytes.into_owned()).unwrap();
        let lines = module.lines().filter_map(|line| line.strip_prefix("export const "));
        let names: BTreeSet<&str> = lines.map(|line| line.split(' ').next().unwrap()).collect();
        let mut imported = BTreeSet::new();
        for file in FILES.iter().filter(|file| file.media_type == SCRIPT) {
            let text = std::str::from_utf8(file.bytes).unwrap();
            for name in &names {
                let defines = format!("const {name} =");
                assert!(!text.contains(&defines), "{} defines {name} itself", file.path);
            }
            for import in text.split("import {").skip(1) {
                let (list, rest) = import.split_once("} from \"").unwrap();
                if rest.starts_with("./wire.js\"") {
                    imported.extend(list.split(',').map(str::trim).filter(|name| !name.is_empty()));
                }
            }
        }
        assert!(imported.is_subset(&names), "{imported:?} of {names:?}");
        assert!(imported.len() >= 10, "{imported:?}");
    }
}
