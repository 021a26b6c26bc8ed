//! Closed meshes of a spatial field: naive surface nets, then every vertex moved onto the field, and onto
//! its edges and corners.

use std::collections::HashMap;

use fast_surface_nets::ndshape::RuntimeShape;
use fast_surface_nets::{SurfaceNetsBuffer, surface_nets};

use super::contour::components_touched;
use super::lattice::{Lattice, LatticeError, Samples, deviations_at};
use super::mend::mend;
use super::settle::settle;
use super::sharpen::sharpen;
use super::sheets::separate;
use super::{Field, Mesh};
use crate::space::Point;

/// The zero set of a spatial field.
#[derive(Clone, Debug)]
pub struct Surface {
    /// Watertight: where sheets meet in an edge or a vertex, each has vertices of its own there.
    /// Counter-clockwise seen from outside.
    pub mesh: Mesh,
    /// Standard deviation along the normal at each vertex, metres, as the field gives it.
    pub deviations: Vec<f64>,
    /// Whether the object reaches the edge of the box and was cut off there.
    pub clipped: bool,
}

/// The whole zero set of `field` within the box `bounds` (corners, metres) on a lattice `spacing`
/// metres apart. Vertices are moved along the field's gradient by at most half a spacing
/// until the field there is below a ten-thousandth of the spacing, which smooth fields reach; where
/// the surface turns by more than 26° between neighbours, by up to a spacing more, so that edges and
/// corners are not cut off. An object that reaches the edge of the box is closed along it. Every
/// component is kept, see [`Surface::touched`].
pub fn extract(
    field: &dyn Field,
    bounds: (Point, Point),
    spacing: f64,
) -> Result<Surface, LatticeError> {
    let (mesh, clipped) = mesh(field, bounds, spacing)?;
    let deviations = deviations_at(field, mesh.vertices());
    Ok(Surface { mesh, deviations, clipped })
}

/// As [`extract`], without the deviations, which for a Gaussian process cost more than all the
/// rest: the mesh, and whether it was cut off at the edge of the box.
pub fn mesh(
    field: &dyn Field,
    bounds: (Point, Point),
    spacing: f64,
) -> Result<(Mesh, bool), LatticeError> {
    let lattice = Lattice::new(bounds, spacing, 3)?;
    Ok(polygonise(field, &lattice, lattice.sample(field)))
}

/// Surface nets over the samples, every vertex moved onto the field.
fn polygonise(field: &dyn Field, lattice: &Lattice, samples: Samples) -> (Mesh, bool) {
    let spacing = lattice.spacing();
    let counts = lattice.counts().map(|n| n as u32);
    // In spacings, so that the narrower type of the nets loses nothing that matters.
    let scaled: Vec<f32> = samples.values.iter().map(|v| (v / spacing) as f32).collect();
    let mut nets = SurfaceNetsBuffer::default();
    let shape = RuntimeShape::<u32, 3>::new(counts);
    surface_nets(&scaled, &shape, [0; 3], counts.map(|n| n - 1), &mut nets);

    let mut vertices: Vec<Point> =
        nets.positions.iter().map(|p| lattice.position(p.map(f64::from))).collect();
    // The cells of the outermost layer close what was cut off: there is no field to follow there.
    let free: Vec<usize> = (0..vertices.len())
        .filter(|v| {
            let cell = nets.surface_points[*v].map(|i| i as usize);
            !lattice.is_within(1, cell) && !lattice.is_within(1, cell.map(|i| i + 1))
        })
        .collect();
    let gradients = settle(field, spacing, &free, &mut vertices);
    let mut normals = vec![Point::repeat(f64::NAN); vertices.len()];
    free.iter().zip(gradients).for_each(|(v, own)| normals[*v] = own.normalize());

    let mut triangles: Vec<[u32; 3]> =
        nets.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
    sharpen(field, spacing, &normals, &mut vertices, &mut triangles);
    let beyond: Vec<usize> =
        triangles.chunks_exact(2).map(|pair| outside(lattice, &nets, &scaled, pair)).collect();
    let names = separate(&mut triangles, &beyond);
    let between = |all: &[Point]| -> Vec<Point> {
        names.iter().map(|[a, b]| (all[*a as usize] + all[*b as usize]) / 2.0).collect()
    };
    let (vertices, triangles) = mend(spacing, between(&vertices), between(&normals), triangles);
    (Mesh::trusted(vertices, triangles), samples.clipped)
}

/// The node on the outside of a quadrilateral of the nets.
fn outside(
    lattice: &Lattice,
    nets: &SurfaceNetsBuffer,
    values: &[f32],
    pair: &[[u32; 3]],
) -> usize {
    let cells = || pair.iter().flatten().map(|v| nets.surface_points[*v as usize]);
    let last = cells().fold([0; 3], |last, cell| [0, 1, 2].map(|a| cell[a].max(last[a])));
    let mut nodes = [last.map(|i| i as usize); 2];
    // Its four cells lie around this axis.
    let along = (0..3).filter(|axis| cells().all(|cell| cell[*axis] == last[*axis]));
    along.for_each(|axis| nodes[1][axis] += 1);
    let [a, b] = nodes.map(|node| lattice.index(node));
    if values[a] < 0.0 { b } else { a }
}

impl Surface {
    /// Only the components that were touched: each contact (object frame, metres) votes for the
    /// component it is nearest to, and components with a tenth of the votes stay, as does the one
    /// with the most. Without contacts, the component around the largest volume.
    pub fn touched(&self, contacts: &[Point]) -> Surface {
        let (component, count) = self.components();
        let mut clouds = vec![Vec::new(); count];
        for (vertex, c) in self.mesh.vertices().iter().zip(&component) {
            clouds[*c].push(*vertex);
        }
        let mut volumes = vec![0.0; count];
        for t in self.mesh.triangles() {
            let [a, b, c] = t.map(|v| self.mesh.vertices()[v as usize]);
            volumes[component[t[0] as usize]] += a.dot(&b.cross(&c)) / 6.0;
        }
        let keep = components_touched(&clouds, &volumes, contacts);
        let mut renamed = vec![0; component.len()];
        let mut vertices = Vec::new();
        let mut deviations = Vec::new();
        for (v, c) in component.iter().enumerate() {
            if keep[*c] {
                renamed[v] = vertices.len() as u32;
                vertices.push(self.mesh.vertices()[v]);
                deviations.push(self.deviations[v]);
            }
        }
        let kept = self.mesh.triangles().iter().filter(|t| keep[component[t[0] as usize]]);
        let triangles = kept.map(|t| t.map(|v| renamed[v as usize])).collect();
        Surface { mesh: Mesh::trusted(vertices, triangles), deviations, clipped: self.clipped }
    }

    /// Only the component around the largest volume.
    pub fn largest(&self) -> Surface {
        self.touched(&[])
    }

    /// The connected component of each vertex, and how many there are. Sheets that meet are connected.
    fn components(&self) -> (Vec<usize>, usize) {
        let mut groups = Groups::new(self.mesh.vertices().len());
        let mut first = HashMap::new();
        for (v, place) in (0..).zip(self.mesh.vertices()) {
            groups.join(v, *first.entry(place.map(f64::to_bits)).or_insert(v));
        }
        for t in self.mesh.triangles() {
            groups.join(t[0], t[1]);
            groups.join(t[0], t[2]);
        }
        let mut numbers = HashMap::new();
        let component = (0..self.mesh.vertices().len() as u32)
            .map(|v| {
                let next = numbers.len();
                *numbers.entry(groups.root(v)).or_insert(next)
            })
            .collect();
        (component, numbers.len())
    }
}

/// Disjoint sets of vertices.
pub(super) struct Groups(Vec<u32>);

impl Groups {
    pub(super) fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    pub(super) fn root(&mut self, mut v: u32) -> u32 {
        while self.0[v as usize] != v {
            let above = self.0[self.0[v as usize] as usize];
            self.0[v as usize] = above;
            v = above;
        }
        v
    }

    pub(super) fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::shape::mesh::tests::folds;
    use nalgebra::Rotation3;
    use proptest::prelude::*;

    struct Analytic<F>(F);

    impl<F: Fn(&Point) -> f64 + Sync> Field for Analytic<F> {
        fn values(&self, points: &[Point]) -> Vec<f64> {
            points.iter().map(&self.0).collect()
        }

        fn deviations(&self, points: &[Point]) -> Vec<f64> {
            points.iter().map(|p| p.z.abs()).collect()
        }
    }

    fn trace(f: impl Fn(&Point) -> f64 + Sync, half: f64, spacing: f64) -> Surface {
        let corner = Point::new(half, half, half);
        extract(&Analytic(f), (-corner, corner), spacing).unwrap()
    }

    fn assert_sound(mesh: &Mesh) {
        assert!(mesh.is_watertight());
        assert_eq!(folds(mesh), 0);
        assert!(smallest_area(mesh) > 0.0);
    }

    fn euler(mesh: &Mesh) -> i64 {
        let vertices = mesh.vertices().len() as i64;
        let faces = mesh.triangles().len() as i64;
        vertices - faces * 3 / 2 + faces
    }

    fn smallest_area(mesh: &Mesh) -> f64 {
        let areas = mesh.triangles().iter().map(|t| {
            let [a, b, c] = t.map(|v| mesh.vertices()[v as usize]);
            (b - a).cross(&(c - a)).norm() / 2.0
        });
        areas.fold(f64::INFINITY, f64::min)
    }

    fn torus(p: &Point) -> f64 {
        (p.xy().norm() - 0.04).hypot(p.z) - 0.015
    }

    #[test]
    fn a_sphere_is_closed_outward_and_on_the_field() {
        let surface = trace(|p| p.norm() - 0.05, 0.06, 0.005);
        assert_sound(&surface.mesh);
        assert_eq!(euler(&surface.mesh), 2);
        assert!(!surface.clipped);
        for v in surface.mesh.vertices() {
            assert!((v.norm() - 0.05).abs() < 1e-6);
        }
        let exact = 4.0 / 3.0 * std::f64::consts::PI * 0.05_f64.powi(3);
        let ratio = surface.mesh.volume() / exact;
        assert!(ratio < 1.0 && ratio > 0.985, "{ratio}");
        assert_eq!(surface.deviations.len(), surface.mesh.vertices().len());
        assert_eq!(surface.deviations[7], surface.mesh.vertices()[7].z.abs());
    }

    #[test]
    fn a_torus_keeps_its_hole() {
        let surface = trace(torus, 0.06, 0.004);
        assert_sound(&surface.mesh);
        assert_eq!(euler(&surface.mesh), 0);
        for v in surface.mesh.vertices() {
            assert!(torus(v).abs() < 1e-6, "{v:?} {}", torus(v));
        }
        let exact = 2.0 * std::f64::consts::PI.powi(2) * 0.04 * 0.015 * 0.015;
        assert!((surface.mesh.volume() / exact - 1.0).abs() < 0.04);
        assert!(smallest_area(&surface.mesh) > 1e-9 * 0.004 * 0.004);
    }

    #[test]
    fn a_field_far_from_a_distance_is_still_met() {
        let f = |p: &Point| {
            let q = Point::new(p.x / 0.05, p.y / 0.03, p.z / 0.02);
            0.02 * (q.norm_squared().powi(2) - 1.0)
        };
        let surface = trace(f, 0.06, 0.003);
        assert_sound(&surface.mesh);
        let worst = surface.mesh.vertices().iter().map(|v| f(v).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-6, "{worst}");
    }

    #[test]
    fn a_box_is_closed_although_its_edges_are_sharp() {
        let f = |p: &Point| (p.x.abs() - 0.05).max((p.y.abs() - 0.03).max(p.z.abs() - 0.02));
        // The faces lie on nodes of the lattice, so nets put vertices on top of one another.
        let surface = trace(f, 0.06, 0.005);
        assert_sound(&surface.mesh);
        assert_eq!(euler(&surface.mesh), 2);
        assert!((surface.mesh.volume() / (0.1 * 0.06 * 0.04) - 1.0).abs() < 0.03);
    }

    #[test]
    fn edges_and_corners_are_not_cut_off() {
        let half = Point::new(0.05, 0.03, 0.02);
        let askew = Rotation3::from_euler_angles(0.3, 0.5, -0.8);
        let block = |p: &Point| (askew * p).abs().zip_map(&half, |p, h| p - h).max();
        let block = trace(block, 0.07, 0.005).mesh;
        let can = |p: &Point| {
            let p = askew * p;
            (p.xy().norm() - 0.04).max(p.z.abs() - 0.035)
        };
        let round = trace(can, 0.06, 0.004).mesh;
        [&block, &round].into_iter().for_each(assert_sound);
        assert!((block.volume() / (8.0 * half.product()) - 1.0).abs() < 1e-6);
        // Of the rim nothing is missing but what chords cut off.
        for angle in 0..200 {
            let (sin, cos) = (TAU * f64::from(angle) / 200.0).sin_cos();
            let on_rim = askew.inverse() * Point::new(0.04 * cos, 0.04 * sin, 0.035);
            assert!(round.distance(&on_rim) < 1e-4, "{}", round.distance(&on_rim));
        }
        assert!(round.vertices().iter().all(|v| can(v).abs() < 1e-5));
    }

    #[test]
    fn whatever_way_they_lie_bodies_with_edges_are_watertight_and_not_folded() {
        for turn in 0..4 {
            let turn = f64::from(turn);
            let askew = Rotation3::from_euler_angles(0.3 + turn, 0.5 * turn, 0.7 - 0.4 * turn);
            let block =
                move |p: &Point| (p.x.abs() - 0.03).max(p.y.abs() - 0.024).max(p.z.abs() - 0.018);
            let can = |p: &Point| (p.xy().norm() - 0.025).max(p.z.abs() - 0.03);
            let nut = |p: &Point| {
                let sides = (0..6).map(|i| (TAU * f64::from(i) / 6.0).sin_cos());
                let sides = sides.map(|(sin, cos)| cos * p.x + sin * p.y - 0.028);
                sides.fold(p.z.abs() - 0.02, f64::max)
            };
            // One end of many faces, as bodies by chance have.
            let gem = move |p: &Point| {
                let faces = (0..9).map(|i| {
                    let (sin, cos) = (2.4 * f64::from(i) + turn).sin_cos();
                    let height = 0.1 + 0.09 * f64::from(i);
                    let flat = (1.0 - height * height).sqrt();
                    flat * (cos * p.x + sin * p.y) + height * p.z - 0.025
                });
                faces.fold(block(p), f64::max)
            };
            let bodies: [&(dyn Fn(&Point) -> f64 + Sync); 4] = [&block, &can, &nut, &gem];
            for (i, body) in bodies.into_iter().enumerate() {
                let there = |p: &Point| body(&(askew * p));
                let mesh = trace(there, 0.05, 0.0027).mesh;
                assert_sound(&mesh);
                assert_eq!(euler(&mesh), 2);
                // Its edges are still there: nothing lies beneath the surface but what chords cut off,
                // and edges that are not sharp, of which the last has some.
                let depths = mesh.triangles().iter().map(|t| {
                    let corners = t.iter().map(|v| mesh.vertices()[*v as usize]);
                    there(&(corners.sum::<Point>() / 3.0))
                });
                let deepest = depths.fold(0.0, f64::min);
                assert!(deepest > -1.2e-4 || i == 3, "{turn} {deepest}");
            }
        }
    }

    #[test]
    fn sheets_that_meet_have_vertices_of_their_own() {
        // Two quarters of a ball that meet in an edge across the lattice, and two balls in one node.
        let quarters = |p: &Point| (p.norm() - 0.03).max(p.x * p.y / 0.03);
        let apart = Point::repeat(0.012);
        let balls = |p: &Point| ((p - apart).norm().min((p + apart).norm())) - apart.norm();
        let fields: [&(dyn Fn(&Point) -> f64 + Sync); 2] = [&quarters, &balls];
        for (half, field) in
            [0.0405, 0.0422, 0.043].into_iter().flat_map(|h| fields.map(|f| (h, f)))
        {
            let surface = trace(field, half, 0.003);
            assert!(surface.mesh.is_watertight());
            assert!(smallest_area(&surface.mesh) > 0.0);
            // They stay together.
            let whole = surface.largest();
            assert!(whole.mesh.volume() > 0.9 * surface.mesh.volume());
        }
    }

    #[test]
    fn the_edge_of_a_hollow_is_kept_too() {
        // A block without the quarter where both x and y are above 1.3 mm.
        let ell = |p: &Point| {
            let block = (p.x.abs().max(p.y.abs()) - 0.04).max(p.z.abs() - 0.02);
            block.max(p.x.min(p.y) - 0.0013)
        };
        let mesh = trace(ell, 0.05, 0.004).mesh;
        assert_sound(&mesh);
        let exact = 0.08 * 0.08 * 0.04 - (0.04 - 0.0013_f64).powi(2) * 0.04;
        assert!((mesh.volume() / exact - 1.0).abs() < 1e-6, "{}", mesh.volume() / exact);
    }

    #[test]
    fn an_object_that_reaches_the_edge_is_closed_there() {
        let surface = trace(|p| p.x, 0.02, 0.004);
        assert!(surface.clipped);
        assert_sound(&surface.mesh);
        assert!(surface.mesh.volume() > 0.0);
    }

    #[test]
    fn nothing_and_not_a_number_are_empty_meshes() {
        assert!(trace(|_| 1.0, 0.02, 0.004).mesh.triangles().is_empty());
        let surface = trace(|_| f64::NAN, 0.02, 0.004);
        assert!(surface.mesh.vertices().is_empty() && surface.deviations.is_empty());
    }

    #[test]
    fn only_touched_components_stay() {
        let two = |p: &Point| {
            let small = (p - Point::new(-0.03, 0.0, 0.0)).norm() - 0.012;
            let large = (p - Point::new(0.03, 0.0, 0.0)).norm() - 0.02;
            small.min(large)
        };
        let surface = trace(two, 0.06, 0.004);
        let small =
            surface.touched(&[Point::new(-0.03, 0.0125, 0.0), Point::new(-0.042, 0.0, 0.0)]);
        assert_sound(&small.mesh);
        assert_eq!(euler(&small.mesh), 2);
        assert!(small.mesh.vertices().iter().all(|v| v.x < 0.0));
        assert_eq!(small.deviations.len(), small.mesh.vertices().len());
        assert_eq!(small.deviations[5], small.mesh.vertices()[5].z.abs());
        assert!(surface.largest().mesh.vertices().iter().all(|v| v.x > 0.0));
    }

    #[test]
    fn the_same_field_gives_the_same_mesh() {
        let (a, b) = (trace(torus, 0.06, 0.005), trace(torus, 0.06, 0.005));
        assert_eq!(a.mesh.vertices(), b.mesh.vertices());
        assert_eq!(a.mesh.triangles(), b.mesh.triangles());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]
        #[test]
        fn any_landscape_is_closed(
            waves in proptest::array::uniform4((30.0..120.0, 30.0..120.0, 30.0..120.0, 0.0..6.3)),
        ) {
            // Far too coarse a lattice: sheets meet, and the object is cut off all around.
            let f = |p: &Point| {
                let wave = |(a, b, c, phase): &(f64, f64, f64, f64)| {
                    (a * p.x + phase).sin() * (b * p.y).cos() * (c * p.z + 0.3).cos()
                };
                0.01 * waves.iter().map(wave).sum::<f64>() + 1e-3
            };
            let surface = trace(f, 0.06, 0.008);
            prop_assert!(surface.mesh.is_watertight());
            prop_assert!(surface.mesh.volume() > 0.0);
            prop_assert!(smallest_area(&surface.mesh) > 0.0);
            let touched = surface.touched(&surface.mesh.vertices()[..1]);
            prop_assert!(touched.mesh.is_watertight());
        }
    }
}
