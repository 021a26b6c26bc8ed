//! Curves over a common axis, as the thesis plots errors against the number of contacts: medians as
//! lines, quartiles as bands.

use super::canvas::{Anchor, Canvas, Frame, Pixel, Style};
use super::chart::{label, ticks};
use super::colour::{self, GRID, INK, PANEL, PAPER, QUIET};
use super::drawing::{Drawing, PictureError};

/// A value with its quartiles at one place of the axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// Where on the horizontal axis.
    pub x: f64,
    /// Lower quartile.
    pub low: f64,
    /// Median.
    pub median: f64,
    /// Upper quartile.
    pub high: f64,
}

/// One curve.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// As the legend names it.
    pub name: String,
    /// In order of x.
    pub marks: Vec<Mark>,
}

/// How an axis is divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Evenly.
    Linear,
    /// In decades; only what is above zero can be shown.
    Logarithmic,
}

impl Scale {
    /// Where a value lies along the axis, before it is fitted into the plot.
    pub(super) fn place(self, value: f64) -> f64 {
        match self {
            Scale::Linear => value,
            Scale::Logarithmic if value > 0.0 => value.log10(),
            Scale::Logarithmic => f64::NAN,
        }
    }

    /// Round values between two places.
    pub(super) fn rungs(self, (from, to): (f64, f64)) -> Vec<f64> {
        match self {
            Scale::Linear => ticks(from, to, 6),
            Scale::Logarithmic => rungs((from, to)),
        }
    }
}

/// Curves with one pair of axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Plot {
    /// Above it.
    pub title: String,
    /// What the horizontal axis says.
    pub across: String,
    /// What the vertical axis says.
    pub up: String,
    /// Of the horizontal and of the vertical axis.
    pub scales: [Scale; 2],
    /// Drawn in this order.
    pub curves: Vec<Curve>,
}

/// Width and height of a plot, pixels.
const SIZE: (f32, f32) = (760.0, 520.0);

/// Plots in one picture at most.
const MOST: usize = 48;

/// Draws the plots side by side and returns the picture. Values that the scales
/// cannot show are left out; so are plots beyond the 48th.
///
/// # Errors
/// When the picture cannot be made, see [`PictureError`].
pub fn render(plots: &[Plot]) -> Result<Drawing, PictureError> {
    let plots = &plots[..plots.len().min(MOST)];
    let columns = match plots.len() {
        0..=1 => 1,
        2..=6 => 2,
        7..=18 => 3,
        _ => 4,
    };
    let rows = plots.len().div_ceil(columns).max(1);
    let (width, height) = (columns as f32 * SIZE.0, rows as f32 * SIZE.1);
    let mut canvas = Canvas::new(width as u32, height as u32, PAPER)?;
    for (i, plot) in plots.iter().enumerate() {
        let (left, top) = ((i % columns) as f32 * SIZE.0, (i / columns) as f32 * SIZE.1);
        let frame = Frame { left, top, width: SIZE.0, height: SIZE.1 };
        draw(&mut canvas, &frame.inset(14.0, 14.0, 14.0, 14.0), plot);
    }
    Ok(canvas.finish())
}

/// Both axes' ends, as places on their scales.
struct Axes {
    plot: Frame,
    scales: [Scale; 2],
    x: (f64, f64),
    y: (f64, f64),
}

impl Axes {
    fn new(plot: Frame, scales: [Scale; 2], curves: &[Curve]) -> Option<Axes> {
        let marks = || curves.iter().flat_map(|c| &c.marks).filter(|m| shows(scales, m));
        let [across, up] = scales;
        let ends = |scale: Scale, low: fn(&Mark) -> f64, high: fn(&Mark) -> f64| {
            let least = marks().map(|m| scale.place(low(m))).fold(f64::INFINITY, f64::min);
            let most = marks().map(|m| scale.place(high(m))).fold(f64::NEG_INFINITY, f64::max);
            (least.is_finite() && most.is_finite()).then_some((least, most))
        };
        let widen = |(a, b): (f64, f64), share: f64, least: f64| {
            let room = (share * (b - a)).max(least);
            (a - room, b + room)
        };
        let (x, y) = (ends(across, |m| m.x, |m| m.x)?, ends(up, |m| m.low, |m| m.high)?);
        Some(Axes { plot, scales, x: widen(x, 0.04, 1e-3), y: widen(y, 0.06, 0.05) })
    }

    fn pixel(&self, x: f64, value: f64) -> Pixel {
        let share = |v: f64, (a, b): (f64, f64)| ((v - a) / (b - a)) as f32;
        let [across, up] = self.scales;
        [
            self.plot.left + self.plot.width * share(across.place(x), self.x),
            self.plot.bottom() - self.plot.height * share(up.place(value), self.y),
        ]
    }
}

/// Whether the scales can show it.
fn shows([across, up]: [Scale; 2], mark: &Mark) -> bool {
    let fine = |v: f64| up.place(v).is_finite();
    across.place(mark.x).is_finite() && fine(mark.low) && fine(mark.median) && fine(mark.high)
}

/// 1, 2 and 5 times the powers of ten between the ends.
fn rungs((from, to): (f64, f64)) -> Vec<f64> {
    let powers = (from.floor() as i32)..=(to.ceil() as i32);
    let all = powers.flat_map(|p| [1.0, 2.0, 5.0].map(|f| f * 10f64.powi(p)));
    all.filter(|v| v.log10() >= from && v.log10() <= to).collect()
}

fn draw(canvas: &mut Canvas, frame: &Frame, plot: &Plot) {
    canvas.fill_card(frame, 10.0, PANEL);
    let title = Style::new(18.0, INK).bold();
    canvas.text([frame.left + 22.0, frame.top + 34.0], title, &plot.title);
    let quiet = Style::new(13.0, QUIET);
    canvas.text([frame.left + 22.0, frame.top + 58.0], quiet, &plot.up);
    // Names may need room; the plot leaves it.
    let name = Style::new(14.0, INK);
    let widths = plot.curves.iter().map(|c| canvas.text_width(name, &c.name));
    let names = widths.fold(0.0, f32::max).clamp(110.0, 300.0);
    let within = frame.inset(62.0, 76.0, names + 72.0, 56.0);
    for (number, curve) in plot.curves.iter().enumerate() {
        let (x, y) = (within.right() + 20.0, within.top + 14.0 + 26.0 * number as f32);
        let tint = colour::series(number);
        canvas.line(&[[x, y - 5.0], [x + 26.0, y - 5.0]], 3.0, tint);
        dot(canvas, [x + 13.0, y - 5.0], number);
        let fitted = canvas.fitted(name, &curve.name, names);
        canvas.text([x + 36.0, y], name, &fitted);
    }
    let Some(axes) = Axes::new(within, plot.scales, &plot.curves) else {
        canvas.text([within.left, within.top + 40.0], quiet, "nothing to show");
        return;
    };
    for value in plot.scales[1].rungs(axes.y) {
        let y = axes.pixel(1.0, value)[1];
        canvas.line(&[[within.left, y], [within.right(), y]], 1.0, GRID);
        canvas.text([within.left - 8.0, y + 4.5], quiet.anchored(Anchor::End), &label(value));
    }
    let mut places: Vec<f64> = plot
        .curves
        .iter()
        .flat_map(|c| &c.marks)
        .filter(|m| shows(plot.scales, m))
        .map(|m| m.x)
        .collect();
    places.sort_by(f64::total_cmp);
    places.dedup();
    let widest = places.iter().map(|x| canvas.text_width(quiet, &label(*x))).fold(0.0, f32::max);
    let step = stride(&places, |x| axes.pixel(x, 1.0)[0], widest + 8.0);
    let mut free = f32::NEG_INFINITY;
    for x in places.into_iter().step_by(step) {
        let at = axes.pixel(x, 1.0)[0];
        if at > free {
            let below = [at, within.bottom() + 20.0];
            canvas.text(below, quiet.anchored(Anchor::Middle), &label(x));
            free = at + 8.0 + canvas.text_width(quiet, &label(x));
        }
    }
    let middle = [within.left + within.width / 2.0, frame.bottom() - 14.0];
    canvas.text(middle, quiet.anchored(Anchor::Middle), &plot.across);

    for (number, curve) in plot.curves.iter().enumerate() {
        let tint = colour::series(number);
        let marks: Vec<&Mark> = curve.marks.iter().filter(|m| shows(plot.scales, m)).collect();
        let mut band: Vec<Pixel> = marks.iter().map(|m| axes.pixel(m.x, m.high)).collect();
        band.extend(marks.iter().rev().map(|m| axes.pixel(m.x, m.low)));
        canvas.fill_area(&[band], tint.faded(0.14));
        // A band of one place is none.
        if let [only] = marks.as_slice() {
            let ends = [only.low, only.high].map(|v| axes.pixel(only.x, v));
            canvas.line(&ends, 2.0, tint.faded(0.5));
        }
        let line: Vec<Pixel> = marks.iter().map(|m| axes.pixel(m.x, m.median)).collect();
        canvas.line(&line, 2.6, tint);
        line.iter().for_each(|p| dot(canvas, *p, number));
    }
}

/// A mark of a series; who has no colour of its own has dots of its own.
pub(super) fn dot(canvas: &mut Canvas, at: Pixel, series: usize) {
    canvas.fill_dot(at, 4.0, colour::series(series));
    if series >= colour::COLOURS {
        canvas.fill_dot(at, 2.2, PAPER);
    }
}

/// Of places an even distance apart every so many are named, such that each name has `room` pixels; of
/// others each that has room.
fn stride(places: &[f64], pixel: impl Fn(f64) -> f32, room: f32) -> usize {
    let apart: Vec<f32> = places.windows(2).map(|two| pixel(two[1]) - pixel(two[0])).collect();
    match apart.first() {
        Some(&first) if first > 0.0 && apart.iter().all(|gap| (gap - first).abs() < 0.5) => {
            (room / first).ceil().max(1.0) as usize
        }
        _ => 1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DECADES: [Scale; 2] = [Scale::Linear, Scale::Logarithmic];

    fn mark(x: f64, median: f64) -> Mark {
        Mark { x, low: median / 2.0, median, high: median * 2.0 }
    }

    #[test]
    fn rungs_are_round() {
        assert_eq!(rungs((0.0, 1.0)), [1.0, 2.0, 5.0, 10.0]);
        let small = rungs((-1.1, -0.6));
        assert_eq!(small.len(), 2);
        assert!((small[0] - 0.1).abs() < 1e-12 && (small[1] - 0.2).abs() < 1e-12);
    }

    #[test]
    fn even_places_are_named_evenly_and_others_as_there_is_room() {
        let pixel = |x: f64| 10.0 * x as f32;
        assert_eq!(stride(&[2.5, 7.5, 12.5, 17.5], pixel, 60.0), 2);
        assert_eq!(stride(&[2.5, 7.5, 12.5, 17.5], pixel, 50.0), 1);
        assert_eq!(stride(&[5.0, 10.0, 15.0, 40.0], pixel, 90.0), 1);
        assert_eq!(stride(&[1.0, 1.0, 1.0], pixel, 9.0), 1);
        assert_eq!(stride(&[3.0], pixel, 9.0), 1);
    }

    #[test]
    fn medians_lie_within_their_band_and_the_frame() {
        let curve = Curve { name: "gp".into(), marks: vec![mark(5.0, 10.0), mark(40.0, 1.0)] };
        let frame = Frame { left: 10.0, top: 10.0, width: 300.0, height: 200.0 };
        let axes = Axes::new(frame, DECADES, std::slice::from_ref(&curve)).unwrap();
        for m in &curve.marks {
            let [high, median, low] = [m.high, m.median, m.low].map(|v| axes.pixel(m.x, v)[1]);
            assert!(high < median && median < low);
            assert!(high > frame.top && low < frame.bottom());
        }
        assert!(axes.pixel(5.0, 10.0)[0] < axes.pixel(40.0, 1.0)[0]);
    }

    #[test]
    fn what_cannot_be_shown_is_left_out() {
        let curve = |marks| Curve { name: "a model".into(), marks };
        let plot = |curves| Plot {
            title: "Error".into(),
            across: "contacts".into(),
            up: "mm".into(),
            scales: DECADES,
            curves,
        };
        let odd = vec![mark(1.0, f64::NAN), mark(2.0, 0.0), mark(f64::INFINITY, 1.0)];
        assert!(
            Axes::new(Frame { left: 0.0, top: 0.0, width: 9.0, height: 9.0 }, DECADES, &[])
                .is_none()
        );
        let plots = [plot(vec![]), plot(vec![curve(odd)]), plot(vec![curve(vec![mark(1.0, 2.0)])])];
        let drawing = render(&plots).unwrap();
        assert!(drawing.png().is_ok() && drawing.svg().contains("nothing to show"));
        assert_eq!(drawing.svg().matches(">a model</text>").count(), 2, "named all the same");
        assert!(render(&[]).unwrap().png().is_ok());
    }

    #[test]
    fn a_curve_without_marks_is_named_and_many_plots_have_room() {
        let curve = |name: &str, marks| Curve { name: name.into(), marks };
        let curves = vec![curve("seen", vec![mark(1.0, 2.0)]), curve("unseen", Vec::new())];
        let plot = Plot {
            title: "t".into(),
            across: "x, m".into(),
            up: "y, s".into(),
            scales: [Scale::Linear; 2],
            curves,
        };
        let drawing = render(&vec![plot; 60]).unwrap();
        assert_eq!(drawing.svg().matches(">unseen</text>").count(), MOST);
        assert_eq!(drawing.size(), (4 * 760, 12 * 520));
    }

    #[test]
    fn shares_may_be_zero_and_decades_may_not() {
        let scales = [Scale::Logarithmic, Scale::Linear];
        let none = Mark { x: 250.0, low: 0.0, median: 0.0, high: 20.0 };
        let all = Mark { x: 10_000.0, low: 80.0, median: 100.0, high: 100.0 };
        assert!(shows(scales, &none) && !shows(DECADES, &none));
        assert!(!shows(scales, &Mark { x: 0.0, ..none }));
        let curve = Curve { name: "share".into(), marks: vec![none, all] };
        let frame = Frame { left: 0.0, top: 0.0, width: 300.0, height: 200.0 };
        let axes = Axes::new(frame, scales, &[curve]).unwrap();
        // Halfway in decades and in percent is halfway across the plot.
        let middle = axes.pixel((250.0f64 * 10_000.0).sqrt(), 50.0);
        assert!((middle[0] - 150.0).abs() < 0.1 && (middle[1] - 100.0).abs() < 0.1, "{middle:?}");
        assert_eq!(scales[1].rungs((-6.0, 106.0)), [0.0, 20.0, 40.0, 60.0, 80.0, 100.0]);
    }
}
