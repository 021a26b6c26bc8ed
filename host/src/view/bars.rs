//! A table as a picture: a line for every case and series, its value and what it may be off.

use super::canvas::{Anchor, Canvas, Frame, Style};
use super::chart::label;
use super::colour::{self, GRID, INK, PANEL, PAPER, QUIET, TRUTH};
use super::curves::{Scale, dot};
use super::drawing::{Drawing, PictureError};

/// A value and the interval it lies in, in the unit of the axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// Lower end.
    pub low: f64,
    /// The value itself.
    pub value: f64,
    /// Upper end.
    pub high: f64,
}

impl Interval {
    /// Without any doubt.
    pub fn exact(value: f64) -> Interval {
        Interval { low: value, value, high: value }
    }
}

/// What is compared, over all cases.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// As the legend names it.
    pub name: String,
    /// One for every case; `None`, missing or not finite where there is none.
    pub values: Vec<Option<Interval>>,
}

/// Cases below one another with one axis: bars from zero where it is divided evenly, dots where it is
/// divided in decades.
#[derive(Clone, Debug, PartialEq)]
pub struct Bars {
    /// Above it.
    pub title: String,
    /// What the axis says, with its unit.
    pub along: String,
    /// How it is divided.
    pub scale: Scale,
    /// Names of the cases, from top to bottom.
    pub cases: Vec<String>,
    /// Drawn in this order within every case.
    pub series: Vec<Series>,
    /// Values to compare with, each with its name: dashed lines.
    pub references: Vec<(f64, String)>,
}

/// The picture's width, and the columns of names, plot and legend, pixels.
const WIDTH: f32 = 1240.0;
const NAMES: f32 = 330.0;
const LEGEND: f32 = 220.0;

/// Above and below the cases of a panel, pixels; the headline.
const HEAD: f32 = 64.0;
const FOOT: f32 = 62.0;
const HEADLINE: f32 = 64.0;
const GAP: f32 = 14.0;

/// The height of one line, and what a case has besides, pixels.
const LINE: f32 = 14.0;
const SPACE: f32 = 10.0;

/// Panels at most, and how high all of them may be, pixels: cases that do not fit are left out, and the
/// picture says so.
const MOST: usize = 12;
const HIGHEST: f32 = 14_000.0;

/// Values are written beside at most so many series.
const WRITTEN: usize = 3;

/// Draws the panels below one another under a headline.
///
/// # Errors
/// When the picture cannot be made, see [`PictureError`].
pub fn render(title: &str, panels: &[Bars]) -> Result<Drawing, PictureError> {
    let panels = &panels[..panels.len().min(MOST)];
    let room = HIGHEST / panels.len().max(1) as f32 - HEAD - FOOT - GAP;
    let shown: Vec<usize> =
        panels.iter().map(|p| p.cases.len().min((room / case_height(p)) as usize)).collect();
    let heights = panels.iter().zip(&shown).map(|(p, n)| panel_height(p, *n));
    let height = HEADLINE + heights.clone().sum::<f32>() + GAP * (panels.len() + 1) as f32;
    let mut canvas = Canvas::new(WIDTH as u32, height as u32, PAPER)?;
    // A long title is set smaller before it is cut.
    let styles = [22.0, 18.0, 15.0].map(|size| Style::new(size, INK).bold());
    let fits = |style: &&Style| canvas.text_width(**style, title) <= WIDTH - 48.0;
    let style = *styles.iter().find(fits).unwrap_or(&styles[2]);
    let title = canvas.fitted(style, title, WIDTH - 48.0);
    canvas.text([24.0, 44.0], style, &title);
    let mut top = HEADLINE;
    for ((panel, shown), height) in panels.iter().zip(&shown).zip(heights) {
        let frame = Frame { left: GAP, top, width: WIDTH - 2.0 * GAP, height };
        draw(&mut canvas, &frame, panel, *shown);
        top += height + GAP;
    }
    Ok(canvas.finish())
}

fn case_height(panel: &Bars) -> f32 {
    LINE * panel.series.len().max(1) as f32 + SPACE
}

fn panel_height(panel: &Bars, shown: usize) -> f32 {
    let legend = 26.0 * (panel.series.len() + panel.references.len()) as f32;
    HEAD + (case_height(panel) * shown as f32).max(legend).max(40.0) + FOOT
}

/// Both ends of the axis, as places on its scale, and where it lies.
struct Axis {
    scale: Scale,
    ends: (f64, f64),
    plot: Frame,
}

impl Axis {
    /// `None` where there is nothing to show.
    fn new(panel: &Bars, plot: Frame) -> Option<Axis> {
        let known =
            panel.series.iter().flat_map(|s| &s.values).filter_map(|v| shows(panel.scale, *v));
        let own = known.flat_map(|v| [v.low, v.value, v.high]);
        let references = panel.references.iter().map(|r| r.0);
        let places: Vec<f64> =
            own.chain(references).map(|v| panel.scale.place(v)).filter(|v| v.is_finite()).collect();
        let least = places.iter().copied().fold(f64::INFINITY, f64::min);
        let most = places.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if !(least.is_finite() && most.is_finite()) {
            return None;
        }
        let ends = match panel.scale {
            Scale::Linear => {
                let (low, high) = (least.min(0.0), most.max(0.0));
                let span = if high > low { high - low } else { 1.0 };
                (
                    if low < 0.0 { low - 0.08 * span } else { 0.0 },
                    high.max(low + span) + 0.08 * span,
                )
            }
            Scale::Logarithmic => {
                let room = (0.08 * (most - least)).max(0.1);
                (least - room, most + room)
            }
        };
        Some(Axis { scale: panel.scale, ends, plot })
    }

    fn x(&self, value: f64) -> f32 {
        let share = (self.scale.place(value) - self.ends.0) / (self.ends.1 - self.ends.0);
        self.plot.left + self.plot.width * share as f32
    }
}

/// The interval where the scale can show it; ends that it cannot show are drawn in to the value.
fn shows(scale: Scale, interval: Option<Interval>) -> Option<Interval> {
    let fine = |v: f64| scale.place(v).is_finite();
    let i = interval.filter(|i| fine(i.value))?;
    let end = |v: f64| if fine(v) { v } else { i.value };
    Some(Interval { low: end(i.low), value: i.value, high: end(i.high) })
}

fn draw(canvas: &mut Canvas, frame: &Frame, panel: &Bars, shown: usize) {
    canvas.fill_card(frame, 10.0, PANEL);
    let (title, quiet) = (Style::new(18.0, INK).bold(), Style::new(13.0, QUIET));
    canvas.text([frame.left + 22.0, frame.top + 36.0], title, &panel.title);
    legend(canvas, [frame.right() - LEGEND + 14.0, frame.top + HEAD + 12.0], panel);
    let plot = frame.inset(NAMES, HEAD, LEGEND, FOOT);
    let axis = Axis::new(panel, plot).filter(|_| shown > 0);
    let Some(axis) = axis else {
        canvas.text([plot.left, plot.top + 26.0], quiet, "nothing to show");
        return;
    };
    for value in panel.scale.rungs(axis.ends) {
        let x = axis.x(value);
        canvas.line(&[[x, plot.top], [x, plot.bottom()]], 1.0, GRID);
        let at = [x, plot.bottom() + 20.0];
        canvas.text(at, quiet.anchored(Anchor::Middle), &label(value));
    }
    let middle = plot.left + plot.width / 2.0;
    canvas.text([middle, plot.bottom() + 44.0], quiet.anchored(Anchor::Middle), &panel.along);
    for (number, case) in panel.cases.iter().take(shown).enumerate() {
        let top = plot.top + number as f32 * case_height(panel) + SPACE / 2.0;
        let height = case_height(panel) - SPACE;
        let name = Style::new(13.0, INK);
        let fitted = canvas.fitted(name, case, NAMES - 34.0);
        let at = [plot.left - 12.0, top + height / 2.0 + 4.5];
        canvas.text(at, name.anchored(Anchor::End), &fitted);
        for (line, series) in panel.series.iter().enumerate() {
            let y = top + LINE * (line as f32 + 0.5);
            let value = series.values.get(number).copied().flatten();
            let written = panel.series.len() <= WRITTEN;
            match shows(panel.scale, value) {
                Some(value) => one(canvas, &axis, y, value, line, written),
                None => {
                    canvas.text([plot.left + 4.0, y + 4.0], quiet, "–");
                }
            }
        }
    }
    for (number, (value, _)) in panel.references.iter().enumerate() {
        let x = axis.x(*value);
        if x.is_finite() {
            dashed(canvas, [x, plot.top], [x, plot.bottom()], TRUTH.faded(0.8), number);
        }
    }
    if shown < panel.cases.len() {
        let text = format!("{} more cases are left out", panel.cases.len() - shown);
        canvas.text([frame.left + 22.0, plot.bottom() + 44.0], quiet, &text);
    }
}

/// A bar or a dot, and the interval through it.
fn one(
    canvas: &mut Canvas,
    axis: &Axis,
    y: f32,
    Interval { low, value, high }: Interval,
    series: usize,
    written: bool,
) {
    let tint = colour::series(series);
    let x = axis.x(value);
    if axis.scale == Scale::Linear {
        let zero = axis.x(0.0);
        let (left, width) = (zero.min(x), (x - zero).abs());
        let bar = Frame { left, top: y - LINE / 2.0 + 2.0, width, height: LINE - 4.0 };
        canvas.fill_frame(&bar, tint.mixed(PANEL, 0.55));
    }
    let (from, to) = (axis.x(low), axis.x(high));
    if to - from > 0.5 {
        canvas.line(&[[from, y], [to, y]], 2.0, tint);
        for end in [from, to] {
            canvas.line(&[[end, y - 3.0], [end, y + 3.0]], 2.0, tint);
        }
    }
    dot(canvas, [x, y], series);
    if written {
        let text = match value.abs() {
            v if v >= 100.0 || v == 0.0 => format!("{value:.0}"),
            v if v >= 10.0 => format!("{value:.1}"),
            v if v >= 0.01 => format!("{value:.2}"),
            _ => format!("{value:.1e}"),
        };
        canvas.text([x.max(to) + 8.0, y + 4.0], Style::new(11.5, QUIET), &text);
    }
}

/// Each reference has dashes of its own length.
fn dashed(canvas: &mut Canvas, from: [f32; 2], to: [f32; 2], tint: colour::Colour, number: usize) {
    let length = [7.0, 3.0, 12.0][number % 3];
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    let pieces = (dx.hypot(dy) / (length + 5.0)).ceil().max(1.0) as usize;
    for i in 0..pieces {
        let at = |along: f32| {
            let share = (along / dx.hypot(dy).max(1e-3)).min(1.0);
            [from[0] + dx * share, from[1] + dy * share]
        };
        let start = i as f32 * (length + 5.0);
        canvas.line(&[at(start), at(start + length)], 1.4, tint);
    }
}

fn legend(canvas: &mut Canvas, at: [f32; 2], panel: &Bars) {
    let style = Style::new(13.0, INK);
    let [x, mut y] = at;
    for (number, series) in panel.series.iter().enumerate() {
        canvas.line(&[[x, y - 4.5], [x + 22.0, y - 4.5]], 3.0, colour::series(number));
        dot(canvas, [x + 11.0, y - 4.5], number);
        let name = canvas.fitted(style, &series.name, LEGEND - 56.0);
        canvas.text([x + 32.0, y], style, &name);
        y += 26.0;
    }
    for (number, (_, name)) in panel.references.iter().enumerate() {
        dashed(canvas, [x, y - 4.5], [x + 22.0, y - 4.5], TRUTH.faded(0.8), number);
        let name = canvas.fitted(style, name, LEGEND - 56.0);
        canvas.text([x + 32.0, y], style, &name);
        y += 26.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bars(scale: Scale, values: &[Option<Interval>]) -> Bars {
        Bars {
            title: "Pose".into(),
            along: "error, mm".into(),
            scale,
            cases: (0..values.len()).map(|i| format!("case {i}")).collect(),
            series: vec![
                Series { name: "tracker".into(), values: values.to_vec() },
                Series { name: "nothing".into(), values: Vec::new() },
            ],
            references: vec![(3.0, "goal".into())],
        }
    }

    fn interval(low: f64, value: f64, high: f64) -> Option<Interval> {
        Some(Interval { low, value, high })
    }

    #[test]
    fn bars_begin_at_zero_and_dots_lie_in_decades() {
        let plot = Frame { left: 100.0, top: 0.0, width: 200.0, height: 50.0 };
        let even = Axis::new(&bars(Scale::Linear, &[interval(4.0, 5.0, 10.0)]), plot).unwrap();
        assert_eq!(even.x(0.0), 100.0);
        assert!(even.x(10.0) < 300.0 && even.x(10.0) > 270.0);
        let values = [interval(1.0, 1.0, 1.0), interval(100.0, 100.0, 100.0)];
        let decades = Axis::new(&bars(Scale::Logarithmic, &values), plot).unwrap();
        assert!((decades.x(10.0) - 200.0).abs() < 0.1, "{}", decades.x(10.0));
        let below = Axis::new(&bars(Scale::Linear, &[interval(-2.0, -1.0, 1.0)]), plot).unwrap();
        assert!(below.x(-2.0) > 100.0 && below.x(0.0) > below.x(-2.0));
    }

    #[test]
    fn what_is_not_known_is_a_dash_and_every_series_is_named() {
        let nan = f64::NAN;
        let values = [None, interval(nan, 2.0, f64::INFINITY), interval(1.0, nan, 2.0)];
        for scale in [Scale::Linear, Scale::Logarithmic] {
            let svg = render("A <table>", &[bars(scale, &values)]).unwrap().svg();
            assert!(svg.contains(">nothing</text>") && svg.contains(">goal</text>"));
            assert!(svg.contains(">error, mm</text>") && svg.contains("A &lt;table&gt;"));
            // Two of the tracker's values and all of the other series'.
            assert_eq!(svg.matches(">–</text>").count(), 5);
            assert!(!svg.contains("NaN") && !svg.contains("inf"));
        }
        let svg =
            render("", &[bars(Scale::Logarithmic, &[interval(0.0, 0.0, 0.0)])]).unwrap().svg();
        assert_eq!(svg.matches(">–</text>").count(), 2, "a zero has no place among decades");
        let mut nothing = bars(Scale::Linear, &[None]);
        nothing.references.clear();
        assert!(render("", &[nothing]).unwrap().svg().contains("nothing to show"));
        assert!(render("", &[]).is_ok());
    }

    #[test]
    fn too_many_cases_are_counted() {
        let many = bars(Scale::Linear, &vec![interval(1.0, 2.0, 3.0); 1_000]);
        let drawing = render("many", &[many]).unwrap();
        assert!(drawing.size().1 as f32 <= HIGHEST + HEADLINE + 2.0 * GAP);
        assert!(drawing.svg().contains("more cases are left out"));
        assert!(drawing.png().is_ok());
    }
}
