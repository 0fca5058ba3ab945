//! The terminal of a standard stream: its size, and whether it shows colours.

use crate::Style;
use rustix::termios::{isatty, tcgetwinsize};
use std::os::fd::AsFd;

/// Size that is assumed for a terminal that does not tell its own: columns and rows.
const SIZE_DEFAULT: (u16, u16) = (80, 24);

/// Returns columns and rows of the terminal behind a stream; `None`: it is no terminal.
pub fn size(stream: &impl AsFd) -> Option<(u16, u16)> {
    if !isatty(stream) {
        return None;
    }
    let size = tcgetwinsize(stream).map_or(SIZE_DEFAULT, |size| (size.ws_col, size.ws_row));
    Some(if size.0 == 0 || size.1 == 0 { SIZE_DEFAULT } else { size })
}

/// Returns columns and rows of a terminal on which text can be drawn anew; `None`: it is none, or a dumb one, which knows no moves of
/// its cursor.
pub fn redrawn_size(stream: &impl AsFd) -> Option<(u16, u16)> {
    if is_dumb() { None } else { size(stream) }
}

fn is_dumb() -> bool {
    std::env::var_os("TERM").is_none_or(|term| term == "dumb")
}

/// Returns the style for a stream: of its terminal's width, coloured unless NO_COLOR or a dumb terminal forbids it.
pub fn style(stream: &impl AsFd) -> Style {
    let Some((columns, _)) = size(stream) else { return Style::PLAIN };
    let is_set = |name: &str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    // A line in the last column would make some terminals wrap.
    Style { width: usize::from(columns) - 1, is_coloured: !is_set("NO_COLOR") && !is_dumb() }
}
