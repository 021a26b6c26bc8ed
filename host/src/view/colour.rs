//! Colours and what they mean.

/// Red, green, blue, opacity; 0 to 1, not premultiplied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Colour(pub [f32; 4]);

impl Colour {
    /// Opaque, from 0xRRGGBB.
    pub const fn hex(rgb: u32) -> Self {
        let (r, g, b) = (rgb >> 16 & 0xff, rgb >> 8 & 0xff, rgb & 0xff);
        Self([r as f32 / 255.0, g as f32 / 255.0, b as f32 / 255.0, 1.0])
    }

    /// Between `self` (0) and `other` (1).
    pub fn mixed(self, other: Colour, share: f32) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + (other.0[i] - self.0[i]) * share))
    }

    /// The same with another opacity.
    pub fn faded(self, opacity: f32) -> Self {
        Self([self.0[0], self.0[1], self.0[2], opacity])
    }

    /// As bytes, each clamped; what is not a number is 0.
    pub fn bytes(self) -> [u8; 4] {
        // A cast clamps and makes zero of what is not a number.
        self.0.map(|c| (c * 255.0).round() as u8)
    }

    /// Brighter or darker, opacity kept.
    pub fn lit(self, factor: f32) -> Self {
        let [r, g, b, a] = self.0;
        Self([(r * factor).min(1.0), (g * factor).min(1.0), (b * factor).min(1.0), a])
    }
}

pub(super) const PAPER: Colour = Colour::hex(0xffffff);
pub(super) const PANEL: Colour = Colour::hex(0xf6f7f9);
pub(super) const GRID: Colour = Colour::hex(0xe1e5ea);
pub(super) const INK: Colour = Colour::hex(0x1d2733);
pub(super) const QUIET: Colour = Colour::hex(0x667281);
pub(super) const TRUTH: Colour = Colour::hex(0x1d2733);
pub(super) const UNKNOWN: Colour = Colour::hex(0xa4acb6);
pub(super) const TRANSLATION: Colour = Colour::hex(0x0072b2);
pub(super) const ROTATION: Colour = Colour::hex(0xd55e00);

/// Along a scale of colours, 0 to 1; clamped.
fn along(stops: &[Colour], share: f64) -> Colour {
    let last = stops.len() - 1;
    let at = share.clamp(0.0, 1.0) * last as f64;
    let below = (at as usize).min(last);
    stops[below].mixed(stops[(below + 1).min(last)], (at - below as f64) as f32)
}

/// The colour of a surface's uncertainty: dark blue where certain (0), yellow where not (1), grey where
/// unknown (not a number). Viridis without its darkest fifth, as in the viewer: even in lightness, and
/// the same to the colour-blind.
pub(super) fn uncertainty(share: f64) -> Colour {
    const STOPS: [Colour; 7] = [
        Colour::hex(0x404588),
        Colour::hex(0x33638d),
        Colour::hex(0x277f8e),
        Colour::hex(0x1fa187),
        Colour::hex(0x4ac16d),
        Colour::hex(0xa0da39),
        Colour::hex(0xfde725),
    ];
    if share.is_nan() { UNKNOWN } else { along(&STOPS, share) }
}

/// The colour of a grasp: light pink for the first, dark violet for the last.
pub(super) fn grasp(index: usize, count: usize) -> Colour {
    const STOPS: [Colour; 3] =
        [Colour::hex(0xf5a3d0), Colour::hex(0xb44fc0), Colour::hex(0x3d1278)];
    along(&STOPS, index as f64 / count.saturating_sub(1).max(1) as f64)
}

/// Curves that have a colour of their own.
pub(super) const COLOURS: usize = 8;

/// The colour of one curve among several, told apart by the colour-blind (after Okabe and Ito, 2008);
/// they repeat after [`COLOURS`].
pub(super) fn series(number: usize) -> Colour {
    const SERIES: [Colour; COLOURS] = [
        Colour::hex(0x0072b2),
        Colour::hex(0xd55e00),
        Colour::hex(0x009e73),
        Colour::hex(0xcc79a7),
        Colour::hex(0xe69f00),
        Colour::hex(0x56b4e9),
        Colour::hex(0x4b3f8f),
        Colour::hex(0x4d5966),
    ];
    SERIES[number % SERIES.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_viewer_has_the_same_scale_of_uncertainty() {
        let viewer = include_str!("../../assets/viewer/colour.js");
        let stops: Vec<String> = (0..7)
            .map(|i| {
                let [r, g, b, _] = uncertainty(f64::from(i) / 6.0).bytes();
                format!("\"#{r:02x}{g:02x}{b:02x}\"")
            })
            .collect();
        assert!(viewer.contains(&stops.join(", ")), "{stops:?}");
    }

    #[test]
    fn scales_are_clamped_and_know_nothing_of_nan() {
        assert_eq!(uncertainty(-1.0), uncertainty(0.0));
        assert_eq!(uncertainty(7.0), uncertainty(1.0));
        assert_eq!(uncertainty(f64::NAN), UNKNOWN);
        assert_ne!(uncertainty(0.5), uncertainty(0.6));
        assert_eq!(grasp(0, 1), grasp(0, 9));
        assert_ne!(grasp(3, 9), grasp(4, 9));
    }
}
