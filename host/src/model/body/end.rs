//! Where a turned body ends that nobody touched there.

/// Lengths of what was felt, or usual distances of an end where those are more, beyond which no end is looked
/// for, and places that are tried.
const FARTHEST: f64 = 3.0;
const PLACES: u32 = 1000;

/// Usual distance of an end from the middle of the contacts and its deviation, in radii of the ball about
/// them.
pub(super) const USUAL: (f64, f64) = (1.0, super::fit::SHAPE);

/// Deviations beyond that distance, from which a side that was felt there is known to be longer than usual.
const TOLD: f64 = 0.5;

/// The side of a turned body towards such an end, in radii of the ball about the contacts.
#[derive(Clone, Copy, Debug)]
pub(super) struct Side {
    /// Radius at zero, and how much wider it gets per length.
    pub(super) radius: f64,
    pub(super) widening: f64,
    /// First and last place along it where it was felt.
    pub(super) low: f64,
    pub(super) high: f64,
    /// How many times as probable a tip is, where it narrows, as that it is cut off before.
    pub(super) pointed: f64,
}

impl Side {
    fn wide(&self, at: f64) -> f64 {
        (self.radius + self.widening * at).max(0.0)
    }

    /// Surface of the body that ends there, over π: both ends and the side.
    pub(super) fn area(&self, at: f64) -> f64 {
        let (low, high) = (self.wide(self.low), self.wide(at));
        let slant = 1.0_f64.hypot(self.widening) * (at - self.low);
        low.powi(2) + high.powi(2) + (low + high) * slant
    }

    /// Where it ends, and the deviation of all its ends from there, when so many contacts fell anywhere on its surface
    /// alike: each end is the less likely the larger that is. Before them, a side that narrows ends in its tip or is
    /// cut off before, and a cut is anywhere as far from `middle` as ends usually are: where it was felt well beyond
    /// that, about as far as there, and in proportion less certainly. `None` where numbers are none.
    ///
    /// It ends in its tip where that is more probable than all cuts, and else at their mean: between them is hardly
    /// any body, and a tip far away that is improbable would draw the mean of all to it. Of cuts the mean, since two
    /// ends across that nobody felt share what the shape is aligned by.
    pub(super) fn end(&self, contacts: usize, middle: f64) -> Option<(f64, f64)> {
        let tip = if self.widening < 0.0 { -self.radius / self.widening } else { f64::INFINITY };
        // Contacts all at one height do not say that it is thin.
        let farthest = FARTHEST * (self.high - self.low).max(USUAL.0);
        let tip = tip.max(self.high);
        let room = (tip - self.high).min(farthest);
        let usual = USUAL.0.max(self.high - middle - TOLD * USUAL.1);
        let deviation = USUAL.1 * usual / USUAL.0;
        let likelihood = |at: f64| (self.area(self.high) / self.area(at)).powf(contacts as f64);
        let cuts = (0..PLACES).map(|step| {
            let at = self.high + room * (f64::from(step) + 0.5) / f64::from(PLACES);
            let odd = (at - middle - usual) / deviation;
            (at, (-0.5 * odd * odd).exp())
        });
        let before: f64 = cuts.clone().map(|(_, prior)| prior).sum();
        let cuts = cuts.map(|(at, prior)| (at, likelihood(at) * prior / before));
        let pointed = (tip <= self.high + farthest).then(|| (tip, self.pointed * likelihood(tip)));
        let [weight, first] = [0, 1]
            .map(|power| cuts.clone().map(|(at, weight)| at.powi(power) * weight).sum::<f64>());
        let end = match pointed {
            Some((tip, odds)) if odds > weight => tip,
            _ => first / weight,
        };
        let all = cuts.chain(pointed);
        let [sum, square] = [0, 2].map(|power| {
            all.clone().map(|(at, weight)| (at - end).powi(power) * weight).sum::<f64>()
        });
        let deviation = (square / sum).sqrt();
        (end.is_finite() && deviation.is_finite()).then_some((end, deviation))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAN: Side = Side { radius: 0.7, widening: 0.0, low: -0.7, high: 0.6, pointed: 1.0 };

    #[test]
    fn more_contacts_know_better_where_a_can_ends() {
        let [few, many] = [6, 60].map(|contacts| CAN.end(contacts, 0.0).unwrap());
        assert!(few.0 > many.0 && many.0 > CAN.high);
        assert!(few.1 > 2.0 * many.1);
        // Of a surface that grows in proportion to its length: mean and deviation of an exponential.
        let mean = CAN.area(CAN.high) / (60.0 * 2.0 * CAN.radius);
        assert!(((many.0 - CAN.high) / mean - 1.0).abs() < 0.1, "{many:?}");
        assert!((many.1 / mean - 1.0).abs() < 0.1, "{many:?}");
    }

    #[test]
    fn a_cone_is_pointed_as_often_as_not() {
        let cone = Side { radius: 0.6, widening: -0.8, low: -0.6, high: 0.5, pointed: 1.0 };
        let tip = 0.75;
        let (end, deviation) = cone.end(10, 0.0).unwrap();
        assert!((0.6..tip).contains(&end) && end + deviation > tip - 0.05, "{end} {deviation}");
        // Where few are cut off.
        let pyramid = Side { pointed: 20.0, ..cone }.end(10, 0.0).unwrap();
        assert!((pyramid.0 - tip).abs() < 1e-9 && pyramid.1 < 0.7 * deviation, "{pyramid:?}");
        // A tip far beyond the contacts, probable as it is, does not draw the end to it; it is in doubt.
        let draught = Side { radius: 1.0, widening: -0.25, low: -1.0, high: 1.0, pointed: 1.0 };
        let (end, deviation) = draught.end(10, 0.0).unwrap();
        assert!((1.2..1.5).contains(&end) && deviation > 0.8, "{end} {deviation}");
        // Felt at the tip, or by error beyond.
        for high in [tip, 0.8] {
            let (end, deviation) = Side { high, ..cone }.end(10, 0.0).unwrap();
            assert!((end - high).abs() < 1e-9 && deviation < 1e-9);
        }
        // A tip far away is none.
        let cup = Side { widening: -0.1, ..CAN };
        assert!(cup.end(10, 0.0).unwrap().0 < 1.2);
    }

    #[test]
    fn contacts_at_one_height_do_not_say_how_long_it_is() {
        for high in [0.0, 0.03, 0.3] {
            let can = Side { radius: 0.95, low: -high, high, ..CAN };
            let (end, deviation) = can.end(5, 0.0).unwrap();
            assert!((0.35..0.45).contains(&(end - high)), "{high} {end}");
            assert!((0.3..0.4).contains(&deviation), "{high} {deviation}");
        }
    }

    #[test]
    fn the_farther_a_rod_was_felt_the_farther_beyond_it_ends() {
        let rod = |high: f64| Side { radius: 0.1, low: -high, high, ..CAN }.end(5, 0.0).unwrap();
        let ((short, _), (long, deviation)) = (rod(1.0), rod(4.0));
        // Nearly in proportion: the ball about the contacts is as large for both.
        let ratio = (long - 4.0) / (short - 1.0);
        assert!((2.0..4.0).contains(&ratio), "{ratio}");
        assert!(deviation > 0.5 * (long - 4.0), "{deviation}");
    }

    #[test]
    fn what_is_no_number_has_no_end() {
        for side in [
            Side { radius: f64::NAN, ..CAN },
            Side { high: f64::INFINITY, ..CAN },
            Side { radius: 0.0, ..CAN },
            Side { low: f64::INFINITY, high: f64::NEG_INFINITY, ..CAN },
        ] {
            assert_eq!(side.end(10, 0.0), None, "{side:?}");
        }
        assert_eq!(CAN.end(10, 1e3), None);
        assert!(CAN.end(0, 0.0).unwrap().0.is_finite());
    }
}
