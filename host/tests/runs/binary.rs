//! Runs of the binary `tactile` in a folder of their own.
//!
//! These tests live in the crate of the binary because only there does cargo build it first and say
//! where it is: `CARGO_BIN_EXE_tactile` is right under `cargo test --workspace`, under
//! `cargo test -p tactile-host --test cli`, in every profile and target folder.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use tempfile::TempDir;

/// A finished run.
pub struct Run {
    /// The exit code; `None` when a signal ended it.
    pub code: Option<i32>,
    /// Standard output.
    pub out: String,
    /// Standard error.
    pub err: String,
    line: String,
}

impl Run {
    /// The run, if it went well.
    #[track_caller]
    pub fn done(self) -> Run {
        assert_eq!(self.code, Some(0), "{}\n{}", self.line, self.err);
        self
    }

    /// The run, if it refused its input in words that have all of these.
    #[track_caller]
    pub fn refused(self, words: &[&str]) -> Run {
        assert_eq!(self.code, Some(2), "{}\n{}{}", self.line, self.out, self.err);
        assert_eq!(self.out, "", "{}", self.line);
        self.says(words)
    }

    /// The run, if standard error has all of these.
    #[track_caller]
    pub fn says(self, words: &[&str]) -> Run {
        for word in words {
            assert!(self.err.contains(word), "{}\nlacks {word:?}:\n{}", self.line, self.err);
        }
        self
    }

    /// Standard output as JSON.
    #[track_caller]
    pub fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.out)
            .unwrap_or_else(|e| panic!("{}: {e}\n{}", self.line, self.out))
    }
}

/// A folder in which `tactile` runs.
pub struct Place(TempDir);

impl Place {
    /// An empty one.
    pub fn new() -> Place {
        Place(tempfile::tempdir().unwrap())
    }

    /// Where something in it is.
    pub fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Puts a file there.
    pub fn put(&self, name: &str, content: impl AsRef<[u8]>) {
        std::fs::write(self.at(name), content).unwrap();
    }

    /// Everything in it, folders and hidden files too, in order.
    pub fn names(&self) -> Vec<String> {
        let mut names = Vec::new();
        list(self.0.path(), "", &mut names);
        names.sort();
        names
    }

    /// Runs `tactile` with these words, separated by blanks. Whatever the input: no panic, no signal,
    /// and unless it went well, nothing new and nothing less in the folder.
    #[track_caller]
    pub fn tactile(&self, line: &str) -> Run {
        let before = self.names();
        let output = Command::new(env!("CARGO_BIN_EXE_tactile"))
            .args(line.split_whitespace())
            .current_dir(self.0.path())
            .stdin(Stdio::null())
            .output()
            .unwrap();
        let run = Run {
            code: output.status.code(),
            out: String::from_utf8(output.stdout).unwrap(),
            err: String::from_utf8(output.stderr).unwrap(),
            line: format!("tactile {line}"),
        };
        assert!(!run.err.contains("panicked"), "{}\n{}", run.line, run.err);
        assert!(run.code.is_some(), "{} ended by a signal\n{}", run.line, run.err);
        if run.code != Some(0) {
            assert_eq!(self.names(), before, "left behind by {}\n{}", run.line, run.err);
        }
        run
    }
}

fn list(folder: &Path, prefix: &str, names: &mut Vec<String>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        let name = format!("{prefix}{}", entry.file_name().into_string().unwrap());
        if entry.path().is_dir() {
            list(&entry.path(), &format!("{name}/"), names);
        }
        names.push(name);
    }
}
