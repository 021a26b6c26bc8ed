use nalgebra::{Matrix3, UnitQuaternion};

use super::*;
use crate::graph::joint::factors::Kernel;
use crate::graph::joint::problem::{Felt, Motion};
use crate::space::{Point, Pose};

const POINT: f64 = 1e-3;
const NORMAL: f64 = 0.0873;

/// An object that a first grasp felt all over, and a second one in few places; that one is thought to have
/// been made at another pose.
struct Scene {
    problem: Problem,
    state: State,
    labels: Labels,
    planes: Vec<Plane>,
}

/// By whom, on which face, and where in the object frame.
type Touched = (usize, usize, Point);

impl Scene {
    fn of(dimension: usize, faces: Vec<Face>, touched: &[Touched], at: Pose) -> Scene {
        let felt = |(grasp, face, point): &Touched| {
            let contact = Contact {
                point: *point,
                normal: Some(faces[*face].normal),
                point_deviation: POINT,
                normal_deviation: NORMAL,
            };
            Felt::new(*grasp, contact)
        };
        let planes = faces.iter().enumerate().map(|(i, face)| Plane {
            normal: face.normal,
            offset: face.offset,
            tangents: face.tangents(dimension),
            covariance: Matrix3::zeros(),
            contacts: touched.iter().filter(|t| t.1 == i).count(),
        });
        let motion = |pose: Pose| Motion { pose, deviations: [0.02, 0.35], measured: true };
        let first = touched.iter().filter(|t| t.0 == 0).count();
        Scene {
            planes: planes.collect(),
            labels: touched.iter().map(|t| Some(Owner::Face(t.1))).collect(),
            problem: Problem {
                dimension,
                felt: touched.iter().map(felt).collect(),
                starts: vec![0, first, touched.len()],
                free: Vec::new(),
                motions: vec![motion(Pose::identity()), motion(at)],
                extent: 0.1,
                weight: 1.0,
                edges: false,
                kernel: Kernel::USUAL,
            },
            state: State { poses: vec![Pose::identity(), at], faces, relations: Vec::new() },
        }
    }

    /// A polygon (counter-clockwise, metres), and at which shares of which sides it was felt.
    fn new(corners: &[[f64; 2]], felt: &[(usize, f64)], at: Pose) -> Scene {
        let side = |i: usize| [corner(corners, i), corner(corners, i + 1)];
        let on = |(i, share): (usize, f64)| side(i)[0].lerp(&side(i)[1], share);
        let all = (0..corners.len()).flat_map(|i| [0.05, 0.3, 0.7, 0.95].map(|share| (i, share)));
        let touched: Vec<Touched> = all
            .map(|touch| (0, touch.0, on(touch)))
            .chain(felt.iter().map(|touch| (1, touch.0, on(*touch))))
            .collect();
        Scene::of(2, upright(corners), &touched, at)
    }

    /// A prism 40 mm high about z = 0, felt on its top.
    fn prism(corners: &[[f64; 2]], felt: &[[f64; 2]], at: Pose) -> Scene {
        let mut faces = upright(corners);
        let (top, bottom) = (faces.len(), faces.len() + 1);
        faces.extend([Point::z(), -Point::z()].map(|normal| Face { normal, offset: 0.02 }));
        let centre = (0..top).map(|i| corner(corners, i)).sum::<Point>() / top as f64;
        let mut touched: Vec<Touched> = Vec::new();
        for i in 0..top {
            let [a, b] = [corner(corners, i), corner(corners, i + 1)];
            for (share, height) in [(0.1, -0.015), (0.9, -0.015), (0.5, 0.015)] {
                touched.push((0, i, a.lerp(&b, share) + Point::z() * height));
            }
            for (face, height) in [(top, 0.02), (bottom, -0.02)] {
                touched.push((0, face, centre.lerp(&a, 0.8) + Point::z() * height));
            }
        }
        touched.extend(felt.iter().map(|p| (1, top, Point::new(p[0], p[1], 0.02))));
        Scene::of(3, faces, &touched, at)
    }

    fn confined(&self) -> Confined {
        let (problem, state) = (&self.problem, &self.state);
        match problem.dimension {
            2 => confined::<3>(problem, state, &self.labels, &self.planes),
            _ => confined::<6>(problem, state, &self.labels, &self.planes),
        }
    }

    /// The second grasp's contacts in the object frame of a state.
    fn second(&self, state: &State) -> Vec<Point> {
        self.problem.of(1).map(|i| self.problem.placed(&state.poses, i).point).collect()
    }
}

fn corner(corners: &[[f64; 2]], i: usize) -> Point {
    let [x, y] = corners[i % corners.len()];
    Point::new(x, y, 0.0)
}

/// The faces of a polygon's sides.
fn upright(corners: &[[f64; 2]]) -> Vec<Face> {
    let face = |i: usize| {
        let [a, b] = [corner(corners, i), corner(corners, i + 1)];
        let normal = Point::new(b.y - a.y, a.x - b.x, 0.0).normalize();
        Face { normal, offset: normal.dot(&a) }
    };
    (0..corners.len()).map(face).collect()
}

fn shifted(x: f64, y: f64) -> Pose {
    Pose::translation(x, y, 0.0)
}

const RECTANGLE: [[f64; 2]; 4] = [[-0.05, -0.03], [0.05, -0.03], [0.05, 0.03], [-0.05, 0.03]];
const TRIANGLE: [[f64; 2]; 3] = [[-0.05, -0.03], [0.05, -0.03], [0.0, 0.0566]];
/// The upper right quarter is missing; sides 2 and 3 are those of the hollow.
const HOLLOW: [[f64; 2]; 6] =
    [[-0.04, -0.04], [0.04, -0.04], [0.04, 0.0], [0.0, 0.0], [0.0, 0.04], [-0.04, 0.04]];

#[test]
fn a_grasp_of_two_parallel_sides_slides_no_farther_than_these_end() {
    // The long sides, near their middle, from where they would have to be 12 mm longer.
    let scene = Scene::new(&RECTANGLE, &[(0, 0.45), (0, 0.6), (2, 0.5)], shifted(0.055, 0.0));
    let off = scene.second(&scene.state);
    assert!(off.iter().any(|p| p.x < -0.0595));
    let Confined { state, cost, .. } = scene.confined();
    for p in scene.second(&state) {
        assert!(p.x > -0.0505 && (p.y.abs() - 0.03).abs() < 1e-4, "{p}");
    }
    // Held back, not drawn in, and turned no more than the normals allow.
    assert!(scene.second(&state).iter().any(|p| p.x < -0.0495));
    assert!(state.poses[1].rotation.angle() < 0.01);
    assert_eq!((state.poses[0], &state.faces), (scene.state.poses[0], &scene.state.faces));
    // The motion's: 10 mm of 20, and 0.2 deviations that a contact may be beyond the end.
    assert!((cost - 0.125).abs() < 0.05, "{cost}");
}

#[test]
fn what_lies_on_the_surface_stays_and_costs_nothing() {
    let turned = Pose::from_parts(
        Point::new(0.01, 0.02, 0.0).into(),
        UnitQuaternion::from_scaled_axis(Point::z() * 0.3),
    );
    let mut scene = Scene::new(&HOLLOW, &[(2, 0.4), (3, 0.5), (4, 0.2), (0, 0.8)], turned);
    // Felt where it was, for once.
    for i in scene.problem.of(1) {
        scene.problem.felt[i].contact = scene.problem.felt[i].contact.transformed(&turned);
    }
    let Confined { state, cost, .. } = scene.confined();
    assert!(cost.abs() < 1e-9, "{cost}");
    assert_eq!(state, scene.state);
}

#[test]
fn in_a_hollow_contacts_are_held_out_of_the_material() {
    // Both on the wall that looks to the right, 10 and 20 mm above its foot; thought to be 25 mm lower.
    let scene = Scene::new(&HOLLOW, &[(3, 0.25), (3, 0.5)], shifted(0.0, 0.025));
    assert!(scene.second(&scene.state).iter().all(|p| p.y < 0.0));
    let Confined { state, .. } = scene.confined();
    for p in scene.second(&state) {
        assert!(p.y > -0.5e-3 && p.x.abs() < 1e-3, "{p}");
    }
    let lowest = scene.second(&state).iter().map(|p| p.y).fold(f64::INFINITY, f64::min);
    assert!(lowest < 0.5e-3, "{lowest}");
}

#[test]
fn beyond_a_corner_contacts_go_back_to_both_of_its_sides() {
    let felt = [[-0.04, -0.02], [-0.03, -0.02], [-0.04, -0.01]];
    let scene = Scene::prism(&RECTANGLE, &felt, shifted(0.02, 0.02));
    assert!(scene.second(&scene.state).iter().all(|p| p.x < -0.0495 && p.y < -0.0295));
    let Confined { state, .. } = scene.confined();
    for p in scene.second(&state) {
        assert!(p.x > -0.051 && p.y > -0.031 && (p.z - 0.02).abs() < 1e-3, "{p}");
    }
    let lowest = scene.second(&state).iter().fold(Point::repeat(1.0), |low, p| low.inf(p));
    assert!(lowest.x < -0.049 && lowest.y < -0.029, "{lowest}");
}

#[test]
fn beyond_a_pointed_corner_contacts_are_held_where_they_are_outside() {
    // To the right of the right end, outside the right side and behind the base.
    let felt = [[0.03, -0.025], [0.02, -0.025], [0.02, -0.015]];
    let scene = Scene::prism(&TRIANGLE, &felt, shifted(-0.03, 0.0));
    let base = &scene.state.faces[0];
    assert!(scene.second(&scene.state).iter().all(|p| base.value(p) < -4e-3));
    let Confined { state, .. } = scene.confined();
    for p in scene.second(&state) {
        assert!(scene.state.faces.iter().all(|face| face.value(&p) < 1e-3), "{p}");
    }
}

#[test]
fn fingers_that_touched_nothing_are_held_out_of_the_object() {
    let mut scene = Scene::new(&RECTANGLE, &[(0, 0.45), (0, 0.6), (2, 0.5)], shifted(0.0, 0.0));
    let free = |grasp: usize, x: f64| {
        let contact = Contact { normal: None, ..scene.problem.felt[0].contact };
        Felt::new(grasp, Contact { point: Point::new(x, 0.005, 0.0), ..contact })
    };
    let [outside, inside] = [free(1, 0.06), free(1, 0.035)];
    scene.problem.free = vec![outside];
    let untouched = scene.confined();
    assert_eq!((untouched.state, untouched.cost), (scene.state.clone(), 0.0));
    // 15 mm within the right side, and the motion says little.
    scene.problem.free = vec![outside, inside];
    let Confined { state, cost, .. } = scene.confined();
    let placed = inside.contact.transformed(&state.poses[1].inverse()).point;
    assert!(placed.x > 0.0495 && placed.x < 0.0505, "{placed}");
    assert!(scene.second(&state).iter().all(|p| (p.y.abs() - 0.03).abs() < 5e-4));
    assert!(cost > 0.2 && cost < 1.0, "{cost}");
    // The first pose defines the frame: nothing gives way, and the finger counts as one wild contact.
    scene.problem.free = vec![free(0, 0.035)];
    let Confined { state, cost, .. } = scene.confined();
    let contact = &scene.problem.free[0].contact;
    let most = scene.problem.unexplained(contact) - scene.problem.exact(contact);
    assert_eq!(state, scene.state);
    assert!((cost - most).abs() < 1e-9, "{cost} {most}");
}

#[test]
fn what_hangs_in_the_air_belongs_to_the_grasp_that_felt_it() {
    let mut scene = Scene::new(&RECTANGLE, &[(0, 0.3), (0, 0.7)], shifted(0.0, 0.0));
    assert!(scene.confined().hanging.iter().all(|nats| nats.abs() < 1e-9));
    let last = scene.problem.felt.len() - 1;
    let most = spared(&scene.problem, &scene.problem.felt[last].contact);
    // On nothing: what it would spare on a face, though that is no cost of where faces end.
    scene.labels[last] = None;
    let Confined { cost, hanging, .. } = scene.confined();
    assert!(cost.abs() < 1e-9, "{cost}");
    assert!(hanging[0].abs() < 1e-9 && (hanging[1] - most).abs() < 1e-9, "{hanging:?}");
    // Far beyond the end of its face.
    scene.labels[last] = Some(Owner::Face(0));
    scene.problem.felt[last].contact.point.x += 0.1;
    let Confined { cost, hanging, .. } = scene.confined();
    assert!(hanging[1] > most && hanging[1] > 0.9 * cost, "{hanging:?} {cost}");
    // A grasp held back hangs as well: its motion says otherwise.
    let slid = Scene::new(&RECTANGLE, &[(0, 0.45), (0, 0.6), (2, 0.5)], shifted(0.055, 0.0));
    let Confined { cost, hanging, .. } = slid.confined();
    assert!(hanging[1] > 0.5 * cost && cost > 0.05, "{hanging:?} {cost}");
}

#[test]
fn contacts_that_no_surface_can_hold_cost_what_unexplained_ones_do() {
    // A hundred deviations apart, and the motion knows better.
    let mut scene = Scene::new(&RECTANGLE, &[(0, 0.0), (0, 1.0)], shifted(0.0, 0.0));
    let last = scene.problem.felt.len() - 1;
    scene.problem.felt[last].contact.point.x += 0.1;
    let felt = &scene.problem.felt[last].contact;
    let most = scene.problem.unexplained(felt) - scene.problem.exact(felt);
    // Half of the way for either end, or one of them right and the other off altogether.
    let cost = scene.confined().cost;
    assert!(cost > most && cost < 3.5 * most, "{cost} {most}");
    // One side alone makes no object: nothing lies on it.
    let one = Scene::new(&RECTANGLE, &[(0, 0.5)], shifted(0.055, 0.0));
    let owner = |label: &Option<Owner>| label.filter(|o| *o == Owner::Face(0));
    let labels: Labels = one.labels.iter().map(owner).collect();
    let state = State { faces: one.state.faces[..1].to_vec(), ..one.state.clone() };
    let Confined { state: after, cost, .. } =
        confined::<3>(&one.problem, &state, &labels, &one.planes[..1]);
    assert_eq!(after, state);
    let on = labels.iter().flatten().count() as f64;
    assert!(on == 5.0 && (cost - on * most).abs() < 1e-6, "{cost} {on} {most}");
}
