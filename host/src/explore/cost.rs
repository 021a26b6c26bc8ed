//! What a grasp costs: the time to get there and to close, and the time lost where it meets nothing.

use std::str::FromStr;

use super::placement::Placement;
use super::prediction::Expected;

/// Seconds that an action takes.
///
/// ```
/// use tactile_host::explore::Cost;
///
/// let cost: Cost = "action=5,travel=20,turn=3,miss=5".parse()?;
/// assert_eq!((cost.action, cost.travel, cost.turn, cost.miss), (5.0, 20.0, 3.0, 5.0));
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// To close on the object, to feel and to open again, seconds; above zero.
    pub action: f64,
    /// To move the hand's middle, seconds per metre from the last placement.
    pub travel: f64,
    /// To turn the palm, seconds per radian from the last placement.
    pub turn: f64,
    /// To recover where no finger met anything, seconds.
    pub miss: f64,
}

impl Default for Cost {
    /// 5 s for a grasp, 20 s for a metre, 3 s for a radian, 5 s for a miss: an arm that moves slowly
    /// near an object it does not know.
    fn default() -> Self {
        Cost { action: 5.0, travel: 20.0, turn: 3.0, miss: 5.0 }
    }
}

impl Cost {
    /// Seconds from one placement to the next and for the grasp there, both in the object's frame.
    /// Nothing is said of the way to the first.
    pub fn between(&self, from: Option<&Placement>, to: &Placement) -> f64 {
        let way = from.map_or(0.0, |from| {
            let moved = to.hand.translation.vector - from.hand.translation.vector;
            self.travel * moved.norm() + self.turn * from.hand.rotation.angle_to(&to.hand.rotation)
        });
        self.action + way
    }

    /// The same and what recovering costs, times the chance that it is needed.
    pub fn expected(&self, from: Option<&Placement>, to: &Placement, felt: &[Expected]) -> f64 {
        self.between(from, to) + self.miss * chance_of_nothing(felt)
    }
}

/// The chance that no finger meets anything, each finger's luck being its own.
pub fn chance_of_nothing(felt: &[Expected]) -> f64 {
    felt.iter().map(|e| 1.0 - e.chance.clamp(0.0, 1.0)).product()
}

impl FromStr for Cost {
    type Err = String;

    /// `action=SECONDS,travel=SECONDS_PER_METRE,turn=SECONDS_PER_RADIAN,miss=SECONDS`, what is left out
    /// as in [`Cost::default`].
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let mut cost = Cost::default();
        let mut named = Vec::new();
        for part in text.split(',') {
            let wrong = || {
                format!(
                    "expected action=SECONDS, travel=SECONDS_PER_METRE, turn=SECONDS_PER_RADIAN or \
                     miss=SECONDS, separated by commas, found {part:?}"
                )
            };
            let (name, value) = part.split_once('=').ok_or_else(wrong)?;
            let value: f64 = value.trim().parse().map_err(|_| wrong())?;
            if !(value.is_finite() && value >= 0.0) {
                return Err(format!("{name}: expected a number of seconds, found {value}"));
            }
            let name = name.trim();
            if named.contains(&name) {
                return Err(format!("{name}: expected once, found twice"));
            }
            named.push(name);
            match name {
                "action" if value > 0.0 => cost.action = value,
                "action" => return Err("action: a grasp takes some time".into()),
                "travel" => cost.travel = value,
                "turn" => cost.turn = value,
                "miss" => cost.miss = value,
                _ => return Err(wrong()),
            }
        }
        Ok(cost)
    }
}

impl std::fmt::Display for Cost {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Cost { action, travel, turn, miss } = self;
        write!(f, "action={action},travel={travel},turn={turn},miss={miss}")
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, UnitQuaternion};

    use super::*;
    use crate::space::{Point, Pose};

    fn at(x: f64, turn: f64) -> Placement {
        let turn = UnitQuaternion::from_axis_angle(&nalgebra::Vector3::z_axis(), turn);
        Placement { hand: Pose::from_parts(Translation3::new(x, 0.0, 0.0), turn), spread: 1.0 }
    }

    #[test]
    fn far_and_turned_costs_more_and_the_first_costs_the_grasp_alone() {
        let cost = Cost { action: 2.0, travel: 10.0, turn: 1.0, miss: 4.0 };
        assert_eq!(cost.between(None, &at(1.0, 1.0)), 2.0);
        assert!((cost.between(Some(&at(0.0, 0.0)), &at(0.1, -0.5)) - 3.5).abs() < 1e-12);
        let e = |chance| Expected { finger: 0, point: Point::x(), normal: Point::x(), chance };
        assert!((chance_of_nothing(&[e(0.5), e(0.8)]) - 0.1).abs() < 1e-12);
        assert_eq!(chance_of_nothing(&[]), 1.0);
        assert!((cost.expected(None, &at(0.0, 0.0), &[e(0.5)]) - 4.0).abs() < 1e-12);
    }

    #[test]
    fn costs_come_back_as_text_and_wrong_ones_are_named() {
        let cost: Cost = "travel=1.5, turn=0".parse().unwrap();
        assert_eq!(cost, Cost { travel: 1.5, turn: 0.0, ..Cost::default() });
        assert_eq!(cost.to_string().parse::<Cost>().unwrap(), cost);
        for (text, says) in [
            ("", "separated by commas"),
            ("travel", "found \"travel\""),
            ("trave=1", "found \"trave=1\""),
            ("turn=fast", "turn=fast"),
            ("turn=-1", "turn"),
            ("miss=inf", "miss"),
            ("action=0", "takes some time"),
            ("action=5,turn=1, action=600", "action: expected once"),
        ] {
            let error = text.parse::<Cost>().unwrap_err();
            assert!(error.contains(says), "{text}: {error}");
        }
    }
}
