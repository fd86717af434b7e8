//! The terminal at stderr: its width, colours, and wrapping of text.

use console::{Term, measure_text_width};
use std::io::IsTerminal;

/// Assumed width of a terminal whose width is not known, in columns.
const COLUMNS: usize = 80;
/// Width in columns that is used if stderr is not a terminal. It is so large that lines are not wrapped or shortened,
/// because wrapped lines are hard to search.
const NO_TERMINAL: usize = 1 << 20;
/// Smallest width that is used for a terminal, in columns.
const LEAST: usize = 40;

/// Properties of stderr.
#[derive(Debug, Clone, Copy)]
pub struct Terminal {
    /// Width in columns.
    pub width: usize,
    has_colours: bool,
    /// Whether the cursor can be moved.
    pub can_redraw: bool,
}

impl Terminal {
    /// Returns the properties of stderr of this process. Colours are used only if stderr is a terminal. They are not
    /// used if the environment variable NO_COLOR is set and not empty, CLICOLOR is 0, or TERM is `dumb`.
    pub fn of_stderr() -> Terminal {
        if !std::io::stderr().is_terminal() {
            return Terminal { width: NO_TERMINAL, has_colours: false, can_redraw: false };
        }
        let variable = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty());
        let is = |name: &str, value: &str| variable(name).is_some_and(|found| found == value);
        let can_redraw = !is("TERM", "dumb");
        let has_colours = can_redraw && variable("NO_COLOR").is_none() && !is("CLICOLOR", "0");
        let width = Term::stderr().size_checked().map_or(COLUMNS, |(_, columns)| usize::from(columns));
        Terminal { width: width.max(LEAST), has_colours, can_redraw }
    }

    /// Returns the properties of a terminal of `width` columns without colours.
    #[cfg(test)]
    pub fn plain(width: usize) -> Terminal {
        Terminal { width, has_colours: false, can_redraw: false }
    }

    /// Returns `text` in green, if the terminal has colours.
    pub fn good(&self, text: &str) -> String {
        self.coloured("32", text)
    }

    /// Returns `text` in red, if the terminal has colours.
    pub fn bad(&self, text: &str) -> String {
        self.coloured("31", text)
    }

    /// Returns `text` in yellow, if the terminal has colours.
    pub fn doubtful(&self, text: &str) -> String {
        self.coloured("33", text)
    }

    /// Returns `text` in bold, if the terminal has colours.
    pub fn strong(&self, text: &str) -> String {
        self.coloured("1", text)
    }

    fn coloured(&self, code: &str, text: &str) -> String {
        if self.has_colours { format!("\u{1b}[{code}m{text}\u{1b}[0m") } else { text.to_owned() }
    }

    /// Returns the number of columns for text after an indentation of `indent` columns. The last column is not used,
    /// because some terminals start a new line after a character in it.
    pub fn room(&self, indent: usize) -> usize {
        self.width.saturating_sub(indent + 1).max(LEAST / 2)
    }

    /// Wraps `text` at spaces. The lines are short enough to be printed after an indentation of `indent` columns. A
    /// word longer than a line, such as a path, is shortened in the middle. Returns at least one line.
    pub fn wrapped(&self, text: &str, indent: usize) -> Vec<String> {
        let room = self.room(indent);
        let text: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
        if measure_text_width(&text) <= room {
            return vec![text];
        }
        let mut lines = vec![String::new()];
        for word in text.split_whitespace() {
            let word = shortened(word, room);
            let last = lines.len() - 1;
            let line = &mut lines[last];
            if line.is_empty() {
                *line = word;
            } else if measure_text_width(line) + 1 + measure_text_width(&word) <= room {
                line.push(' ');
                line.push_str(&word);
            } else {
                lines.push(word);
            }
        }
        lines
    }
}

/// Shortens `text` to at most `room` columns by replacing its middle by three dots. The end is kept longer than the
/// start, because a path ends with the file name.
pub fn shortened(text: &str, room: usize) -> String {
    let clean: String = text.chars().map(|c| if c.is_control() { '?' } else { c }).collect();
    if measure_text_width(&clean) <= room {
        return clean;
    }
    let room = room.saturating_sub(3);
    let take = |characters: &mut dyn Iterator<Item = char>, most: usize| {
        let mut taken = String::new();
        for c in characters {
            if measure_text_width(&taken) + measure_text_width(c.encode_utf8(&mut [0; 4])) > most {
                break;
            }
            taken.push(c);
        }
        taken
    };
    let end: String = take(&mut clean.chars().rev(), room * 2 / 3).chars().rev().collect();
    let start = take(&mut clean.chars(), room - measure_text_width(&end));
    format!("{start}...{end}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_keep_within_the_width_and_lose_no_word() {
        let text = "the exposures in the EXIF data contradict the pixels (estimated from the pixels instead), give -e to set them";
        let lines = Terminal::plain(60).wrapped(text, 9);
        assert!(lines.len() > 1 && lines.iter().all(|l| measure_text_width(l) <= 50));
        assert_eq!(lines.join(" "), text);
        assert_eq!(Terminal::plain(60).wrapped("", 9), [""]);
        let path = format!("/home/someone/{}/IMG_0001.JPG: left out", "photographs/".repeat(12));
        let lines = Terminal::plain(60).wrapped(&path, 9);
        assert!(lines[0].contains("...") && lines[0].ends_with("IMG_0001.JPG:") && lines[0].len() <= 50, "{lines:?}");
    }

    #[test]
    fn paths_lose_their_middle_by_columns_and_not_by_bytes() {
        assert_eq!(shortened("room.exr", 8), "room.exr");
        assert_eq!(shortened("/a/long/way/to/room.exr", 15), "/a/l...room.exr");
        let wide = shortened(&"窓".repeat(40), 21);
        assert!(measure_text_width(&wide) <= 21 && wide.contains("..."), "{wide}");
        assert_eq!(shortened("a\u{1b}[31mb\n", 20), "a?[31mb?");
    }

    #[test]
    fn colours_are_only_where_there_are_any() {
        assert_eq!(Terminal::plain(60).good("same"), "same");
        let colourful = Terminal { has_colours: true, ..Terminal::plain(60) };
        assert_eq!(colourful.bad("differs"), "\u{1b}[31mdiffers\u{1b}[0m");
        assert_eq!(measure_text_width(&colourful.strong("x")), 1);
    }
}
