//! Weighted points on common axes, side by side: distributions that particles stand for.

use super::canvas::{Anchor, Canvas, Frame, Pixel, Style};
use super::chart::{label, ticks};
use super::colour::{GRID, INK, PANEL, PAPER, QUIET, ROTATION, TRANSLATION, TRUTH};
use super::drawing::{Drawing, PictureError};

/// One distribution.
#[derive(Clone, Debug, PartialEq)]
pub struct Cloud {
    /// Above it.
    pub title: String,
    /// Below the title: what came of it.
    pub note: String,
    /// Places on both axes and their weights. The heavier, the darker; the heaviest of each cloud is
    /// as dark as can be.
    pub points: Vec<([f64; 2], f64)>,
    /// Whether it is the one to look at.
    pub chosen: bool,
}

/// Clouds with one pair of axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Scatter {
    /// The headline.
    pub title: String,
    /// What the horizontal axis says.
    pub across: String,
    /// What the vertical axis says.
    pub up: String,
    /// From left to right.
    pub clouds: Vec<Cloud>,
    /// A place to mark in all of them.
    pub mark: [f64; 2],
}

/// Width and height of a panel and the height of the headline, pixels.
const SIZE: (f32, f32) = (430.0, 480.0);
const HEAD: f32 = 60.0;

/// Panels in one picture at most.
const MOST: usize = 8;

/// Draws the clouds. Points that are not finite are left out; so are
/// clouds beyond the eighth.
///
/// # Errors
/// When the picture cannot be made, see [`PictureError`].
pub fn render(scatter: &Scatter) -> Result<Drawing, PictureError> {
    let clouds = &scatter.clouds[..scatter.clouds.len().min(MOST)];
    let width = clouds.len().max(1) as f32 * SIZE.0;
    let mut canvas = Canvas::new(width as u32, (HEAD + SIZE.1) as u32, PAPER)?;
    let headline = Style::new(22.0, INK).bold();
    let title = canvas.fitted(headline, &scatter.title, width - 40.0);
    canvas.text([20.0, 38.0], headline, &title);
    let ends = [0, 1].map(|axis| {
        let all = clouds.iter().flat_map(|c| c.points.iter().map(|p| p.0[axis]));
        let all = all.chain([scatter.mark[axis]]).filter(|v| v.is_finite());
        let (low, high) = all
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        let room = (0.05 * (high - low)).max(1e-9);
        if low <= high { (low - room, high + room) } else { (0.0, 1.0) }
    });
    for (i, cloud) in clouds.iter().enumerate() {
        let frame = Frame { left: i as f32 * SIZE.0, top: HEAD, width: SIZE.0, height: SIZE.1 };
        draw(&mut canvas, &frame.inset(10.0, 4.0, 10.0, 10.0), scatter, cloud, ends);
    }
    Ok(canvas.finish())
}

fn draw(canvas: &mut Canvas, frame: &Frame, all: &Scatter, cloud: &Cloud, ends: [(f64, f64); 2]) {
    canvas.fill_card(frame, 10.0, PANEL);
    let tint = if cloud.chosen { ROTATION } else { TRANSLATION };
    let (title, note) = (Style::new(17.0, INK).bold(), Style::new(13.0, QUIET));
    let fitted = canvas.fitted(title, &cloud.title, frame.width - 32.0);
    canvas.text([frame.left + 16.0, frame.top + 28.0], title, &fitted);
    let fitted = canvas.fitted(note, &cloud.note, frame.width - 32.0);
    canvas.text([frame.left + 16.0, frame.top + 50.0], note, &fitted);
    let within = frame.inset(54.0, 84.0, 20.0, 52.0);
    let pixel = |p: [f64; 2]| -> Pixel {
        let share = |v: f64, (a, b): (f64, f64)| ((v - a) / (b - a)) as f32;
        [
            within.left + within.width * share(p[0], ends[0]),
            within.bottom() - within.height * share(p[1], ends[1]),
        ]
    };
    canvas.text([frame.left + 16.0, within.top - 10.0], note, &all.up);
    for value in ticks(ends[1].0, ends[1].1, 5) {
        let [_, y] = pixel([ends[0].0, value]);
        canvas.line(&[[within.left, y], [within.right(), y]], 1.0, GRID);
        canvas.text([within.left - 6.0, y + 4.0], note.anchored(Anchor::End), &label(value));
    }
    for value in ticks(ends[0].0, ends[0].1, 5) {
        let [x, _] = pixel([value, ends[1].0]);
        canvas.line(&[[x, within.top], [x, within.bottom()]], 1.0, GRID);
        let below = [x, within.bottom() + 18.0];
        canvas.text(below, note.anchored(Anchor::Middle), &label(value));
    }
    let middle = [within.left + within.width / 2.0, frame.bottom() - 10.0];
    canvas.text(middle, note.anchored(Anchor::Middle), &all.across);

    let fine = |p: &&([f64; 2], f64)| p.0.iter().all(|v| v.is_finite()) && p.1 > 0.0;
    let mut points: Vec<_> = cloud.points.iter().filter(fine).collect();
    // The heavy ones over the light ones.
    points.sort_by(|a, b| a.1.total_cmp(&b.1));
    let heaviest = points.last().map_or(1.0, |p| p.1);
    for (place, weight) in points {
        let share = (weight / heaviest) as f32;
        canvas.fill_dot(pixel(*place), 2.2 + 1.4 * share, tint.faded(0.04 + 0.5 * share));
    }
    let [x, y] = pixel(all.mark);
    canvas.line(&[[x - 9.0, y], [x + 9.0, y]], 2.0, TRUTH);
    canvas.line(&[[x, y - 9.0], [x, y + 9.0]], 2.0, TRUTH);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clouds_stand_side_by_side_and_nothing_is_drawn_of_nothing() {
        let cloud = |points: Vec<([f64; 2], f64)>| Cloud {
            title: "prior".into(),
            note: String::new(),
            points,
            chosen: false,
        };
        let scatter = |clouds| Scatter {
            title: "poses".into(),
            across: "x, mm".into(),
            up: "y, mm".into(),
            clouds,
            mark: [0.0, 0.0],
        };
        let width = |drawing: &Drawing| drawing.size().0;
        let some = vec![([0.0, 1.0], 0.5), ([f64::NAN, 1.0], 0.5), ([2.0, 3.0], 0.0)];
        let one = render(&scatter(vec![cloud(some.clone())])).unwrap();
        let three =
            render(&scatter(vec![cloud(some.clone()), cloud(some), cloud(vec![])])).unwrap();
        assert_eq!(width(&three), 3 * width(&one));
        assert!(render(&scatter(Vec::new())).is_ok());
    }
}
