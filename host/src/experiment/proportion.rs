//! How often something succeeded, and how sure that is.

use std::fmt;
use std::iter::Sum;

use serde::Serialize;

/// Successes out of runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Proportion {
    /// How many succeeded.
    pub successes: usize,
    /// Of how many; no fewer.
    pub of: usize,
}

impl Proportion {
    /// How many of `outcomes` are true.
    pub fn of(outcomes: impl IntoIterator<Item = bool>) -> Proportion {
        outcomes.into_iter().fold(Proportion { successes: 0, of: 0 }, |sum, success| Proportion {
            successes: sum.successes + usize::from(success),
            of: sum.of + 1,
        })
    }

    /// Wilson's 95 % score interval (Wilson, Journal of the American Statistical Association 22,
    /// 1927), fractions; everything is possible before the first run.
    pub fn interval(&self) -> (f64, f64) {
        const Z: f64 = 1.959_963_984_540_054;
        if self.of == 0 {
            return (0.0, 1.0);
        }
        let n = self.of as f64;
        let p = self.successes as f64 / n;
        let scale = 1.0 / (1.0 + Z * Z / n);
        let middle = scale * (p + Z * Z / (2.0 * n));
        let half = scale * Z * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
        ((middle - half).max(0.0), (middle + half).min(1.0))
    }
}

impl Sum for Proportion {
    fn sum<I: Iterator<Item = Proportion>>(all: I) -> Proportion {
        all.fold(Proportion { successes: 0, of: 0 }, |sum, one| Proportion {
            successes: sum.successes + one.successes,
            of: sum.of + one.of,
        })
    }
}

impl fmt::Display for Proportion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.of == 0 {
            return f.write_str("–");
        }
        let percent = |x: f64| 100.0 * x;
        let (low, high) = self.interval();
        let share = self.successes as f64 / self.of as f64;
        write!(f, "{:.0} % [{:.0}, {:.0}]", percent(share), percent(low), percent(high))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilson_gives_the_textbook_intervals() {
        let near = |p: Proportion, low: f64, high: f64| {
            let (l, h) = p.interval();
            assert!((l - low).abs() < 5e-4 && (h - high).abs() < 5e-4, "{l} {h}");
        };
        near(Proportion { successes: 40, of: 40 }, 0.9124, 1.0);
        near(Proportion { successes: 0, of: 10 }, 0.0, 0.2775);
        near(Proportion { successes: 15, of: 30 }, 0.3315, 0.6685);
        near(Proportion { successes: 0, of: 0 }, 0.0, 1.0);
        assert_eq!(Proportion::of([true, false, true, true]).successes, 3);
        assert_eq!(Proportion { successes: 39, of: 40 }.to_string(), "98 % [87, 100]");
    }
}
