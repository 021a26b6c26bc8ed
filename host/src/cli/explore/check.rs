//! Options of an exploration that do not go together.

use super::{ExploreArgs, HandName, Kinds, name};
use crate::cli::Error;
use crate::explore::criterion::About;
use crate::explore::{Criterion, Until};

/// Refuses options that others make meaningless.
pub(super) fn check(args: &ExploreArgs) -> Result<(), Error> {
    let idle = |is_given: bool, kind: Kinds| is_given && args.candidates != kind;
    for (is_idle, option, other) in [
        (idle(args.area.is_some(), Kinds::Clusters), "--area", "--candidates clusters"),
        (idle(args.count.is_some(), Kinds::Continuous), "--count", "--candidates continuous"),
        (
            args.alpha.is_some() && args.criterion != Criterion::Renyi,
            "--alpha",
            "--criterion renyi",
        ),
    ] {
        if is_idle {
            return Err(Error::Input(format!("{option} has a meaning only with {other}")));
        }
    }
    if args.candidates == Kinds::Clusters && !matches!(args.hand, HandName::Idealised) {
        return Err(Error::input("--candidates clusters: only the idealised hand faces areas"));
    }
    let planned = [
        (args.batch > 1, "--batch"),
        (args.lookahead, "--lookahead"),
        (args.cost.is_some(), "--cost"),
    ];
    if let (About::Chance, Some((_, option))) =
        (args.criterion.about(), planned.iter().find(|(given, _)| *given))
    {
        let criterion = name(args.criterion);
        return Err(Error::Input(format!(
            "{option}: nothing is planned by --criterion {criterion}"
        )));
    }
    if matches!(args.until, Until::Gain(_)) && !args.criterion.is_in_nats() {
        return Err(Error::Input(format!(
            "--until {}: expected a criterion that counts in nats, found --criterion {}",
            args.until,
            name(args.criterion)
        )));
    }
    Ok(())
}
