//! The small panel beside the picture: pose errors over the grasps, or how the uncertainty is
//! spread.

use super::canvas::{Anchor, Canvas, Frame, Pixel, Style};
use super::colour::{self, GRID, INK, PANEL, QUIET, ROTATION, TRANSLATION};

/// At most `count` round steps between `least` and `greatest`.
pub(super) fn ticks(least: f64, greatest: f64, count: usize) -> Vec<f64> {
    ticks_by(round_step((greatest - least) / count.max(1) as f64), least, greatest)
}

/// The multiples of `step` between `least` and `greatest`; `least` if there are no such limits.
pub(super) fn ticks_by(step: f64, least: f64, greatest: f64) -> Vec<f64> {
    let count = (greatest - least) / step;
    if !(count.is_finite() && count < 1e3) {
        return vec![least];
    }
    let first = (least / step).ceil() as i64;
    let last = (greatest / step + 1e-9).floor() as i64;
    (first..=last).map(|i| i as f64 * step).collect()
}

/// The least of 1, 2, 2.5, 5 times a power of ten that is not below `raw` (> 0).
pub(super) fn round_step(raw: f64) -> f64 {
    let power = 10f64.powf(raw.log10().floor());
    let factor = [1.0, 2.0, 2.5, 5.0].into_iter().find(|f| f * power >= raw * (1.0 - 1e-9));
    factor.unwrap_or(10.0) * power
}

/// A number as an axis shows it: no more decimals than it needs, a true minus sign.
pub(super) fn label(value: f64) -> String {
    if value.abs() >= 1e5 {
        return format!("{value:.1e}");
    }
    if value != 0.0 && value.abs() < 1e-3 {
        return format!("{value:.0e}").replace('-', "−");
    }
    let text = format!("{:.3}", value.abs());
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if value < 0.0 && text != "0" { format!("−{text}") } else { text.into() }
}

/// The upper end of an axis that shows everything up to `greatest`.
fn axis_end(greatest: f64) -> f64 {
    let wanted = if greatest.is_finite() && greatest > 1e-3 { greatest } else { 1.0 };
    let step = round_step(wanted / 4.0);
    (wanted / step - 1e-9).ceil() * step
}

fn heading(canvas: &mut Canvas, frame: &Frame, title: &str) -> Frame {
    canvas.fill_card(frame, 10.0, PANEL);
    let style = Style::new(18.0, INK).bold();
    canvas.text([frame.left + 22.0, frame.top + 34.0], style, title);
    frame.inset(58.0, 92.0, 58.0, 50.0)
}

/// Translation (left axis, millimetres) and rotation (right axis, degrees) errors over the grasps.
pub(super) fn pose_errors(canvas: &mut Canvas, frame: &Frame, errors: &[(f64, f64)]) {
    let plot = heading(canvas, frame, "Pose error after each grasp");
    let series = [
        ("translation, mm", TRANSLATION, errors.iter().map(|e| e.0).collect::<Vec<_>>()),
        ("rotation, °", ROTATION, errors.iter().map(|e| e.1).collect()),
    ];
    let column = |i: usize| plot.left + plot.width * (i as f32 + 0.5) / errors.len().max(1) as f32;
    for (side, (name, colour, values)) in series.iter().enumerate() {
        let finite = values.iter().copied().filter(|v| v.is_finite());
        let end = axis_end(finite.fold(0.0, f64::max));
        let row = |v: f64| plot.bottom() - plot.height * (v / end).clamp(0.0, 1.0) as f32;
        for tick in ticks(0.0, end, 4) {
            let y = row(tick);
            if side == 0 {
                canvas.line(&[[plot.left, y], [plot.right(), y]], 1.0, GRID);
            }
            let style = Style::new(13.0, *colour);
            let (x, anchor) = match side {
                0 => (plot.left - 8.0, Anchor::End),
                _ => (plot.right() + 8.0, Anchor::Start),
            };
            canvas.text([x, y + 4.5], style.anchored(anchor), &label(tick));
        }
        let name_style = Style::new(14.0, *colour).bold();
        let (x, anchor) = match side {
            0 => (frame.left + 22.0, Anchor::Start),
            _ => (frame.right() - 22.0, Anchor::End),
        };
        canvas.text([x, frame.top + 66.0], name_style.anchored(anchor), name);
        let points: Vec<Pixel> = values
            .iter()
            .enumerate()
            .filter(|(_, v)| v.is_finite())
            .map(|(i, v)| [column(i), row(*v)])
            .collect();
        canvas.line(&points, 2.5, *colour);
        for p in &points {
            canvas.fill_dot(*p, if points.len() > 40 { 2.0 } else { 4.0 }, *colour);
        }
    }
    let step = (errors.len() as f64 / 8.0).max(1.0);
    let step = round_step(step).ceil() as usize;
    let style = Style::new(13.0, QUIET).anchored(Anchor::Middle);
    for i in (0..errors.len()).step_by(step.max(1)) {
        canvas.text([column(i), plot.bottom() + 20.0], style, &(i + 1).to_string());
    }
    canvas.text([plot.left + plot.width / 2.0, frame.bottom() - 12.0], style, "grasp");
}

/// How large the uncertainty is on how much of the surface; `greatest` metres is the end of the
/// colour scale.
pub(super) fn uncertainty(canvas: &mut Canvas, frame: &Frame, deviations: &[f64], greatest: f64) {
    const BARS: usize = 20;
    let plot = heading(canvas, frame, "Uncertainty of the surface");
    let known: Vec<f64> = deviations.iter().copied().filter(|d| d.is_finite()).collect();
    let mut bars = [0usize; BARS];
    for d in &known {
        bars[((d / greatest * BARS as f64).max(0.0) as usize).min(BARS - 1)] += 1;
    }
    let share = |n: usize| 100.0 * n as f64 / known.len().max(1) as f64;
    let end = axis_end(bars.iter().map(|n| share(*n)).fold(0.0, f64::max));
    let row = |v: f64| plot.bottom() - plot.height * (v / end) as f32;
    for tick in ticks(0.0, end, 4) {
        canvas.line(&[[plot.left, row(tick)], [plot.right(), row(tick)]], 1.0, GRID);
        let style = Style::new(13.0, QUIET).anchored(Anchor::End);
        canvas.text([plot.left - 8.0, row(tick) + 4.5], style, &label(tick));
    }
    let style = Style::new(14.0, QUIET);
    canvas.text([frame.left + 22.0, frame.top + 66.0], style, "share of the vertices, %");
    let width = plot.width / BARS as f32;
    for (i, n) in bars.iter().enumerate().filter(|(_, n)| **n > 0) {
        let top = row(share(*n));
        let left = plot.left + i as f32 * width;
        let bar = Frame { left: left + 1.0, top, width: width - 2.0, height: plot.bottom() - top };
        canvas.fill_frame(&bar, colour::uncertainty((i as f64 + 0.5) / BARS as f64));
    }
    let style = Style::new(13.0, QUIET).anchored(Anchor::Middle);
    for tick in ticks(0.0, greatest * 1e3, 4) {
        let x = plot.left + plot.width * (tick / (greatest * 1e3)) as f32;
        canvas.text([x, plot.bottom() + 20.0], style, &label(tick));
    }
    let x = plot.left + plot.width / 2.0;
    canvas.text([x, frame.bottom() - 12.0], style, "standard deviation, mm");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_cover_the_range() {
        assert_eq!(ticks(0.0, 10.0, 4), [0.0, 2.5, 5.0, 7.5, 10.0]);
        assert_eq!(ticks(-30.0, 70.0, 5), [-20.0, 0.0, 20.0, 40.0, 60.0]);
        assert_eq!(ticks(1.0, 1.0, 5), [1.0]);
        assert_eq!(ticks(0.0, f64::NAN, 5), [0.0]);
        assert_eq!(axis_end(7.3), 8.0);
        assert_eq!(axis_end(0.0), 1.0);
        assert_eq!(label(-2.50), "−2.5");
        assert_eq!(label(-0.0), "0");
        assert_eq!(label(120.0), "120");
        assert_eq!(label(2.5e12), "2.5e12");
        assert_eq!(label(-2e-6), "−2e−6");
    }
}
