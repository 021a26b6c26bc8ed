use std::f64::consts::TAU;

use super::*;
use crate::shape::mesh::tests::cuboid;
use crate::shape::{Field, Mesh, Outline, contour, surface};
use crate::view::drawing::elements;

/// A rounded box, bulged a little where nobody has touched it.
struct Blob {
    half: Point,
}

impl Field for Blob {
    fn values(&self, points: &[Point]) -> Vec<f64> {
        let box_of = |p: &Point| {
            let q = p.abs() - (self.half - Point::repeat(0.008));
            q.sup(&Point::zeros()).norm() + q.max().min(0.0) - 0.008
        };
        let wave = |p: &Point| 0.0015 * (40.0 * p.x + 1.0).sin() * (55.0 * (p.y + p.z)).cos();
        points.iter().map(|p| box_of(p) + wave(p)).collect()
    }

    fn deviations(&self, points: &[Point]) -> Vec<f64> {
        points.iter().map(|p| 0.0004 + 0.05 * (p.x - 0.03).abs().powi(2) / 0.1).collect()
    }
}

fn rectangle() -> Geometry {
    let vertices = vec![[-0.06, -0.03], [0.06, -0.03], [0.06, 0.03], [-0.06, 0.03]];
    Geometry::Outline(Outline { loops: vec![vertices] })
}

fn figures() -> Vec<(String, String)> {
    [
        ("Hausdorff, aligned", "3.2 mm"),
        ("mean distance", "1.1 mm"),
        ("pose rms", "2.4 mm · 1.9°"),
        ("contacts to surface", "0.8 mm"),
        ("time", "0.42 s"),
    ]
    .map(|(name, value)| (name.into(), value.into()))
    .into()
}

fn planar() -> Summary {
    let bounds = (Point::new(-0.08, -0.05, 0.0), Point::new(0.08, 0.05, 0.0));
    let field = Blob { half: Point::new(0.06, 0.03, 1.0) };
    let traced = contour::extract(&field, bounds, 0.001).unwrap();
    let loop_ = &traced.outline.loops[0];
    let contacts = (0..40)
        .map(|i| {
            let at = (i * 7919 + i / 5 * 31) % loop_.len();
            let (a, b) = (loop_[at], loop_[(at + 1) % loop_.len()]);
            let normal = Point::new(b[1] - a[1], a[0] - b[0], 0.0).normalize();
            (
                Point::new(a[0], a[1], 0.0) + normal * 0.001 * f64::from(i as u32).sin(),
                Some(normal),
                i / 5,
            )
        })
        .collect();
    Summary {
        title: "A rectangle of 120 × 60 mm from 8 grasps".into(),
        figures: figures(),
        truth: Some(rectangle()),
        estimate: Geometry::Outline(traced.outline),
        deviations: traced.deviations,
        contacts,
        pose_errors: Some(vec![
            (0.0, 0.0),
            (1.2, 0.5),
            (2.6, 1.9),
            (2.2, 3.1),
            (1.9, 2.0),
            (1.4, 1.2),
            (1.0, 0.8),
            (1.1, 0.9),
        ]),
    }
}

fn spatial() -> Summary {
    let half = Point::new(0.06, 0.03, 0.03);
    let corner = half + Point::repeat(0.012);
    let traced = surface::extract(&Blob { half }, (-corner, corner), 0.003).unwrap();
    let contacts = (0..60)
        .map(|i| {
            let at = (i * 7919) % traced.mesh.vertices().len();
            let p = traced.mesh.vertices()[at];
            let q = p.component_div(&half);
            let axis = q.iamax();
            let mut normal = Point::zeros();
            normal[axis] = q[axis].signum();
            (p, Some(normal), i / 5)
        })
        .collect();
    Summary {
        title: "A box of 120 × 60 × 60 mm from 12 grasps".into(),
        figures: figures(),
        truth: Some(Geometry::Mesh(cuboid(half.into()))),
        estimate: Geometry::Mesh(traced.mesh),
        deviations: traced.deviations,
        contacts,
        pose_errors: Some(
            (0..12).map(|i| (3.0 * f64::from(i).sin().abs(), 0.3 * f64::from(i))).collect(),
        ),
    }
}

/// The decoded picture; checks its size and that something is in it.
fn decoded(summary: &Summary) -> tiny_skia::Pixmap {
    let drawing = render(summary).unwrap();
    let svg = drawing.svg();
    elements(&svg).unwrap();
    // Pixels are text too, of any letters.
    let written = || svg.split('"').filter(|text| !text.starts_with("data:"));
    assert!(written().all(|text| !text.contains("NaN") && !text.ends_with("inf")));
    let picture = tiny_skia::Pixmap::decode_png(&drawing.png().unwrap()).unwrap();
    assert_eq!((picture.width(), picture.height()), SIZE);
    let first = picture.pixels()[0];
    assert!(picture.pixels().iter().filter(|p| **p != first).count() > 10_000);
    picture
}

fn count_near(picture: &tiny_skia::Pixmap, colour: colour::Colour) -> usize {
    let wanted = colour.0.map(|c| c * 255.0);
    let near = |p: &&tiny_skia::PremultipliedColorU8| {
        let found = [p.red(), p.green(), p.blue()];
        (0..3).all(|i| (f32::from(found[i]) - wanted[i]).abs() < 3.0)
    };
    picture.pixels().iter().filter(near).count()
}

/// Writes the pictures where `TACTILE_PICTURES` says, to be looked at.
fn keep(name: &str, summary: &Summary) {
    if let Some(folder) = std::env::var_os("TACTILE_PICTURES") {
        let path = std::path::Path::new(&folder).join(name);
        let drawing = render(summary).unwrap();
        std::fs::write(path.with_extension("svg"), drawing.svg()).unwrap();
        std::fs::write(path, drawing.png().unwrap()).unwrap();
    }
}

#[test]
fn a_planar_summary_shows_truth_estimate_and_contacts() {
    let summary = planar();
    keep("planar.png", &summary);
    let picture = decoded(&summary);
    let dark = count_near(&picture, TRUTH);
    assert!(count_near(&picture, colour::grasp(7, 8)) > 200);
    let mut blind = summary.clone();
    blind.truth = None;
    blind.contacts.clear();
    let picture = decoded(&blind);
    let text = count_near(&picture, TRUTH);
    assert!(dark > text + 1_500, "{dark} {text}");
    assert_eq!(count_near(&picture, colour::grasp(3, 8)), 0);
}

#[test]
fn a_spatial_summary_shows_the_mesh_from_three_sides() {
    let summary = spatial();
    keep("spatial.png", &summary);
    let picture = decoded(&summary);
    let coloured = picture.pixels().iter().filter(|p| p.red().abs_diff(p.blue()) > 60).count();
    assert!(coloured > 60_000, "{coloured}");
    assert!(count_near(&picture, TRUTH) > 1_000);
}

#[test]
fn without_poses_the_spread_of_the_uncertainty_is_shown() {
    let mut summary = planar();
    summary.pose_errors = None;
    summary.truth = None;
    keep("no-truth.png", &summary);
    decoded(&summary);
}

#[test]
fn a_round_true_mesh_is_drawn_by_its_silhouette() {
    let ring = |k: usize, i: usize| {
        let (turn, rise) = (TAU * i as f64 / 24.0, std::f64::consts::PI * k as f64 / 12.0);
        Point::new(turn.cos() * rise.sin(), turn.sin() * rise.sin(), rise.cos()) * 0.04
    };
    let vertices = (0..=12).flat_map(|k| (0..24).map(move |i| ring(k, i))).collect();
    let mut triangles = Vec::new();
    for k in 0..12u32 {
        for i in 0..24u32 {
            let (a, b) = (k * 24 + i, k * 24 + (i + 1) % 24);
            triangles.extend([[a, a + 24, b], [b, a + 24, b + 24]]);
        }
    }
    let mut summary = spatial();
    summary.truth = Some(Geometry::Mesh(Mesh::new(vertices, triangles).unwrap()));
    keep("round.png", &summary);
    decoded(&summary);
}

#[test]
fn nothing_at_all_is_still_a_picture() {
    for estimate in [
        Geometry::Outline(Outline { loops: vec![] }),
        Geometry::Mesh(Mesh::new(vec![], vec![]).unwrap()),
    ] {
        let mut summary = Summary {
            title: String::new(),
            figures: vec![],
            truth: None,
            estimate,
            deviations: vec![],
            contacts: vec![],
            pose_errors: None,
        };
        decoded(&summary);
        summary.contacts.push((Point::new(0.01, 0.02, 0.0), Some(Point::x()), 0));
        keep("one-contact.png", &summary);
        decoded(&summary);
    }
}

#[test]
fn absurd_numbers_do_not_stop_the_picture() {
    for mut summary in [planar(), spatial()] {
        summary.deviations.iter_mut().step_by(3).for_each(|d| *d = f64::NAN);
        summary.deviations.truncate(100);
        summary.deviations.extend([f64::INFINITY, -1.0, 1e300]);
        summary.contacts.push((Point::new(1e9, 0.0, 0.0), None, 3));
        summary.contacts.push((Point::repeat(f64::NAN), Some(Point::repeat(f64::NAN)), 900));
        summary.pose_errors = Some(vec![(f64::NAN, 1.0), (f64::INFINITY, -3.0), (1e12, 0.0)]);
        summary.title = "…very long title ".repeat(40);
        summary.figures = vec![("figure".repeat(30), "1".repeat(300)); 3];
        keep(
            if matches!(summary.estimate, Geometry::Mesh(_)) {
                "absurd3.png"
            } else {
                "absurd.png"
            },
            &summary,
        );
        decoded(&summary);
    }
    let mut summary = planar();
    summary.estimate = Geometry::Outline(Outline { loops: vec![vec![[f64::NAN, 0.0]; 5]] });
    decoded(&summary);
}

#[test]
fn the_colour_scale_ends_at_a_round_figure() {
    let deviations: Vec<f64> = (0..100).map(|i| f64::from(i) * 1e-5).collect();
    assert!((scale_end(&deviations) - 1e-3).abs() < 1e-12);
    assert!((scale_end(&[]) - 1e-3).abs() < 1e-12);
    assert!((scale_end(&[f64::NAN, 0.004]) - 4e-3).abs() < 1e-12);
}

#[test]
fn a_far_contact_does_not_shrink_the_picture() {
    let mut summary = planar();
    let before = Shown::new(&summary).bounds;
    summary.contacts.push((Point::new(3.0, 0.0, 0.0), None, 1));
    let after = Shown::new(&summary);
    assert_eq!(after.bounds, before);
    assert_eq!(after.left_out, 1);
}
