//! The page: its files, embedded. What is not in this table is not there.

/// A file of the page.
pub(crate) struct PageFile {
    path: &'static str,
    pub(crate) media_type: &'static str,
    pub(crate) bytes: &'static [u8],
}

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
    "/picture.js", "picture.js", SCRIPT;
    "/plot.js", "plot.js", SCRIPT;
    "/settings.js", "settings.js", SCRIPT;
    "/statistics.js", "statistics.js", SCRIPT;
    "/status.js", "status.js", SCRIPT;
    "/vector.js", "vector.js", SCRIPT;
    "/views.js", "views.js", SCRIPT;
    "/widgets.js", "widgets.js", SCRIPT;
};

/// The file at `path`, if there is one.
pub(crate) fn find(path: &str) -> Option<&'static PageFile> {
    FILES.iter().find(|file| file.path == path)
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
}
