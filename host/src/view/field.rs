//! A quantity over an unrolled surface, as colours: one map beside another on one scale.

use super::canvas::{Anchor, Canvas, Frame, Style};
use super::chart::{label, ticks};
use super::colour::{self, INK, PAPER, QUIET};
use super::drawing::{Drawing, PictureError};
use super::summary::{bar, scale_end};

/// A quantity at the nodes of a regular grid.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Above the map: what it shows.
    pub title: String,
    /// Below the title: what came of it.
    pub note: String,
    /// Metres at each node, along the vertical axis first (its first rows at the top); NaN where
    /// unknown. Missing ones count as unknown.
    pub values: Vec<f64>,
}

/// Maps of the same nodes.
#[derive(Clone, Debug, PartialEq)]
pub struct Fields {
    /// Above all.
    pub title: String,
    /// What the horizontal axis says, from and to what, nodes.
    pub across: (String, f64, f64, usize),
    /// The same of the vertical axis, from top to bottom.
    pub down: (String, f64, f64, usize),
    /// Places that are marked, in the units of the axes: across, down.
    pub marks: Vec<[f64; 2]>,
    /// Side by side.
    pub maps: Vec<Field>,
}

/// Width and height of a map, pixels; its margins; above and below all maps.
const MAP: (f32, f32) = (380.0, 460.0);
const MARGIN: (f32, f32) = (76.0, 40.0);
const HEAD: f32 = 150.0;
const FOOT: f32 = 120.0;

/// Maps in a picture, and nodes along an axis, at most.
const MOST: usize = 6;
const NODES: usize = 500;

/// Draws the maps and returns the picture. Maps beyond the sixth are left out.
///
/// # Errors
/// When the picture cannot be made, see [`PictureError`].
pub fn render(fields: &Fields) -> Result<Drawing, PictureError> {
    let maps = &fields.maps[..fields.maps.len().min(MOST)];
    let width = MARGIN.0 + maps.len().max(1) as f32 * (MAP.0 + MARGIN.1 + MARGIN.0 / 2.0);
    let mut canvas = Canvas::new(width as u32, (HEAD + MAP.1 + FOOT) as u32, PAPER)?;
    let headline = Style::new(24.0, INK).bold();
    let title = canvas.fitted(headline, &fields.title, width - 40.0);
    canvas.text([20.0, 44.0], headline, &title);
    let known: Vec<f64> = maps.iter().flat_map(|m| m.values.iter().copied()).collect();
    let end = scale_end(&known);
    for (i, map) in maps.iter().enumerate() {
        let left = MARGIN.0 + i as f32 * (MAP.0 + MARGIN.1 + MARGIN.0 / 2.0);
        let frame = Frame { left, top: HEAD, width: MAP.0, height: MAP.1 };
        draw(&mut canvas, &frame, fields, map, end);
    }
    let (left, top) = (MARGIN.0, HEAD + MAP.1 + 70.0);
    bar(&mut canvas, Frame { left, top, width: 260.0, height: 14.0 }, colour::uncertainty);
    let text = format!("0 to {} mm, yellow also beyond", label(end * 1e3));
    canvas.text([left + 276.0, top + 13.0], Style::new(14.0, QUIET), &text);
    Ok(canvas.finish())
}

fn draw(canvas: &mut Canvas, frame: &Frame, fields: &Fields, map: &Field, end: f64) {
    let (title, note) = (Style::new(17.0, INK).bold(), Style::new(14.0, QUIET));
    let fitted = canvas.fitted(title, &map.title, frame.width);
    canvas.text([frame.left, frame.top - 50.0], title, &fitted);
    let fitted = canvas.fitted(note, &map.note, frame.width);
    canvas.text([frame.left, frame.top - 28.0], note, &fitted);
    let (across, down) = (&fields.across, &fields.down);
    let (columns, rows) = (across.3.clamp(1, NODES), down.3.clamp(1, NODES));
    let (wide, high) = (frame.width as usize, frame.height as usize);
    let shade = |pixel: usize| {
        let (row, column) = (pixel / wide * rows / high, pixel % wide * columns / wide);
        let value = map.values.get(row * columns + column).copied().unwrap_or(f64::NAN);
        colour::uncertainty(value / end).0
    };
    let pixels: Vec<[f32; 4]> = (0..wide * high).map(shade).collect();
    canvas.overlay(frame.left, frame.top, wide as u32, &pixels);
    // Nodes are in the middle of their cells.
    let place = |value: f64, axis: &(String, f64, f64, usize), count: usize| {
        let share = (value - axis.1) / (axis.2 - axis.1);
        ((share * (count - 1) as f64 + 0.5) / count as f64) as f32
    };
    let x = |value: f64| frame.left + frame.width * place(value, across, columns);
    let y = |value: f64| frame.top + frame.height * place(value, down, rows);
    let style = Style::new(13.0, QUIET);
    for tick in ticks(across.1, across.2, 6) {
        let at = [x(tick), frame.bottom() + 20.0];
        canvas.text(at, style.anchored(Anchor::Middle), &label(tick));
    }
    for tick in ticks(down.1, down.2, 6) {
        let at = [frame.left - 8.0, y(tick) + 4.5];
        canvas.text(at, style.anchored(Anchor::End), &label(tick));
    }
    let at = [frame.left + frame.width / 2.0, frame.bottom() + 42.0];
    canvas.text(at, style.anchored(Anchor::Middle), &format!("{}; down: {}", across.0, down.0));
    for [a, d] in &fields.marks {
        let at = [x(*a), y(*d)];
        canvas.ring(at, 5.0, 2.6, PAPER);
        canvas.ring(at, 5.0, 1.4, INK);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fields(maps: usize, values: Vec<f64>) -> Fields {
        let map = Field { title: "centroid".into(), note: "1 mm".into(), values };
        Fields {
            title: "Error over the skin".into(),
            across: ("around, °".into(), -90.0, 90.0, 3),
            down: ("along, mm".into(), 0.0, 20.0, 2),
            marks: vec![[0.0, 10.0]],
            maps: vec![map; maps],
        }
    }

    #[test]
    fn colours_follow_the_values() {
        let one = render(&fields(1, vec![1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3])).unwrap();
        let other = render(&fields(1, vec![6e-3, 2e-3, 3e-3, 4e-3, 5e-3, 1e-3])).unwrap();
        assert_ne!(one.png().unwrap(), other.png().unwrap());
        assert_eq!(one, render(&fields(1, vec![1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3])).unwrap());
    }

    #[test]
    fn what_is_missing_is_unknown() {
        for values in [vec![], vec![f64::NAN; 6], vec![f64::INFINITY, 0.0]] {
            assert!(render(&fields(2, values)).is_ok());
        }
        assert!(render(&fields(0, vec![])).is_ok());
        assert!(render(&fields(40, vec![1e-3; 6])).unwrap().png().is_ok());
        let mut degenerate = fields(1, vec![1e-3]);
        degenerate.across = (String::new(), 1.0, 1.0, 0);
        degenerate.marks = vec![[f64::NAN, f64::INFINITY]];
        assert!(render(&degenerate).unwrap().png().is_ok());
    }
}
