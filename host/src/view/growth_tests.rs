use super::*;

fn felt(grasps: &[usize]) -> Vec<Placed> {
    let contact = Contact {
        point: Point::zeros(),
        normal: None,
        point_deviation: 1e-3,
        normal_deviation: 0.1,
    };
    let of = |(grasp, count): (usize, &usize)| vec![Placed { contact, grasp }; *count];
    grasps.iter().enumerate().flat_map(of).collect()
}

fn cube() -> Mesh {
    let corner = |i: usize| Point::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2 & 1) as f64);
    let quads =
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    Mesh::new((0..8).map(corner).collect(), triangles).unwrap()
}

#[test]
fn moments_come_after_whole_grasps_and_closer_at_the_start() {
    // Two contacts are too few, a grasp without contacts teaches nothing, the last one has the final
    // surface.
    assert_eq!(moments(&felt(&[2, 0, 3, 5, 4])), [(2, 5), (3, 10)]);
    assert!(moments(&felt(&[9])).is_empty());
    assert!(moments(&[]).is_empty());
    let many = moments(&felt(&[5; 100]));
    assert_eq!(many.len(), MOMENTS);
    assert_eq!(many.first(), Some(&(0, 5)));
    assert_eq!(many.last(), Some(&(98, 495)));
    let steps: Vec<usize> = many.windows(2).map(|w| w[1].0 - w[0].0).collect();
    assert!(steps.is_sorted(), "{steps:?}");
}

#[test]
fn what_does_not_close_is_shown_about_the_contacts() {
    let at = |x: f64, y: f64| Contact {
        point: Point::new(x, y, 0.0),
        normal: None,
        point_deviation: 1e-3,
        normal_deviation: 0.1,
    };
    let contacts = [at(0.0, 0.0), at(0.2, 0.1)];
    let closed = subdivided(&cube(), 0.05);
    let deviations: Vec<f64> = (0..closed.vertices().len()).map(|i| i as f64).collect();
    let (Geometry::Mesh(whole), _) = about(closed.clone(), deviations.clone(), &contacts) else {
        panic!()
    };
    assert_eq!(whole.triangles(), closed.triangles(), "it closes");

    let triangles = closed.triangles()[1..].to_vec();
    let open = Mesh::new(closed.vertices().to_vec(), triangles).unwrap();
    let (Geometry::Mesh(near), left) = about(open, deviations, &contacts) else { panic!() };
    let (low, high) = near.bounds();
    let beyond = AROUND * 0.2;
    assert!(low.min() >= -beyond && high.x <= 0.2 + beyond && high.y <= 0.1 + beyond, "{high}");
    assert!(high.x > 0.2 && !near.triangles().is_empty());
    // Each vertex keeps its deviation, and none is left that no triangle has.
    assert_eq!(left.len(), near.vertices().len());
    for (vertex, deviation) in near.vertices().iter().zip(&left) {
        assert_eq!(*vertex, closed.vertices()[*deviation as usize]);
    }
    let used: std::collections::BTreeSet<u32> =
        near.triangles().iter().flatten().copied().collect();
    assert_eq!(used.len(), near.vertices().len());
}

#[test]
fn vague_free_points_open_no_faces() {
    let side = |i: usize| {
        let (sin, cos) = (std::f64::consts::FRAC_PI_2 * i as f64).sin_cos();
        let out = Point::new(cos, sin, 0.0);
        [-0.03, -0.01, 0.01, 0.03].map(|along| Contact {
            point: out * 0.04 + Point::new(-sin, cos, 0.0) * along,
            normal: Some(out),
            point_deviation: 1e-3,
            normal_deviation: 0.05,
        })
    };
    let contacts: Vec<Contact> = (0..4).flat_map(side).collect();
    let at = |i: usize| Point::new(0.002 * i as f64 - 0.02, 0.0, 0.0);
    let free: Vec<Free> = (0..FREE).map(|i| Free { point: at(i), deviation: 0.03 }).collect();
    let (alone, _) = coarse(2, &contacts, &[], true).unwrap();
    let (beside, _) = coarse(2, &contacts, &free, true).unwrap();
    assert_eq!(beside.bounds(), alone.bounds());
    assert!((alone.size() - 0.32).abs() < 0.02, "{}", alone.size());
}

#[test]
fn cutting_a_mesh_keeps_it_closed_and_its_volume() {
    let fine = subdivided(&cube(), 0.3);
    assert!(fine.is_watertight());
    assert!((fine.volume() - 1.0).abs() < 1e-12);
    let longest = fine
        .triangles()
        .iter()
        .flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)])
        .map(|(a, b)| (fine.vertices()[a as usize] - fine.vertices()[b as usize]).norm())
        .fold(0.0, f64::max);
    assert!(longest <= 0.3, "{longest}");
}

#[test]
fn cutting_a_polygon_keeps_its_corners() {
    let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
    let cut = divided(&corners, 0.25);
    assert_eq!(cut.len(), 4 + 6 + 4);
    assert!(corners.iter().all(|c| cut.contains(c)));
}

#[test]
fn thinning_bounds_the_triangles_and_keeps_the_shape() {
    let fine = subdivided(&cube(), 0.03);
    let deviations: Vec<f64> = fine.vertices().iter().map(|v| v.x).collect();
    let (thin, kept) = thinned(Geometry::Mesh(fine.clone()), deviations, 2_000);
    let Geometry::Mesh(thin) = thin else { panic!("a mesh stays a mesh") };
    assert!(thin.triangles().len() <= 2_000 && thin.triangles().len() > 400);
    assert!((thin.volume() - 1.0).abs() < 0.15, "{}", thin.volume());
    assert_eq!(kept.len(), thin.vertices().len());
    // Linear deviations stay those of the vertices.
    assert!(thin.vertices().iter().zip(&kept).all(|(v, d)| (v.x - d).abs() < 1e-12));
    let (same, _) = thinned(Geometry::Mesh(cube()), vec![], 12);
    assert!(matches!(same, Geometry::Mesh(m) if m.triangles().len() == 12));
}
