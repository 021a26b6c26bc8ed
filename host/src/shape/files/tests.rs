use super::*;
use crate::data::for_test;
use crate::shape::Flaws;
use crate::shape::mesh::tests::cuboid;

fn parsed(name: &str, bytes: &[u8]) -> Result<Mesh, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    read_mesh(&path).map_err(|e| e.to_string().replace(&path.display().to_string(), name))
}

fn same(a: &Mesh, b: &Mesh) {
    assert_eq!(a.triangles(), b.triangles());
    assert_eq!(a.vertices(), b.vertices());
}

#[test]
fn ply_comes_back_exactly() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let mesh = cuboid([0.1 / 3.0, 0.03, 0.02]);
    let normals: Vec<Point> = mesh.vertices().iter().map(|v| v.normalize()).collect();
    let deviations = [0.001; 8];
    for (normals, deviations) in
        [(None, None), (Some(&normals[..]), None), (Some(&normals[..]), Some(&deviations[..]))]
    {
        write_ply(&path, &mesh, normals, deviations).unwrap();
        same(&read_mesh(&path).unwrap(), &mesh);
    }
    let error = write_ply(&path, &mesh, None, Some(&[0.1])).unwrap_err().to_string();
    assert!(error.contains("1 deviations for 8 vertices"), "{error}");
    same(&read_mesh(&path).unwrap(), &mesh);
}

#[test]
fn faces_with_corners_of_their_own_are_joined() {
    // As exporters with a normal for every corner write them; and a triangle as a quadrilateral.
    let mesh = cuboid([0.1, 0.03, 0.02]);
    let corners = mesh.triangles().iter().flatten().map(|v| mesh.vertices()[*v as usize]);
    let mut text: String = corners.map(|p| format!("v {} {} {}\n", p.x, p.y, p.z)).collect();
    for k in 0..mesh.triangles().len() {
        let [a, b, c] = [1, 2, 3].map(|i| 3 * k + i);
        text += &if k == 0 { format!("f {a} {b} {c} {c}\n") } else { format!("f {a} {b} {c}\n") };
    }
    let joined = parsed("a.obj", text.as_bytes()).unwrap();
    assert!(joined.is_watertight());
    assert_eq!((joined.vertices().len(), joined.triangles().len()), (8, 12));
    assert!((joined.volume() - mesh.volume()).abs() < 1e-15);
}

#[test]
fn plain_meshes_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = cuboid([0.1 / 3.0, 0.03, 0.02]);
    let path = folder.path().join("a.obj");
    write_plain(&path, &mesh, Plain::Obj).unwrap();
    same(&read_mesh(&path).unwrap(), &mesh);

    // STL knows no shared vertices and halves the digits.
    let path = folder.path().join("a.stl");
    write_plain(&path, &mesh, Plain::Stl).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    assert_eq!(bytes.len(), 84 + 50 * mesh.triangles().len());
    let back = read_mesh(&path).unwrap();
    assert!(back.is_watertight() && (back.volume() - mesh.volume()).abs() < 1e-9);
    let number = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    let [a, b, c] = mesh.triangles()[0].map(|v| mesh.vertices()[v as usize]);
    let normal = (b - a).cross(&(c - a)).normalize();
    for axis in 0..3 {
        assert!((f64::from(number(84 + 4 * axis)) - normal[axis]).abs() < 1e-6);
    }
    assert!(write_plain(&folder.path().join("no/a.stl"), &mesh, Plain::Stl).is_err());
    // A triangle without area has no normal, and harms nobody.
    let flat = Mesh::new(vec![Point::zeros(); 3], vec![[0, 1, 2]]).unwrap();
    write_plain(&path, &flat, Plain::Stl).unwrap();
    assert_eq!(std::fs::read(&path).unwrap()[84..], [0; 50]);
}

#[test]
fn every_format_gives_the_same_tetrahedron() {
    let ply = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty uchar red\n\
        property float y\nproperty float z\nelement face 3\nproperty list uchar int vertex_indices\n\
        property float quality\nend_header\n0 255 0 0\n1 255 0 0\n0 255 1 0\n0 255 0 1\n\
        3 0 2 1 0.5\n3 0 1 3 0.5\n4 0 3 2 2 0.5\n";
    // The quadrilateral repeats a corner only to test the fan.
    let mesh = parsed("a.ply", ply.as_bytes()).unwrap();
    same(&parsed("a.ply", format!("\u{feff}{ply}").as_bytes()).unwrap(), &mesh);
    assert_eq!(mesh.triangles(), [[0, 2, 1], [0, 1, 3], [0, 3, 2], [0, 2, 2]]);
    assert_eq!(mesh.vertices()[2], Point::new(0.0, 1.0, 0.0));

    let off = "OFF # comment\n4 4 6\n0 0 0\n\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1 255 0 0\n3 0 1 3\n\
        3 0 3 2\n3 1 2 3 0.5 0.5 0.5\n";
    let off = parsed("a.off", off.as_bytes()).unwrap();
    let obj = "# comment\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 0 1\nf 1 3 2\nf 1/1 2/1 4/1\n\
        f 1//1 4//1 3//1\nf -3 -2 -1\n";
    let obj = parsed("a.obj", obj.as_bytes()).unwrap();
    same(&off, &obj);
    assert!(off.is_watertight() && (off.volume() - 1.0 / 6.0).abs() < 1e-12);

    let mut ascii = String::from("solid a vertex of sorts\n");
    let mut binary = vec![b' '; 80];
    binary[..5].copy_from_slice(b"solid");
    binary.extend(4u32.to_le_bytes());
    for t in off.triangles() {
        ascii += "facet normal 0 0 0\n outer loop\n";
        binary.extend([0; 12]);
        for v in t.map(|v| off.vertices()[v as usize]) {
            // A negative zero is the same place.
            ascii += &format!("  vertex {:e} {} -{}\n", v.x, v.y, -v.z);
            binary.extend([v.x, v.y, v.z].iter().flat_map(|x| (*x as f32).to_le_bytes()));
        }
        ascii += " endloop\nendfacet\n";
        binary.extend([0; 2]);
    }
    ascii += "endsolid\n";
    let ascii = ascii.replace("--", "");
    for stl in [parsed("a.stl", ascii.as_bytes()), parsed("b.STL", &binary)] {
        let stl = stl.unwrap();
        assert!(stl.is_watertight() && stl.vertices().len() == 4);
        assert!((stl.volume() - 1.0 / 6.0).abs() < 1e-12);
    }
}

#[test]
fn a_gap_is_one_gap_where_every_face_has_corners_of_its_own() {
    let corners = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let mut obj = String::new();
    for (face, triangle) in [[0, 2, 1], [0, 1, 3], [0, 3, 2]].iter().enumerate() {
        for [x, y, z] in triangle.map(|corner: usize| corners[corner]) {
            obj += &format!("v {x} {y} {z}\n");
        }
        let first = 3 * face + 1;
        obj += &format!("f {first} {} {}\n", first + 1, first + 2);
    }
    let open = parsed("a.obj", obj.as_bytes()).unwrap();
    assert_eq!(open.vertices().len(), 4);
    assert_eq!(open.flaws(), Flaws { open: 3, ..Flaws::default() });
}

#[test]
fn what_says_nothing_about_the_shape_is_skipped() {
    let obj =
        b"# caf\xe9\nv 0 0 0 # origin\nv 1 0 0\nv 1 1 0\nv 0 1 0\ng caf\xe9 #1\nf 1 2 3 4 # base\n";
    assert_eq!(parsed("a.obj", obj).unwrap().triangles(), [[0, 1, 2], [0, 2, 3]]);
    let off = b"OFF\n# caf\xe9\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    assert_eq!(parsed("a.off", off).unwrap().triangles(), [[0, 1, 2]]);
    let ascii = b"SOLID caf\xe9\nFACET NORMAL 0 0 1\nOUTER LOOP\nVERTEX 0 0 0\nVERTEX 1 0 0\n\
        VERTEX 0 1 0\nENDLOOP\nENDFACET\nENDSOLID\n";
    assert_eq!(parsed("a.stl", ascii).unwrap().triangles(), [[0, 1, 2]]);

    let mut binary = b"solid of a program that writes what it likes here".to_vec();
    binary.resize(80, b' ');
    binary.extend(1u32.to_le_bytes());
    let numbers = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    binary.extend(numbers.iter().flat_map(|x: &f32| x.to_le_bytes()));
    binary.extend([0; 2]);
    for behind in [&b""[..], b"\n", b"made on a Monday"] {
        let bytes = [&binary, behind].concat();
        assert_eq!(parsed("a.stl", &bytes).unwrap().triangles(), [[0, 1, 2]]);
    }
    // Whole triangles that the header does not count are lost ones.
    let more = [&binary[..], &binary[84..], &binary[84..]].concat();
    let error = parsed("a.stl", &more).unwrap_err();
    assert!(error.contains("expected 1 triangles, as the header says, found 3"), "{error}");
    let error = parsed("a.stl", &binary[..130]).unwrap_err();
    assert!(error.contains("expected 134 bytes, as the header says, found 130"), "{error}");
}

#[test]
fn what_is_wrong_is_named() {
    let header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
        property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n";
    let binary = header.replace("ascii", "binary_little_endian");
    let endless = binary.replace("vertex 3", "vertex 99999999999");
    let cases: [(&str, &str, &str); 16] = [
        ("a.xyz", "", "ending in .ply, .stl, .obj or .off"),
        ("a.ply", "", "a.ply, line 1: expected ply, found the end of the file"),
        ("a.ply", "play\n", "line 1: expected ply"),
        ("a.ply", "ply\nformat binary_big_endian 1.0\n", "line 2: expected format ascii 1.0 or"),
        ("a.ply", "ply\nelement vertex three\n", "line 2: expected element NAME COUNT"),
        ("a.ply", "ply\nproperty float x\n", "line 2: expected an element before its properties"),
        ("a.ply", &format!("{header}0 0 0\n1 0 x\n"), "line 11: expected a number, found \"x\""),
        ("a.ply", &format!("{header}0 0 0\n1 0 0\n"), "line 12: expected more elements"),
        (
            "a.ply",
            &format!("{header}0 0 0\n1 0 0\n0 1 0\n3 0 1 -2"),
            "a whole number from 0, found -2",
        ),
        (
            "a.ply",
            &format!("{header}0 0 0\n1 0 0\n0 1 0\n3 0 1 3"),
            "a.ply: triangle 0 names a vertex",
        ),
        (
            "a.ply",
            &format!("{header}0 0 0\n1 0 0\n0 nan 0\n3 0 1 2"),
            "vertex 2: coordinates must be",
        ),
        ("a.ply", &format!("{endless}0123456789"), "expected more elements, as the header says"),
        (
            "a.stl",
            "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0\n",
            "line 4: expected three",
        ),
        ("a.stl", "not at all", "expected an STL file"),
        ("a.obj", "v 0 0 0\nv 0 1 0\nf 1 2 0\n", "line 3: expected the number of a vertex, from 1"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n2 0 1\n", "line 6: expected a face"),
    ];
    for (name, content, expected) in cases {
        let error = parsed(name, content.as_bytes()).unwrap_err();
        assert!(error.contains(expected), "{content:?}: {error}");
    }
    let error = read_mesh(Path::new("no/such/file.ply")).unwrap_err().to_string();
    assert!(error.starts_with("no/such/file.ply: cannot read: "), "{error}");
}

#[test]
fn contours_come_back_and_polygons_are_read_from_text_and_json() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("contour.csv");
    let ring = Outline::new(vec![
        vec![[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]],
        vec![[-0.05, 0.0], [0.0, 0.05], [0.1 / 3.0, -0.05]],
    ])
    .unwrap();
    write_contour(&path, &ring, None).unwrap();
    assert_eq!(read_outline(&path).unwrap(), ring);
    let deviations: Vec<f64> = (0..7).map(|i| i as f64).collect();
    write_contour(&path, &ring, Some(&deviations)).unwrap();
    assert_eq!(read_outline(&path).unwrap(), ring);
    let written = std::fs::read_to_string(&path).unwrap();
    assert!(written.starts_with("loop,x,y,deviation\n0,-0.1,-0.1,0\n"), "{written}");

    let triangle = Outline::new(vec![vec![[0.0, 0.0], [0.15, 0.0], [0.0, 0.15]]]).unwrap();
    for text in [
        "x,y\n0,0\n0.15,0\n0,0.15\n0,0\n",
        "# a block\n0 0\n\n0.15 0 # corner\n0 0.15\n",
        "[[0, 0], [0.15, 0.0], [0, 0.15]]",
    ] {
        std::fs::write(&path, text).unwrap();
        assert_eq!(read_outline(&path).unwrap(), triangle, "{text}");
    }
    for (text, expected) in [
        ("", "line 1: expected at least 3 vertices"),
        ("0 0\n1 0\n1 one\n", "line 3: expected a number, found \"one\""),
        ("0 0\n1\n", "line 2: expected two numbers"),
        ("0 0 0\n1 0 0\n", "line 1: expected two numbers x, y, found 3 numbers"),
        ("0 0\n1 0\n", "2 distinct vertices"),
        ("[[0, 0],\n [1, 2, 3]]", "line 2: expected a list of [x, y]"),
    ] {
        std::fs::write(&path, text).unwrap();
        let error = read_outline(&path).unwrap_err().to_string();
        assert!(error.contains(expected), "{text:?}: {error}");
    }
}

#[test]
fn shared_meshes_are_read() {
    if let Some(folder) = for_test("mujoco") {
        let mesh = read_mesh(&folder.join("box.ply")).unwrap();
        assert!(mesh.is_watertight() && (mesh.volume() - 0.12 * 0.06 * 0.06).abs() < 1e-9);
        let mesh = read_mesh(&folder.join("sphere.ply")).unwrap();
        assert!(mesh.is_watertight() && mesh.volume() > 0.0);
    }
    if let Some(folder) = for_test("ycb") {
        // 60 × 158 × 213 mm, standing askew in its frame.
        let mesh = read_mesh(&folder.join("cracker_box.ply")).unwrap();
        assert_eq!(mesh.triangles().len(), 49900);
        let (low, high) = mesh.bounds();
        let diagonal = (high - low).norm();
        assert!((0.27..0.31).contains(&diagonal), "{diagonal}");
        assert!((mesh.area() - 0.112).abs() < 0.01, "{}", mesh.area());
    }
    if let Some(folder) = for_test("touch/models") {
        // 10 × 30 × 20 cm.
        let mesh = read_mesh(&folder.join("box.off")).unwrap();
        assert!((mesh.area() - 0.22).abs() < 1e-9);
        assert!((mesh.bounds().1 - Point::new(0.1, 0.3, 0.2)).norm() < 1e-12);
        for name in ["cleaner", "cylinder", "helmet", "tetrahedron"] {
            let mesh = read_mesh(&folder.join(format!("{name}.off"))).unwrap();
            assert!(mesh.area() > 0.0, "{name}");
        }
    }
}
