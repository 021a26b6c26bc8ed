//! What people see: talk, progress and colours, each only where somebody is looking.
//!
//! Results asked for go to standard output, everything about the work to standard error. Colours are
//! for terminals, and not where `NO_COLOR` is set (no-color.org) or `TERM` is `dumb`; progress is for
//! terminals. `--quiet` leaves results in files, JSON, the address of a live view,
//! warnings and errors.

use std::fmt::Display;
use std::io::{ErrorKind, IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::Error;
use crate::view::report::Report;

/// Whether talk is unwanted. A program has one terminal.
static QUIET: AtomicBool = AtomicBool::new(false);

/// Sets whether talk is unwanted.
pub(super) fn silence(quiet: bool) {
    QUIET.store(quiet, Ordering::Relaxed);
}

fn quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// Prints a line on standard output.
///
/// # Errors
/// When nothing can be written there. A reader that went away is not an error.
pub(super) fn say(text: impl Display) -> Result<(), Error> {
    match writeln!(std::io::stdout(), "{text}") {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => {
            Err(Error::Failure(format!("standard output: cannot write: {e}")))
        }
        _ => Ok(()),
    }
}

/// Like [`say`], of what is also in a file or not asked for: not when talk is unwanted.
///
/// # Errors
/// As [`say`].
pub(super) fn tell(text: impl Display) -> Result<(), Error> {
    if quiet() { Ok(()) } else { say(text) }
}

/// Says on standard error what is going on.
pub(super) fn note(text: impl Display) {
    if !quiet() {
        let _ = writeln!(std::io::stderr(), "{text}");
    }
}

/// Says on standard error what somebody waits for: also when talk is unwanted.
pub(super) fn announce(text: impl Display) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Text that somebody else may have written, without what terminals obey.
pub(super) fn plain(text: impl Display) -> String {
    let text = text.to_string();
    let is_plain = |c: char| !c.is_control() || matches!(c, '\n' | '\t');
    text.chars().map(|c| if is_plain(c) { c } else { char::REPLACEMENT_CHARACTER }).collect()
}

/// Says on standard error what is not as it should be.
pub(super) fn warn(text: impl Display) {
    let text = plain(text);
    let _ = writeln!(
        std::io::stderr(),
        "{} {text}",
        Ink::Amber.on("warning:", colours(&std::io::stderr()))
    );
}

/// Says on standard error why the program gives up.
pub(super) fn fail(text: impl Display) {
    let text = plain(text);
    let _ = writeln!(
        std::io::stderr(),
        "{} {text}",
        Ink::Red.on("error:", colours(&std::io::stderr()))
    );
}

/// Whether a stream shows colours.
fn colours(stream: &impl IsTerminal) -> bool {
    let set = |name| std::env::var_os(name).filter(|v| !v.is_empty());
    stream.is_terminal() && set("NO_COLOR").is_none() && set("TERM").is_none_or(|t| t != "dumb")
}

/// How a piece of text stands out.
#[derive(Clone, Copy)]
enum Ink {
    Bold,
    Faint,
    Amber,
    Red,
}

impl Ink {
    fn on(self, text: &str, colours: bool) -> String {
        let code = match self {
            Ink::Bold => "1",
            Ink::Faint => "2",
            Ink::Amber => "1;33",
            Ink::Red => "1;31",
        };
        if colours && !text.is_empty() { format!("\x1b[{code}m{text}\x1b[0m") } else { text.into() }
    }
}

/// Tells a report as a table.
///
/// # Errors
/// As [`say`].
pub(super) fn tell_report(report: &Report) -> Result<(), Error> {
    tell(table(&report.to_string(), colours(&std::io::stdout())))
}

/// A report's lines, with what names a figure fainter than the figure.
fn table(text: &str, colours: bool) -> String {
    let line = |(number, line): (usize, &str)| {
        if number == 0 {
            return Ink::Bold.on(line, colours);
        }
        let part =
            |from: usize, to: usize| line.chars().skip(from).take(to - from).collect::<String>();
        let (name, value, rest) = (part(0, 24), part(24, 36), part(36, usize::MAX));
        let ink = match name.trim() {
            "lost grasps" => Some(Ink::Red),
            "ambiguous grasps" => Some(Ink::Amber),
            _ => None,
        };
        let value = ink.map_or(value.clone(), |ink| ink.on(&value, colours));
        // Figures in the last column are no comment.
        let figure = rest.trim_start().starts_with(|c: char| c.is_ascii_digit());
        let rest = if figure { rest } else { Ink::Faint.on(&rest, colours) };
        Ink::Faint.on(&name, colours) + &value + &rest
    };
    text.trim_end().lines().enumerate().map(line).collect::<Vec<_>>().join("\n")
}

/// How often a bar is drawn.
const EVERY: Duration = Duration::from_millis(100);

/// Width of the bar itself, characters.
const WIDTH: usize = 24;

/// Long work on one line of standard error, which is gone when the work is done.
pub(super) struct Progress {
    what: &'static str,
    unit: &'static str,
    start: Instant,
    /// When it was drawn last; `None` while there is nothing to wipe away.
    drawn: Mutex<Option<Instant>>,
    shown: bool,
}

impl Progress {
    /// Of `what`, counted in `unit`.
    pub fn new(what: &'static str, unit: &'static str) -> Self {
        let shown = !quiet() && std::io::stderr().is_terminal();
        Progress { what, unit, start: Instant::now(), drawn: Mutex::default(), shown }
    }

    /// So much is done; from any thread.
    pub fn at(&self, done: usize, all: usize) {
        self.draw(|seconds| bar(self.what, self.unit, done, all, seconds));
    }

    /// How far work is of which nobody knows the end; from any thread.
    pub fn reached(&self, done: usize, state: impl Display) {
        self.draw(|seconds| {
            let Progress { what, unit, .. } = self;
            format!("{what:<9}{done} {unit}, {state}, {}", duration(seconds))
        });
    }

    fn draw(&self, line: impl FnOnce(f64) -> String) {
        if !self.shown {
            return;
        }
        let elapsed = self.start.elapsed();
        let mut drawn = self.drawn.lock().unwrap_or_else(PoisonError::into_inner);
        // What is soon over needs no bar.
        if drawn.map_or(elapsed, |at| at.elapsed()) < EVERY {
            return;
        }
        *drawn = Some(Instant::now());
        let line = line(elapsed.as_secs_f64());
        let _ = write!(std::io::stderr(), "\r\x1b[K{line}");
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        let drawn = self.drawn.lock().unwrap_or_else(PoisonError::into_inner);
        if drawn.is_some() {
            let _ = write!(std::io::stderr(), "\r\x1b[K");
        }
    }
}

/// What is done, how fast, and how long the rest takes at that rate.
fn bar(what: &str, unit: &str, done: usize, all: usize, seconds: f64) -> String {
    const EIGHTHS: [&str; 8] = ["", "▏", "▎", "▍", "▌", "▋", "▊", "▉"];
    let share = (done as f64 / all.max(1) as f64).min(1.0);
    let eighths = (share * (8 * WIDTH) as f64) as usize;
    let full = "█".repeat(eighths / 8) + EIGHTHS[eighths % 8];
    let rate = done as f64 / seconds.max(1e-9);
    let left = all.saturating_sub(done) as f64 / rate.max(1e-9);
    let rest = if done == 0 { String::new() } else { format!(", {} left", duration(left)) };
    format!("{what:<9}{full:<WIDTH$} {done}/{all} {unit}, {}/s{rest}", three_digits(rate))
}

fn three_digits(value: f64) -> String {
    match value {
        v if v >= 100.0 => format!("{v:.0}"),
        v if v >= 10.0 => format!("{v:.1}"),
        v => format!("{v:.2}"),
    }
}

fn duration(seconds: f64) -> String {
    match seconds.min(1e9).ceil() as u64 {
        s @ 0..60 => format!("{s} s"),
        s @ 60..3600 => format!("{} min {:02} s", s / 60, s % 60),
        s => format!("{} h {:02} min", s / 3600, s / 60 % 60),
    }
}

/// Values over `width` characters at most, each as high as the greatest of those it stands for; a
/// dot where there is none. The scale starts at 0 and ends at the greatest value.
pub(super) fn sparkline(values: &[f64], width: usize) -> String {
    const LEVELS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
    let top = values.iter().copied().filter(|v| v.is_finite()).fold(0.0, f64::max);
    let columns = values.len().min(width);
    let column = |i: usize| {
        let part = &values[i * values.len() / columns..(i + 1) * values.len() / columns];
        let greatest = part.iter().copied().filter(|v| v.is_finite()).reduce(f64::max);
        greatest.map_or('·', |value| {
            let share = if top > 0.0 { (value / top).max(0.0) } else { 0.0 };
            LEVELS[((share * 8.0) as usize).min(7)]
        })
    };
    (0..columns).map(column).collect()
}

/// Characters of a sparkline in a summary.
pub(super) const SPARK: usize = 60;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_say_how_far_how_fast_and_how_long() {
        assert_eq!(
            bar("poses", "grasps", 30, 120, 2.0),
            "poses    ██████                   30/120 grasps, 15.0/s, 6 s left"
        );
        assert_eq!(
            bar("poses", "grasps", 0, 9, 0.0),
            "poses                             0/9 grasps, 0.00/s"
        );
        assert!(bar("x", "y", 5, 5, 1.0).contains(&"█".repeat(WIDTH)));
        assert!(bar("x", "y", 7, 0, 1.0).ends_with("0 s left"), "more than all, of nothing");
        assert_eq!(duration(61.2), "1 min 02 s");
        assert_eq!(duration(7_260.0), "2 h 01 min");
        assert_eq!(duration(f64::INFINITY), duration(1e9));
    }

    #[test]
    fn text_of_others_commands_no_terminal() {
        assert_eq!(plain("a\x1b[2J\u{9b}1m\r\tb\ncafé"), "a\u{fffd}[2J\u{fffd}1m\u{fffd}\tb\ncafé");
    }

    #[test]
    fn sparklines_show_peaks_and_gaps() {
        assert_eq!(sparkline(&[0.0, 1.0, 2.0, 4.0, 8.0], 9), "▁▂▃▅█");
        assert_eq!(sparkline(&[1.0, f64::NAN, 1.0], 9), "█·█");
        // Of many values the peak of each part is seen.
        let mut many = vec![0.0; 1000];
        many[499] = 1.0;
        assert_eq!(sparkline(&many, 10), "▁▁▁▁█▁▁▁▁▁");
        assert_eq!(sparkline(&[0.0, 0.0, -1.0], 9), "▁▁▁");
        assert_eq!(sparkline(&[], 9), "");
    }

    #[test]
    fn a_table_without_colours_is_the_text() {
        let text = "2 grasps\n  pose, rms                  1.29 mm      0.52 °\n  lost grasps                      1  4\n";
        assert_eq!(table(text, false), text.trim_end());
        let coloured = table(text, true);
        assert!(coloured.starts_with("\x1b[1m2 grasps\x1b[0m\n"), "{coloured:?}");
        assert!(coloured.contains("\x1b[1;31m           1\x1b[0m"), "{coloured:?}");
        assert!(coloured.contains("     1.29 mm      0.52 °"), "{coloured:?}");
    }
}
