//! The planar picture: outlines, their uncertainty and the contacts on millimetre axes.

use super::canvas::{Anchor, Canvas, Frame, Pixel, Style};
use super::chart::{label, round_step, ticks_by};
use super::colour::{self, GRID, INK, PANEL, PAPER, QUIET, TRUTH};
use super::summary::{Shown, Touch};
use crate::shape::Outline;
use crate::space::Point;

/// Frames narrower than this many pixels do without the axes' name.
const SMALL: f32 = 600.0;

/// Maps metres to pixels.
struct View {
    frame: Frame,
    middle: Point,
    /// Pixels per metre.
    scale: f64,
}

impl View {
    /// Of what is shown, in this frame.
    fn of(frame: &Frame, shown: &Shown) -> View {
        let plot = match frame.width < SMALL {
            true => frame.inset(48.0, 16.0, 16.0, 34.0),
            false => frame.inset(66.0, 22.0, 22.0, 58.0),
        };
        let (least, greatest) = shown.bounds;
        let size = greatest - least;
        let room = 0.07 * plot.width;
        let fits = |span: f64, pixels: f32| f64::from(pixels - room) / span.max(1e-6);
        let scale = fits(size.x, plot.width).min(fits(size.y, plot.height));
        View { frame: plot, middle: (least + greatest) / 2.0, scale }
    }

    fn pixel(&self, p: &Point) -> Pixel {
        let across = (p.x - self.middle.x) * self.scale;
        let up = (p.y - self.middle.y) * self.scale;
        [
            self.frame.left + self.frame.width / 2.0 + across as f32,
            self.frame.top + self.frame.height / 2.0 - up as f32,
        ]
    }

    fn pixels(&self, vertices: &[[f64; 2]]) -> Vec<Pixel> {
        vertices.iter().map(|v| self.pixel(&Point::new(v[0], v[1], 0.0))).collect()
    }
}

pub(super) fn draw(
    canvas: &mut Canvas,
    frame: &Frame,
    shown: &Shown,
    estimate: &Outline,
    truth: Option<&Outline>,
) {
    canvas.fill_card(frame, 10.0, PANEL);
    let view = View::of(frame, shown);
    let scale = view.scale;

    axes(canvas, &view);
    let loops: Vec<Vec<Pixel>> = estimate.loops.iter().map(|l| view.pixels(l)).collect();
    canvas.fill_area(&loops, colour::uncertainty(0.0).mixed(PAPER, 0.9));
    let mut first = 0;
    for (pixels, vertices) in loops.iter().zip(&estimate.loops) {
        let deviations: Vec<f64> =
            (first..first + vertices.len()).map(|i| shown.deviation(i)).collect();
        first += vertices.len();
        band(canvas, pixels, &deviations, scale, shown.scale_end);
        uncertain_line(canvas, pixels, &deviations, shown.scale_end);
    }
    for vertices in truth.iter().flat_map(|t| &t.loops) {
        canvas.closed_line(&view.pixels(vertices), 2.2, TRUTH);
    }
    for touch in &shown.touches {
        contact(canvas, &view, touch, shown.grasps);
    }
}

/// Thin lines between places, over what [`draw`] has drawn.
pub(super) fn link(canvas: &mut Canvas, frame: &Frame, shown: &Shown, links: &[[Point; 2]]) {
    let view = View::of(frame, shown);
    for [a, b] in links {
        canvas.line(&[view.pixel(a), view.pixel(b)], 1.4, INK.faded(0.45));
    }
}

fn axes(canvas: &mut Canvas, view: &View) {
    let Frame { left, top, .. } = view.frame;
    let (right, bottom) = (view.frame.right(), view.frame.bottom());
    let half =
        Point::new(view.frame.width.into(), view.frame.height.into(), 0.0) / 2.0 / view.scale;
    let (least, greatest) = ((view.middle - half) * 1e3, (view.middle + half) * 1e3);
    // One step for both axes, so that the grid is square.
    let step = round_step((greatest.x - least.x) / 9.0);
    for x in ticks_by(step, least.x, greatest.x) {
        let at = view.pixel(&Point::new(x / 1e3, 0.0, 0.0))[0];
        canvas.line(&[[at, top], [at, bottom]], 1.0, GRID);
        let style = Style::new(14.0, QUIET).anchored(Anchor::Middle);
        canvas.text([at, bottom + 20.0], style, &label(x));
    }
    for y in ticks_by(step, least.y, greatest.y) {
        let at = view.pixel(&Point::new(0.0, y / 1e3, 0.0))[1];
        canvas.line(&[[left, at], [right, at]], 1.0, GRID);
        let style = Style::new(14.0, QUIET).anchored(Anchor::End);
        canvas.text([left - 10.0, at + 5.0], style, &label(y));
    }
    if view.frame.width >= SMALL {
        let style = Style::new(14.0, QUIET).anchored(Anchor::End);
        canvas.text([right, bottom + 42.0], style, "object frame, mm");
    }
}

/// Two standard deviations either way, as a pale band.
fn band(canvas: &mut Canvas, pixels: &[Pixel], deviations: &[f64], scale: f64, end: f64) {
    let n = pixels.len();
    let widest = 90.0;
    let half = |d: f64| {
        let wide = (2.0 * d * scale) as f32;
        if wide.is_finite() { wide.clamp(0.0, widest) } else { 0.0 }
    };
    let outward: Vec<Pixel> = (0..n)
        .map(|i| {
            let (a, b) = (pixels[(i + n - 1) % n], pixels[(i + 1) % n]);
            let along = [b[0] - a[0], b[1] - a[1]];
            let length = along[0].hypot(along[1]).max(1e-6);
            [along[1] / length, -along[0] / length]
        })
        .collect();
    let offset = |i: usize, side: f32| {
        let wide = side * half(deviations[i]);
        [pixels[i][0] + outward[i][0] * wide, pixels[i][1] + outward[i][1] * wide]
    };
    for i in 0..n {
        let j = (i + 1) % n;
        let tint = colour::uncertainty(0.5 * (deviations[i] + deviations[j]) / end);
        let quad = vec![offset(i, 1.0), offset(j, 1.0), offset(j, -1.0), offset(i, -1.0)];
        let pale = tint.mixed(PAPER, 0.72);
        // A hairline closes the seams that anti-aliasing leaves between neighbours.
        canvas.closed_line(&quad, 0.8, pale);
        canvas.fill_area(&[quad], pale);
    }
}

fn uncertain_line(canvas: &mut Canvas, pixels: &[Pixel], deviations: &[f64], end: f64) {
    let n = pixels.len();
    for i in 0..n {
        let j = (i + 1) % n;
        let tint = colour::uncertainty(0.5 * (deviations[i] + deviations[j]) / end);
        canvas.line(&[pixels[i], pixels[j]], 6.0, tint);
    }
}

fn contact(canvas: &mut Canvas, view: &View, touch: &Touch, grasps: usize) {
    let at = view.pixel(&touch.point);
    let tint = colour::grasp(touch.grasp, grasps);
    if let Some(normal) = touch.normal {
        let tip = [at[0] + 20.0 * normal.x as f32, at[1] - 20.0 * normal.y as f32];
        canvas.line(&[at, tip], 3.6, PAPER);
        canvas.line(&[at, tip], 2.0, tint);
    }
    canvas.fill_dot(at, 6.8, PAPER);
    canvas.fill_dot(at, 5.4, tint);
    canvas.ring(at, 5.4, 0.8, INK.faded(0.5));
}
