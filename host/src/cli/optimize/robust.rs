//! What wrong edges may cost, as a word on the command line.

use std::str::FromStr;

use crate::graph::pose::Kernel;

/// A kind of robustness and its width in standard deviations, if given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Robust {
    kind: Kind,
    width: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    None,
    Huber,
    Cauchy,
    GemanMcClure,
    Tukey,
    Dcs,
    Gnc,
}

impl FromStr for Robust {
    type Err = String;

    fn from_str(text: &str) -> Result<Robust, String> {
        let (word, width) = match text.split_once(':') {
            Some((word, width)) => (word, Some(width)),
            None => (text, None),
        };
        let kind = match word {
            "none" => Kind::None,
            "huber" => Kind::Huber,
            "cauchy" => Kind::Cauchy,
            "geman-mcclure" => Kind::GemanMcClure,
            "tukey" => Kind::Tukey,
            "dcs" => Kind::Dcs,
            "gnc" => Kind::Gnc,
            _ => {
                return Err("expected none, huber, cauchy, geman-mcclure, tukey, dcs or gnc".into());
            }
        };
        let width = match width {
            None => None,
            Some(_) if kind == Kind::None => return Err("expected none without a number".into()),
            Some(number) => match number.parse() {
                Ok(width) if width > 0.0 && f64::is_finite(width) => Some(width),
                _ => {
                    return Err(format!("expected {word}:K with a number K > 0, such as {word}:3"));
                }
            },
        };
        Ok(Robust { kind, width })
    }
}

impl Robust {
    /// Whether every edge is believed.
    pub(super) fn is_none(self) -> bool {
        self.kind == Kind::None
    }

    /// Whether wrong edges are looked for.
    pub(super) fn is_gnc(self) -> bool {
        self.kind == Kind::Gnc
    }

    /// The width, where one was given.
    pub(super) fn width(self) -> Option<f64> {
        self.width
    }

    /// The kernel for errors of this many numbers.
    pub(super) fn kernel(self, degrees: usize) -> Kernel {
        // The square root of what 5 % of such sums of squares exceed. Beyond Tukey's width edges have no
        // say at all: it is the wider by as much as in one dimension, where each is 95 % efficient.
        let usual = if degrees == 3 { 2.795_483 } else { 3.548_460 };
        let width = self.width.unwrap_or(match self.kind {
            Kind::Tukey => usual * 4.685 / 2.385,
            _ => usual,
        });
        match self.kind {
            Kind::None | Kind::Gnc => Kernel::Identity,
            Kind::Huber => Kernel::Huber(width),
            Kind::Cauchy => Kernel::Cauchy(width),
            Kind::GemanMcClure => Kernel::GemanMcClure(width),
            Kind::Tukey => Kernel::Tukey(width),
            Kind::Dcs => Kernel::Dcs(width),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_are_words_with_a_number_or_without() {
        let robust = |text: &str| text.parse::<Robust>();
        assert_eq!(robust("none").unwrap().kernel(3), Kernel::Identity);
        assert_eq!(robust("huber:1.5").unwrap().kernel(6), Kernel::Huber(1.5));
        assert_eq!(robust("geman-mcclure:2").unwrap().kernel(3), Kernel::GemanMcClure(2.0));
        for (degrees, quantile) in [(3, 7.814_728), (6, 12.591_587)] {
            let Kernel::Dcs(width) = robust("dcs").unwrap().kernel(degrees) else { panic!() };
            assert!((width * width - quantile).abs() < 1e-4, "{width}");
        }
        let Kernel::Tukey(width) = robust("tukey").unwrap().kernel(3) else { panic!() };
        assert!(width > 5.0);
        for wrong in
            ["", "Huber", "huber:", "huber:x", "huber:0", "huber:-1", "huber:inf", "none:1"]
        {
            assert!(robust(wrong).unwrap_err().starts_with("expected"), "{wrong}");
        }
    }
}
