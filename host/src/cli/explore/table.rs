//! An exploration as lines: action by action.

use crate::cli::terminal::{SPARK, sparkline};
use crate::explore::episode::Action;

/// Actions that are listed one by one; of more the last ones.
const LISTED: usize = 24;

/// Action by action, and how the known share grew.
pub(super) fn table(actions: &[Action]) -> String {
    let mut text = String::from("action  contacts    gain  known  choosing");
    let left_out = actions.len().saturating_sub(LISTED);
    if left_out > 0 {
        text += &format!("\n     …  {left_out} actions before");
    }
    for (number, action) in actions.iter().enumerate().skip(left_out) {
        let gain = action.gain.map_or("–".into(), |g| format!("{g:.2}"));
        text += &format!(
            "\n{:>6}{:>10}{gain:>8}{:>5.0} %{:>7.0} ms",
            number + 1,
            action.contacts,
            100.0 * action.known,
            1e3 * action.choosing
        );
    }
    let known: Vec<f64> = actions.iter().map(|a| a.known).collect();
    text + &format!("\n known  {}", sparkline(&known, SPARK))
}
