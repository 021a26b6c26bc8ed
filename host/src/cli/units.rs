//! Lengths that look as if their unit had been forgotten.

/// The greatest length of a thing that hands hold, metres.
const WIDEST: f64 = 10.0;

/// Standard deviations between contacts and a surface that no noise explains, and the least of them that
/// counts, metres: contacts said to be exact may well be some millimetres off.
const FARTHEST: f64 = 100.0;
const LEAST: f64 = 1e-3;

/// What is to be said of contacts or a model so wide, and of contacts that lie so far from the surface for
/// their standard deviation; all in metres.
pub(super) fn doubt(extent: f64, distance: f64, deviation: f64) -> Option<String> {
    const QUESTION: &str = "are they metres, or does a unit such as mm lack?";
    if extent > WIDEST {
        return Some(format!("lengths up to {extent:.0} m: {QUESTION}"));
    }
    (distance > FARTHEST * deviation.max(LEAST)).then(|| {
        format!("contacts with a deviation of {deviation} m lie {distance:.3} m from the surface: {QUESTION}")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_hands_hold_raises_no_doubt() {
        assert_eq!(doubt(0.12, 0.0013, 0.001), None);
        assert_eq!(doubt(0.12, 0.03, 1e-4), None);
        assert!(doubt(60.0, 0.001, 0.001).is_some_and(|d| d.starts_with("lengths up to 60 m")));
        assert!(doubt(6.0, 2.996, 0.001).is_some_and(|d| d.contains("lie 2.996 m from")));
    }
}
