//! Whether a model explains contacts: how much χ² noise alone makes.

/// χ² per degree of freedom up to which a model explains contacts: about 1 where it is the right one and deviations are
/// as said, about 2 for flat faces on curves.
pub const MOST: f64 = 1.4;

/// Deviations of χ² above its mean that noise rarely makes: where there are few contacts that is more. Of right models,
/// three in a hundred leave more than 2 and one in two hundred more than 3.
const RARE: f64 = 3.0;

/// The same where a model of another number of parts may be right: one face too few leaves hardly more.
const CLOSE: f64 = 2.0;

/// Whether a model of the right kind leaves so much χ² per degree of freedom; one that is no number it does not.
/// Fewer degrees than one count as one.
pub fn is_likely(per_degree: f64, degrees: f64) -> bool {
    per_degree <= most(RARE, degrees)
}

/// Whether faces leave so little that hardly one is missing among them, likewise.
pub fn is_close(per_degree: f64, degrees: f64) -> bool {
    per_degree <= most(CLOSE, degrees)
}

fn most(deviations: f64, degrees: f64) -> f64 {
    MOST.max(1.0 + deviations * (2.0 / degrees.max(1.0)).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_contacts_may_scatter_more_and_many_no_less() {
        for (per_degree, degrees, likely, close) in [
            (1.39, 1e6, true, true),
            (1.41, 1e6, false, false),
            // χ² of 8 degrees: mean 8, deviation 4.
            (1.99, 8.0, true, true),
            (2.01, 8.0, true, false),
            (2.49, 8.0, true, false),
            (2.51, 8.0, false, false),
            (3.8, 0.0, true, true),
            (5.2, 0.0, true, false),
            (5.3, 0.0, false, false),
            (f64::NAN, 8.0, false, false),
            (f64::INFINITY, 8.0, false, false),
        ] {
            assert_eq!(is_likely(per_degree, degrees), likely, "{per_degree} {degrees}");
            assert_eq!(is_close(per_degree, degrees), close, "{per_degree} {degrees}");
        }
    }
}
