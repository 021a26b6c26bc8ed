//! How long to wait for an answer.

use std::time::Duration;

use tactile_core::wire::{Command, Topic, WireSpace};

/// How many times as long as the longest before a commit may take until it is sent again.
const LONGER: u32 = 4;

/// How long to wait before a command is sent again, and how often.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patience {
    /// For the reply to the greeting, which a board that only begins to listen does not hear.
    pub greeting: Duration,
    /// For a reply to anything but a commit or a choice.
    pub reply: Duration,
    /// For the reply to a commit or a choice, before which the board computes, at most. A commit is sent again
    /// after four times what the longest before took, then after twice as long, and so on.
    pub update: Duration,
    /// Times a command is sent in all.
    pub attempts: u32,
}

impl Default for Patience {
    fn default() -> Self {
        Patience {
            greeting: Duration::from_millis(500),
            reply: Duration::from_millis(500),
            update: Duration::from_secs(20),
            attempts: 10,
        }
    }
}

impl Patience {
    /// How long the answer to a command that was sent so many times before is waited for. What a commit takes
    /// changes little from one to the next, of which the longest took so long, zero before any; where it does, the
    /// board hears the same command again, which it answers once more and obeys no more.
    pub(super) fn wait<S: WireSpace>(
        &self,
        command: &Command<S>,
        attempt: u32,
        longest: Duration,
    ) -> Duration {
        match command {
            Command::Hello { .. } => self.greeting,
            Command::Commit if !longest.is_zero() => {
                let first = longest.saturating_mul(LONGER).max(self.reply);
                first.saturating_mul(1 << attempt.min(16)).min(self.update)
            }
            Command::Commit | Command::Query(Topic::BestCandidate(_)) => self.update,
            _ => self.reply,
        }
    }
}

#[cfg(test)]
mod tests {
    use tactile_core::space::Planar;

    use super::*;

    #[test]
    fn a_commit_is_waited_for_as_long_as_it_takes_and_nothing_else() {
        let patience = Patience::default();
        let wait = |command: Command<Planar>, attempt, longest| {
            patience.wait(&command, attempt, Duration::from_millis(longest)).as_millis()
        };
        // Nobody knows yet.
        assert_eq!(wait(Command::Commit, 0, 0), 20_000);
        // A board that takes milliseconds has answered long ago; it may take longer once.
        let times = [0, 1, 2, 5, 6, 9].map(|attempt| wait(Command::Commit, attempt, 3));
        assert_eq!(times, [500, 1000, 2000, 16_000, 20_000, 20_000]);
        assert_eq!([0, 1].map(|attempt| wait(Command::Commit, attempt, 2000)), [8000, 16_000]);
        assert_eq!([0, 9].map(|attempt| wait(Command::Ping, attempt, 2000)), [500, 500]);
    }
}
