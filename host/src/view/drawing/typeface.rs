//! The bundled typeface, DejaVu Sans: how wide a text is, and the outlines of its letters.

use ab_glyph::{Font, FontRef, GlyphId, Outline};

use super::PictureError;
use crate::view::canvas::Style;

/// Regular and bold.
pub(in crate::view) struct Typeface {
    regular: FontRef<'static>,
    bold: FontRef<'static>,
}

/// A letter of a text: how far from the text's start, and its outline in font units, y upwards.
pub(super) struct Letter {
    pub offset: f32,
    pub outline: Option<Outline>,
}

impl Typeface {
    pub fn new() -> Result<Self, PictureError> {
        let font = |bytes| FontRef::try_from_slice(bytes).map_err(|_| PictureError::Font);
        Ok(Typeface { regular: font(dejavu::sans::regular())?, bold: font(dejavu::sans::bold())? })
    }

    fn font(&self, style: Style) -> &FontRef<'static> {
        if style.bold { &self.bold } else { &self.regular }
    }

    /// Pixels per font unit.
    pub fn scale(&self, style: Style) -> f32 {
        style.size / self.font(style).units_per_em().unwrap_or(2048.0)
    }

    fn advance(&self, style: Style, glyph: GlyphId) -> f32 {
        self.font(style).h_advance_unscaled(glyph) * self.scale(style)
    }

    /// Pixels.
    pub fn width(&self, style: Style, text: &str) -> f32 {
        text.chars().map(|c| self.advance(style, self.font(style).glyph_id(c))).sum()
    }

    /// The letters of a text one after the other.
    pub(super) fn letters(&self, style: Style, text: &str) -> Vec<Letter> {
        let font = self.font(style);
        let mut offset = 0.0;
        text.chars()
            .map(|c| {
                let glyph = font.glyph_id(c);
                let letter = Letter { offset, outline: font.outline(glyph) };
                offset += self.advance(style, glyph);
                letter
            })
            .collect()
    }
}
