//! Text from elsewhere on its way to a terminal: names of files and of what is in them may hold what a terminal obeys.
//!
//! Invariants: 1. what comes out holds no control character, none that turns the direction of writing and none that
//! ends a line unseen: each stands there by its number, `\u{1b}`; 2. all else is as it was, and text without such
//! characters is not copied.

use std::borrow::Cow;

/// `text` in one line: what a terminal would obey is shown by number, line ends and tabs too.
pub fn one_line(text: &str) -> Cow<'_, str> {
    shown(text, is_obeyed)
}

/// `text` in its lines: as [`one_line`], but line ends and tabs stay.
pub fn lines(text: &str) -> Cow<'_, str> {
    shown(text, |c| is_obeyed(c) && !matches!(c, '\n' | '\t'))
}

/// Whether a terminal does something else with it than to draw it: controls, marks and overrides of direction,
/// separators of lines, and what has no width.
pub fn is_obeyed(c: char) -> bool {
    c.is_control()
        || matches!(c,
            '\u{61c}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}')
}

fn shown(text: &str, is_bad: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&is_bad) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if is_bad(c) { out.extend(c.escape_unicode()) } else { out.push(c) }
    }
    Cow::Owned(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_terminals_obey_is_told_by_number() {
        assert_eq!(one_line("a\u{1b}[2J\nb\tc\u{7f}\u{9b}1m"), "a\\u{1b}[2J\\u{a}b\\u{9}c\\u{7f}\\u{9b}1m");
        assert_eq!(lines("a\r\nb\tc"), "a\\u{d}\nb\tc");
        assert_eq!(one_line("gnp.\u{202e}xert"), "gnp.\\u{202e}xert");
        assert_eq!(
            lines("x\u{2066}y\u{2069}\u{200b}\u{2028}\u{feff}"),
            "x\\u{2066}y\\u{2069}\\u{200b}\\u{2028}\\u{feff}"
        );
    }

    #[test]
    fn all_else_stays() {
        for text in ["", "plain \\u{1b}", "Gr\u{f6}\u{df}e \u{05e9}\u{05dc}\u{05d5}\u{05dd} \u{1f996}"] {
            assert!(matches!(one_line(text), Cow::Borrowed(same) if same == text));
            assert!(matches!(lines(text), Cow::Borrowed(same) if same == text));
        }
    }
}
