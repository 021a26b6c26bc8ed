//! Numbers as text, fast: the bulk of a big file is decimal numbers of a few digits.

/// What std makes of `word`, bit for bit; most words in a third of the time.
///
/// A decimal of at most 2⁵³ with a power of ten of at most 22 has both exactly in a double, so that one
/// multiplication or division rounds it correctly (Clinger, "How to read floating point numbers
/// accurately", 1990). Everything else is left to std.
pub(super) fn parse(word: &[u8]) -> Option<f64> {
    short(word).or_else(|| std::str::from_utf8(word).ok()?.parse().ok())
}

/// Powers of ten that a double holds exactly.
const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16,
    1e17, 1e18, 1e19, 1e20, 1e21, 1e22,
];

fn short(word: &[u8]) -> Option<f64> {
    let (negative, word) = match word {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        _ => (false, word),
    };
    // 19 digits fit into 64 bits.
    let (mut mantissa, mut digits, mut decimals, mut point) = (0u64, 0, 0, false);
    let mut rest = word;
    while let [byte, tail @ ..] = rest {
        match byte {
            b'0'..=b'9' => {
                mantissa = mantissa.wrapping_mul(10).wrapping_add(u64::from(byte - b'0'));
                // Zeros in front do not count.
                digits += i32::from(digits > 0 || *byte != b'0');
                decimals += i32::from(point);
            }
            b'.' if !point => point = true,
            _ => break,
        }
        rest = tail;
    }
    let any_digit = word.len() - rest.len() > usize::from(point);
    let exponent = match rest {
        [] => 0,
        [b'e' | b'E', rest @ ..] => exponent(rest)?,
        _ => return None,
    };
    let power = exponent - decimals;
    if !any_digit || digits > 19 || mantissa > 1 << 53 {
        return None;
    }
    let scale = *POWERS.get(power.unsigned_abs() as usize)?;
    let magnitude = if power < 0 { mantissa as f64 / scale } else { mantissa as f64 * scale };
    Some(if negative { -magnitude } else { magnitude })
}

/// A power of ten of at most three digits.
fn exponent(word: &[u8]) -> Option<i32> {
    let (sign, digits) = match word {
        [b'-', rest @ ..] => (-1, rest),
        [b'+', rest @ ..] => (1, rest),
        _ => (1, word),
    };
    if digits.is_empty() || digits.len() > 3 || !digits.iter().all(u8::is_ascii_digit) {
        return None;
    }
    Some(sign * digits.iter().fold(0, |n, d| 10 * n + i32::from(d - b'0')))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn same(word: &str) -> Result<(), TestCaseError> {
        let (ours, std) = (parse(word.as_bytes()), word.parse::<f64>().ok());
        prop_assert_eq!(ours.map(f64::to_bits), std.map(f64::to_bits), "{}", word);
        Ok(())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn decimals_are_read_as_std_reads_them(word in "[+-]?[0-9]{0,12}\\.?[0-9]{0,12}([eE][+-]?[0-9]{1,4})?") {
            same(&word)?;
        }

        #[test]
        fn numbers_are_read_as_they_were_written(bits: u64) {
            let x = f64::from_bits(bits);
            same(&format!("{x}"))?;
            same(&format!("{x:e}"))?;
            same(&format!("{x:.6}"))?;
        }

        #[test]
        fn words_are_what_they_are_to_std(word in "[-+.eE0-9infa]{0,8}") {
            same(&word)?;
        }
    }

    #[test]
    fn the_edges_of_the_short_way_are_exact() {
        for word in [
            "",
            "-",
            ".",
            "-.",
            "e5",
            ".e5",
            "1.",
            ".5",
            "-0",
            "0e999",
            "1e22",
            "1e23",
            "1e-22",
            "1e-23",
            "9007199254740992",
            "9007199254740993",
            "9007199254740993e-1",
            "18446744073709551616",
            "00000000000000000000000000001",
            "0.00000000000000000000000000001",
            "1e",
            "1e+",
            "1e0005",
            "1..2",
            "1e5.",
            "١",
            "1_0",
        ] {
            same(word).unwrap();
        }
    }
}
