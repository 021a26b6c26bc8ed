//! Numbers between white space, each with its place.

use std::fmt::Display;
use std::path::Path;

use super::super::LogError;

/// The words of a text, in order. Words from `#` to the end of a line are comments.
pub(super) struct Tokens<'a> {
    file: &'a Path,
    lines: std::iter::Enumerate<std::str::Lines<'a>>,
    /// The line being read, what of it was taken, and its number from one.
    line: &'a str,
    taken: usize,
    number: usize,
}

impl<'a> Tokens<'a> {
    pub(super) fn new(file: &'a Path, text: &'a str) -> Self {
        Tokens { file, lines: text.lines().enumerate(), line: "", taken: 0, number: 0 }
    }

    /// The next word and its column from one.
    pub(super) fn next(&mut self) -> Option<(&'a str, usize)> {
        loop {
            let rest = &self.line[self.taken..];
            let rest = rest.find('#').map_or(rest, |comment| &rest[..comment]);
            if let Some(start) = rest.find(|c: char| !c.is_whitespace()) {
                let word = &rest[start..];
                let word = &word[..word.find(char::is_whitespace).unwrap_or(word.len())];
                let column = self.taken + start + 1;
                self.taken += start + word.len();
                return Some((word, column));
            }
            let (index, line) = self.lines.next()?;
            (self.line, self.taken, self.number) = (line, 0, index + 1);
        }
    }

    /// An error about what was just read, or about the end of the file.
    pub(super) fn wrong(&self, column: Option<usize>, problem: impl Display) -> LogError {
        let problem = match column {
            Some(column) => format!("column {column}: {problem}"),
            None => problem.to_string(),
        };
        LogError::Line { file: self.file.into(), line: self.number.max(1), problem }
    }

    /// The next word, which must be there.
    pub(super) fn word(&mut self, what: impl Display) -> Result<(&'a str, usize), LogError> {
        match self.next() {
            Some(found) => Ok(found),
            None => Err(self.wrong(None, format!("expected {what}, found the end of the file"))),
        }
    }

    /// A finite number.
    pub(super) fn number(&mut self, what: impl Display) -> Result<f64, LogError> {
        let (word, column) = self.word(&what)?;
        match word.parse::<f64>() {
            Ok(x) if x.is_finite() => Ok(x),
            _ => {
                let problem = format!("expected {what} (a finite number), found {word:?}");
                Err(self.wrong(Some(column), problem))
            }
        }
    }

    /// How many of something follow; some programs write counts as `30.00000`.
    pub(super) fn count(&mut self, what: impl Display) -> Result<usize, LogError> {
        let (word, column) = self.word(&what)?;
        match word.parse::<f64>() {
            Ok(x) if x >= 0.0 && x.fract() == 0.0 && x < 1e9 => Ok(x as usize),
            _ => {
                let problem = format!("expected {what} (a whole number), found {word:?}");
                Err(self.wrong(Some(column), problem))
            }
        }
    }

    /// Refuses anything after the end of the content.
    pub(super) fn end(&mut self, what: impl Display) -> Result<(), LogError> {
        match self.next() {
            None => Ok(()),
            Some((word, column)) => {
                let problem = format!("expected the end of the file after {what}, found {word:?}");
                Err(self.wrong(Some(column), problem))
            }
        }
    }
}
