//! What a damaged recording does not tell of the grasps that the board counted.

use super::LoggedGrasp;

/// What is missing in the log of the last object.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LeftOut {
    /// Grasps that the board counted and that are not in the log.
    pub grasps: u64,
    /// Contacts that the board counted in grasps of the log, and that are not there.
    pub contacts: u64,
    /// Grasps whose motion since the one before may have been lost.
    pub motions: Vec<u64>,
    /// Whether the noise that the board was told may have been lost: the log has none.
    pub noise: bool,
}

/// Most grasps without a motion that are named.
const NAMED: usize = 6;

impl LeftOut {
    /// One sentence for each kind of what is missing.
    pub fn sentences(&self) -> Vec<String> {
        let counted = |count: u64, what: &str| match count {
            0 => None,
            1 => Some(format!("1 {what} that the board counted is left out.")),
            _ => Some(format!("{count} {what}s that the board counted are left out.")),
        };
        let unknown = (!self.motions.is_empty()).then(|| {
            let named: Vec<String> = self.motions.iter().take(NAMED).map(u64::to_string).collect();
            let more = match self.motions.len() - named.len() {
                0 => String::new(),
                more => format!(" and {more} more"),
            };
            let plural = if self.motions.len() == 1 { "" } else { "s" };
            format!("The motion before grasp{plural} {}{more} is unknown.", named.join(", "))
        });
        let noise = "The noise that the board was told may have been lost: the log states none.";
        let noise = self.noise.then(|| noise.to_owned());
        let [grasps, contacts] = [counted(self.grasps, "grasp"), counted(self.contacts, "contact")];
        let found = [grasps, contacts, unknown, noise];
        found.into_iter().flatten().collect()
    }
}

/// Whether anything was told of a grasp.
pub(super) fn tells(grasp: &LoggedGrasp) -> bool {
    grasp.motion.is_some() || !grasp.contacts.is_empty() || !grasp.free.is_empty()
}

/// Parts of one grasp, between which something was lost, together.
pub(super) fn joined(parts: Vec<LoggedGrasp>, last: LoggedGrasp) -> LoggedGrasp {
    let mut whole = LoggedGrasp::default();
    for part in parts.into_iter().chain([last]) {
        // A board refuses a second motion.
        whole.motion = whole.motion.or(part.motion);
        whole.contacts.extend(part.contacts);
        whole.free.extend(part.free);
    }
    whole
}
