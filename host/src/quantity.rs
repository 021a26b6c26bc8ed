//! Quantities with units, as the command line takes them: `1mm`, `0.12m`, `5deg`, `0.1rad`,
//! `10mm,20deg`. Plain numbers are SI, a unit of the wrong kind is refused, and what comes out is
//! metres and radians.
//!
//! Every function here is a clap value parser: `#[arg(value_parser = quantity::length)]`.

/// Deviations beyond these, a metre and a whole turn, are another unit or a slip of the pen, and
/// would make logs that no reader takes.
const MOST_LENGTH: f64 = 1.0;
const MOST_ANGLE: f64 = std::f64::consts::TAU;

/// Units of length in metres. Longer names first where one ends in another.
const LENGTHS: [(&str, f64); 5] =
    [("mm", 1e-3), ("cm", 1e-2), ("um", 1e-6), ("µm", 1e-6), ("m", 1.0)];

/// Units of angle in radians.
const ANGLES: [(&str, f64); 4] = [
    ("deg", std::f64::consts::PI / 180.0),
    ("°", std::f64::consts::PI / 180.0),
    ("mrad", 1e-3),
    ("rad", 1.0),
];

/// Why a text is not the quantity asked for.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected {expected}, found {found}")]
pub struct QuantityError {
    /// What would have been right, with an example.
    pub expected: String,
    /// What is there.
    pub found: String,
}

/// Standard deviations of a position and of a direction, or of a translation and a rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deviation {
    /// Metres per axis, not negative.
    pub length: f64,
    /// Radians per axis, not negative.
    pub angle: f64,
}

/// How far something was moved and how much turned, whatever the direction and the axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Displacement {
    /// Metres, not negative.
    pub length: f64,
    /// Radians, not negative.
    pub angle: f64,
}

impl std::fmt::Display for Displacement {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Displacement { length, angle } = *self;
        Deviation { length, angle }.fmt(f)
    }
}

impl std::fmt::Display for Deviation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // Rounded far below any sensor, so that 0.01 m reads 10mm and not 10.000000000000002mm.
        let rounded = |x: f64| (x * 1e9).round() / 1e9;
        let (mm, deg) = (rounded(self.length * 1e3), rounded(self.angle.to_degrees()));
        write!(f, "{mm}mm,{deg}deg")
    }
}

/// A kind of quantity.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Length,
    Angle,
}

impl Kind {
    fn units(self) -> &'static [(&'static str, f64)] {
        match self {
            Kind::Length => &LENGTHS,
            Kind::Angle => &ANGLES,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Kind::Length => "a length such as 1mm, 0.12m or 0.12 (metres)",
            Kind::Angle => "an angle such as 5deg, 0.1rad or 0.1 (radians)",
        }
    }
}

fn wrong(expected: impl Into<String>, found: impl Into<String>) -> QuantityError {
    QuantityError { expected: expected.into(), found: found.into() }
}

/// The number and its unit, in SI; any sign, but finite.
fn signed(text: &str, kind: Kind) -> Result<f64, QuantityError> {
    let trimmed = text.trim();
    // The unit is what follows the last digit, so that exponents stay with the number.
    let digits = trimmed.rfind(|c: char| c.is_ascii_digit() || c == '.').map_or(0, |i| i + 1);
    let (number, unit) = trimmed.split_at(digits);
    let unit = unit.trim_start();
    let quoted = || format!("{text:?}");
    let number: f64 = number.parse().map_err(|_| wrong(kind.name(), quoted()))?;
    let scale = if unit.is_empty() {
        1.0
    } else if let Some((_, scale)) = kind.units().iter().find(|(name, _)| *name == unit) {
        *scale
    } else {
        let other = if kind == Kind::Length { Kind::Angle } else { Kind::Length };
        let found = if other.units().iter().any(|(name, _)| *name == unit) {
            let is = if other == Kind::Length { "a length" } else { "an angle" };
            format!("{text:?}, which is {is}")
        } else {
            let known: Vec<_> = kind.units().iter().map(|(name, _)| *name).collect();
            format!("{text:?}; its unit {unit:?} is none of {}", known.join(", "))
        };
        return Err(wrong(kind.name(), found));
    };
    let value = number * scale;
    if value.is_finite() { Ok(value) } else { Err(wrong("a finite quantity", quoted())) }
}

fn not_negative(text: &str, kind: Kind) -> Result<f64, QuantityError> {
    match signed(text, kind)? {
        value if value >= 0.0 => Ok(value),
        _ => Err(wrong(format!("{}, not negative", kind.name()), format!("{text:?}"))),
    }
}

/// A length in metres, zero or more.
///
/// # Errors
/// When the text is no number, has an unknown unit or one of another kind, or is negative.
pub fn length(text: &str) -> Result<f64, QuantityError> {
    not_negative(text, Kind::Length)
}

/// A length in metres, above zero.
///
/// # Errors
/// As [`length`], and for zero.
pub fn positive_length(text: &str) -> Result<f64, QuantityError> {
    match length(text)? {
        value if value > 0.0 => Ok(value),
        _ => Err(wrong(format!("{}, above zero", Kind::Length.name()), format!("{text:?}"))),
    }
}

/// An angle in radians, zero or more: a size or a standard deviation.
///
/// # Errors
/// As [`length`].
pub fn angle(text: &str) -> Result<f64, QuantityError> {
    not_negative(text, Kind::Angle)
}

/// A coordinate in metres, of either sign.
///
/// # Errors
/// As [`length`], but negative values are fine.
pub fn coordinate(text: &str) -> Result<f64, QuantityError> {
    signed(text, Kind::Length)
}

/// A turn in radians, of either sign.
///
/// # Errors
/// As [`angle`], but negative values are fine.
pub fn turn(text: &str) -> Result<f64, QuantityError> {
    signed(text, Kind::Angle)
}

/// A length and an angle, such as `1mm,5deg`.
///
/// # Errors
/// When there are not exactly two, beyond 1 m or a whole turn, or as [`length`] and [`angle`].
pub fn deviation(text: &str) -> Result<Deviation, QuantityError> {
    let (length, angle) = length_and_angle(text)?;
    Ok(Deviation { length, angle })
}

/// A displacement such as `300mm,60deg`.
///
/// # Errors
/// As of [`deviation`].
pub fn displacement(text: &str) -> Result<Displacement, QuantityError> {
    let (length, angle) = length_and_angle(text)?;
    Ok(Displacement { length, angle })
}

fn length_and_angle(text: &str) -> Result<(f64, f64), QuantityError> {
    let parts: Vec<&str> = text.split(',').collect();
    let [first, second] = parts[..] else {
        return Err(wrong("a length and an angle such as 10mm,20deg", format!("{text:?}")));
    };
    let (length, angle) = (length(first)?, angle(second)?);
    if length > MOST_LENGTH || angle > MOST_ANGLE {
        return Err(wrong("a length and an angle up to 1 m and 360°", format!("{text:?}")));
    }
    Ok((length, angle))
}

/// The size in metres of a unit of length given by its name, such as `mm`.
///
/// # Errors
/// When the unit is not known.
pub fn length_unit(text: &str) -> Result<f64, QuantityError> {
    let found = LENGTHS.iter().find(|(name, _)| *name == text.trim());
    found.map(|(_, scale)| *scale).ok_or_else(|| {
        let known: Vec<_> = LENGTHS.iter().map(|(name, _)| *name).collect();
        wrong(format!("a unit of length ({})", known.join(", ")), format!("{text:?}"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() <= 1e-15 * b.abs()
    }

    #[test]
    fn units_become_si() {
        let lengths = [
            ("1mm", 1e-3),
            ("0.12m", 0.12),
            ("2.5cm", 0.025),
            ("3 um", 3e-6),
            ("3µm", 3e-6),
            ("0.12", 0.12),
            ("1e-3", 1e-3),
            (" 1e2mm ", 0.1),
            (".5m", 0.5),
            ("0", 0.0),
        ];
        for (text, metres) in lengths {
            assert!(close(length(text).unwrap(), metres), "{text}");
        }
        let pi = std::f64::consts::PI;
        for (text, radians) in
            [("180deg", pi), ("90°", pi / 2.0), ("0.1rad", 0.1), ("5mrad", 0.005), ("1", 1.0)]
        {
            assert!(close(angle(text).unwrap(), radians), "{text}");
        }
        let pair = deviation("10mm,20deg").unwrap();
        assert!(close(pair.length, 0.01) && close(pair.angle, pi / 9.0));
        assert_eq!(deviation(" 1 mm , 0.1 ").unwrap(), Deviation { length: 0.001, angle: 0.1 });
        assert_eq!(pair.to_string(), "10mm,20deg");
        assert_eq!((coordinate("-5mm").unwrap(), turn("-1rad").unwrap()), (-0.005, -1.0));
        assert_eq!(length_unit("mm").unwrap(), 1e-3);
    }

    #[test]
    fn wrong_quantities_say_what_was_expected() {
        let refused = |result: Result<f64, QuantityError>, text: &str| {
            let error = result.unwrap_err().to_string();
            assert!(error.contains(text), "{error}");
        };
        refused(length("5deg"), "expected a length such as 1mm");
        refused(length("5deg"), "found \"5deg\", which is an angle");
        refused(angle("5mm"), "found \"5mm\", which is a length");
        refused(length("5parsec"), "its unit \"parsec\" is none of mm, cm, um, µm, m");
        refused(length("-1mm"), "not negative");
        refused(positive_length("0mm"), "above zero");
        refused(length_unit("deg"), "a unit of length");
        for text in ["", "mm", "nan", "inf", "infm", "1..2mm", "--1mm", "one"] {
            refused(length(text), "a length such as 1mm");
        }
        refused(length("1e999m"), "a finite quantity");
        for text in ["10mm", "10mm,20deg,3", "", ",", "20deg,10mm", "-1mm,5deg", "1mm,-5deg"] {
            assert!(deviation(text).is_err(), "{text:?}");
        }
    }

    proptest! {
        #[test]
        fn any_text_gives_a_value_or_an_error(text in ".{0,12}") {
            if let Ok(value) = length(&text) { prop_assert!(value.is_finite() && value >= 0.0); }
            if let Ok(pair) = deviation(&text) { prop_assert!(pair.angle.is_finite()); }
        }

        #[test]
        fn a_deviation_prints_as_it_is_read(mm in 0.0f64..1e3, deg in 0.0f64..180.0) {
            let pair = Deviation { length: mm * 1e-3, angle: deg.to_radians() };
            let back = deviation(&pair.to_string()).unwrap();
            prop_assert!((back.length - pair.length).abs() < 1e-11);
            prop_assert!((back.angle - pair.angle).abs() < 1e-9);
        }
    }
}
