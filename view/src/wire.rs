//! The numbers of the protocol that the server and its page both need, each written once: the page imports them as
//! `/wire.js`, which is made of this table.
//!
//! ```text
//! binary message = kind, then
//!   blocks, whole: flags u8, scale u16, frame u32, seq u32, width u16, height u16, columns u16, count u16, indices u16
//!     blocks: a JPEG of blocks side by side     whole: begin u32, length of all u32, a part of a PNG
//!   file: format u8, two bytes of 0, number u32, the file
//! ```
//! All numbers are little-endian.
//!
//! Invariant: what the page calls a constant has the value that it has here: `page.rs` tests that no file of the page
//! defines one of these names, and that each that is imported is here.

/// Defines the constants, and the module that gives them to the page.
macro_rules! wire {
    ($($(#[doc = $doc:literal])* $name:ident: $type:ty = $value:expr;)*) => {
        $($(#[doc = $doc])* pub(crate) const $name: $type = $value;)*

        /// The constants as a module of JavaScript.
        pub(crate) fn module() -> String {
            let mut text = String::from("// Numbers of the protocol, as the server has them.\n");
            $(text.push_str(&format!("export const {} = {};\n", stringify!($name), $name));)*
            text
        }
    };
}

wire! {
    /// Kinds of binary messages: marked blocks of a picture.
    KIND_BLOCKS: u8 = 1;
    /// A part of a settled picture.
    KIND_WHOLE: u8 = 2;
    /// A file.
    KIND_FILE: u8 = 3;
    /// Bytes in front of the indices of blocks.
    FRAME_HEAD_BYTES: usize = 20;
    /// Bytes after that in front of a part of a settled picture: where it begins, and how long that is.
    PART_HEAD_BYTES: usize = 8;
    /// Bytes in front of a file.
    FILE_HEAD_BYTES: usize = 8;
    /// Formats of files.
    FILE_PNG: u8 = 0;
    /// Linear light.
    FILE_EXR: u8 = 1;
    /// A scene's text.
    FILE_SCENE: u8 = 2;
    /// Flags of a frame: some of it is a preview.
    FLAG_PREVIEW: u8 = 1;
    /// It is one of many that follow each other fast.
    FLAG_MOVING: u8 = 2;
    /// Every pixel has a sample of the present state.
    FLAG_COMPLETE: u8 = 4;
    /// It will not change by itself any more.
    FLAG_DONE: u8 = 8;
    /// Side of a block, pixels: two tiles of the renderer; a JPEG's blocks of 8 fit it.
    BLOCK_SIDE: u32 = 16;
    /// Code of closing of a page that said a wrong token: it need not come again.
    CLOSE_BAD_TOKEN: u16 = 4401;
    /// Most lights of a message, from a page or to it: a scene may have more, which pages do not show.
    LIGHTS_MAX: usize = 128;
    /// Most planes that cut the model.
    SECTIONS_MAX: usize = trex_render::SECTIONS_MAX;
    /// Most materials that a message hides or shows by index, from a page or to it.
    PARTS_MAX: usize = 4096;
    /// Materials of a part of the list.
    LIST_MAX: usize = 24;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_module_gives_each_number_by_its_name() {
        let text = module();
        for line in ["export const KIND_FILE = 3;", "export const BLOCK_SIDE = 16;"] {
            assert!(text.lines().any(|found| found == line), "{line} is missing in:\n{text}");
        }
        assert!(text.lines().skip(1).all(|line| line.starts_with("export const ") && line.ends_with(';')));
    }
}
