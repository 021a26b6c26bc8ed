//! The spatial picture: the estimated mesh from three sides, the edges of the true one, contacts.

use std::collections::HashMap;

use super::canvas::{Anchor, Canvas, Frame, Pixel, Style};
use super::chart::{label, round_step};
use super::colour::{self, INK, PANEL, PAPER, QUIET, TRUTH};
use super::raster::{Camera, Corner, Raster};
use super::summary::{Shown, Touch};
use crate::shape::Mesh;
use crate::space::Point;

/// Edges between faces that turn by more than this are drawn, radians.
const SHARP: f64 = 0.5;

/// How far behind the surface something may lie and still count as on it, of the object's size.
const SLACK: f64 = 0.02;

pub(super) fn draw(
    canvas: &mut Canvas,
    frame: &Frame,
    shown: &Shown,
    estimate: &Mesh,
    truth: Option<&Mesh>,
) {
    canvas.fill_card(frame, 10.0, PANEL);
    let wide = frame.width * 0.62;
    let half = frame.height / 2.0;
    let small =
        Frame { left: frame.left + wide, top: frame.top, width: frame.width - wide, height: half };
    let views = [
        ("from the front, above", Point::new(0.75, -1.0, 0.65), Frame { width: wide, ..*frame }),
        ("from behind, below", Point::new(-0.75, 1.0, -0.65), small),
        ("from above", Point::z(), Frame { top: frame.top + half, ..small }),
    ];
    let model = Model::new(estimate, truth);
    for (name, towards, frame) in views {
        let within = frame.inset(46.0, 50.0, 46.0, 50.0);
        let camera = model.draw(canvas, &frame, &within, towards, shown);
        let style = Style::new(14.0, QUIET);
        canvas.text([frame.left + 22.0, frame.top + 30.0], style, name);
        triad(canvas, &camera, [frame.left + 50.0, frame.bottom() - 46.0]);
        ruler(canvas, &camera, [frame.right() - 24.0, frame.bottom() - 22.0]);
    }
}

/// One view of the mesh, for a small frame.
pub(super) fn draw_small(
    canvas: &mut Canvas,
    frame: &Frame,
    shown: &Shown,
    estimate: &Mesh,
    truth: Option<&Mesh>,
) {
    canvas.fill_card(frame, 10.0, PANEL);
    let within = frame.inset(26.0, 22.0, 26.0, 34.0);
    let towards = Point::new(0.75, -1.0, 0.65);
    let camera = Model::new(estimate, truth).draw(canvas, frame, &within, towards, shown);
    ruler(canvas, &camera, [frame.right() - 16.0, frame.bottom() - 8.0]);
}

/// What every view of a mesh needs.
struct Model<'a> {
    mesh: &'a Mesh,
    normals: Vec<Point>,
    /// Of the true shape.
    edges: Vec<Edge>,
}

impl<'a> Model<'a> {
    fn new(mesh: &'a Mesh, truth: Option<&Mesh>) -> Self {
        let edges = truth.map(edges).unwrap_or_default();
        Self { mesh, normals: vertex_normals(mesh), edges }
    }

    /// Draws what is seen from `towards`, the object filling the frame `within`.
    fn draw(
        &self,
        canvas: &mut Canvas,
        frame: &Frame,
        within: &Frame,
        towards: Point,
        shown: &Shown,
    ) -> Camera {
        let camera = Camera::new(towards, shown.bounds, *within);
        let raster = paint(canvas, frame, &camera, shown, self.mesh, &self.normals);
        let slack = SLACK * (shown.bounds.1 - shown.bounds.0).norm();
        let scene = Scene { camera, raster, slack };
        for edge in self.edges.iter().filter(|e| e.sharp || e.is_silhouette(&camera)) {
            scene.edge(canvas, edge);
        }
        // The nearest contacts last, over those behind.
        let mut touches: Vec<&Touch> = shown.touches.iter().collect();
        touches.sort_by(|a, b| camera.project(&a.point).1.total_cmp(&camera.project(&b.point).1));
        for touch in touches {
            scene.contact(canvas, touch, shown.grasps);
        }
        camera
    }
}

struct Scene {
    camera: Camera,
    raster: Raster,
    slack: f64,
}

impl Scene {
    /// Draws an edge of the true shape: dark where it is in front, faint where it is hidden.
    fn edge(&self, canvas: &mut Canvas, edge: &Edge) {
        let ((a, depth_a), (b, depth_b)) =
            (self.camera.project(&edge.ends[0]), self.camera.project(&edge.ends[1]));
        let length = (b[0] - a[0]).hypot(b[1] - a[1]);
        let pieces = if length.is_finite() { (length / 3.0).clamp(1.0, 400.0) as usize } else { 1 };
        let at = |i: usize| {
            let share = i as f32 / pieces as f32;
            let depth = depth_a + (depth_b - depth_a) * f64::from(share);
            ([a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share], depth)
        };
        let hidden = |i: usize| {
            let (p, q) = (at(i), at(i + 1));
            let middle = [(p.0[0] + q.0[0]) / 2.0, (p.0[1] + q.0[1]) / 2.0];
            self.raster.hides(middle, (p.1 + q.1) / 2.0, self.slack)
        };
        let mut from = 0;
        for i in 0..pieces {
            let last = i + 1 == pieces;
            if last || hidden(i) != hidden(i + 1) {
                let ends = [at(from).0, at(i + 1).0];
                match hidden(i) {
                    true => canvas.line(&ends, 1.2, TRUTH.faded(0.22)),
                    false => canvas.line(&ends, 2.0, TRUTH),
                }
                from = i + 1;
            }
        }
    }

    fn contact(&self, canvas: &mut Canvas, touch: &Touch, grasps: usize) {
        let (at, depth) = self.camera.project(&touch.point);
        let tint = colour::grasp(touch.grasp, grasps);
        if self.raster.hides(at, depth, 1.5 * self.slack) {
            canvas.ring(at, 3.6, 1.4, tint.faded(0.35));
            return;
        }
        if let Some(normal) = touch.normal {
            let along = self.camera.direction(&normal);
            let tip = [at[0] + 22.0 * along[0], at[1] + 22.0 * along[1]];
            canvas.line(&[at, tip], 3.6, PAPER);
            canvas.line(&[at, tip], 2.0, tint);
        }
        canvas.fill_dot(at, 6.2, PAPER);
        canvas.fill_dot(at, 4.8, tint);
        canvas.ring(at, 4.8, 0.8, INK.faded(0.5));
    }
}

/// Draws the estimated mesh and returns the buffer that knows what it hides.
fn paint(
    canvas: &mut Canvas,
    frame: &Frame,
    camera: &Camera,
    shown: &Shown,
    mesh: &Mesh,
    normals: &[Point],
) -> Raster {
    let mut raster = Raster::new(*frame);
    for t in mesh.triangles() {
        let corner = |v: u32| {
            let i = v as usize;
            let point = mesh.vertices().get(i)?;
            let (pixel, depth) = camera.project(point);
            let tint = colour::uncertainty(shown.deviation(i) / shown.scale_end);
            let light = normals.get(i).map_or(1.0, |n| camera.brightness(n));
            Some(Corner { pixel, depth, colour: tint.lit(light) })
        };
        if let (Some(a), Some(b), Some(c)) = (corner(t[0]), corner(t[1]), corner(t[2])) {
            raster.triangle([a, b, c]);
        }
    }
    let (width, rows) = raster.picture();
    canvas.overlay(frame.left, frame.top, width, &rows);
    raster
}

/// Unit normals at the vertices, faces weighing by their area.
fn vertex_normals(mesh: &Mesh) -> Vec<Point> {
    let mut sums = vec![Point::zeros(); mesh.vertices().len()];
    for t in mesh.triangles() {
        let Some(normal) = area_normal(mesh, t) else { continue };
        for v in t {
            sums[*v as usize] += normal;
        }
    }
    sums.into_iter().map(|n| n.try_normalize(1e-18).unwrap_or_else(Point::zeros)).collect()
}

/// Twice the area along the outward normal; `None` for indices out of range.
fn area_normal(mesh: &Mesh, t: &[u32; 3]) -> Option<Point> {
    let corner = |i: usize| mesh.vertices().get(t[i] as usize);
    let (a, b, c) = (corner(0)?, corner(1)?, corner(2)?);
    Some((b - a).cross(&(c - a)))
}

/// An edge and the normals of the faces on either side.
struct Edge {
    ends: [Point; 2],
    normals: Vec<Point>,
    sharp: bool,
}

impl Edge {
    fn is_silhouette(&self, camera: &Camera) -> bool {
        let seen = self.normals.iter().filter(|n| camera.sees(n)).count();
        seen > 0 && seen < self.normals.len()
    }
}

/// All edges of a mesh. Vertices in one place count as one, as meshes from triangle soups need.
fn edges(mesh: &Mesh) -> Vec<Edge> {
    let place = |v: u32| {
        let p = mesh.vertices()[v as usize];
        [p.x, p.y, p.z].map(|c| (c * 1e7).round() as i64)
    };
    let mut found: HashMap<[[i64; 3]; 2], usize> = HashMap::new();
    let mut edges: Vec<Edge> = Vec::new();
    for t in mesh.triangles() {
        let normal = area_normal(mesh, t).and_then(|n| n.try_normalize(1e-18));
        let Some(normal) = normal else { continue };
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            let mut key = [place(a), place(b)];
            key.sort_unstable();
            let at = *found.entry(key).or_insert_with(|| {
                let ends = [mesh.vertices()[a as usize], mesh.vertices()[b as usize]];
                edges.push(Edge { ends, normals: Vec::new(), sharp: false });
                edges.len() - 1
            });
            edges[at].normals.push(normal);
        }
    }
    for edge in &mut edges {
        edge.sharp = match edge.normals.as_slice() {
            [a, b] => a.dot(b) < SHARP.cos(),
            _ => true,
        };
    }
    edges
}

/// The directions of the object's axes.
fn triad(canvas: &mut Canvas, camera: &Camera, origin: Pixel) {
    for (name, axis) in [("x", Point::x()), ("y", Point::y()), ("z", Point::z())] {
        let [dx, dy] = camera.direction(&axis);
        if dx.hypot(dy) < 0.1 {
            continue;
        }
        let tip = [origin[0] + 26.0 * dx, origin[1] + 26.0 * dy];
        canvas.line(&[origin, tip], 2.0, QUIET);
        let at = [origin[0] + 37.0 * dx, origin[1] + 37.0 * dy + 4.5];
        canvas.text(at, Style::new(13.0, QUIET).anchored(Anchor::Middle), name);
    }
}

/// A round length in millimetres, ending at `end`.
fn ruler(canvas: &mut Canvas, camera: &Camera, end: Pixel) {
    let length = round_step(50.0 / (camera.scale / 1e3));
    let width = (length / 1e3 * camera.scale) as f32;
    if !(width > 0.0 && width.is_finite()) {
        return;
    }
    let (left, y) = (end[0] - width, end[1] - 4.0);
    canvas.line(&[[left, y], [end[0], y]], 2.0, QUIET);
    canvas.line(&[[left, y - 4.0], [left, y + 4.0]], 2.0, QUIET);
    canvas.line(&[[end[0], y - 4.0], [end[0], y + 4.0]], 2.0, QUIET);
    let at = [end[0] - width / 2.0, y - 9.0];
    let style = Style::new(13.0, QUIET).anchored(Anchor::Middle);
    canvas.text(at, style, &format!("{} mm", label(length)));
}
