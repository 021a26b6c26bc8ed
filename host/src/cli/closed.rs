//! Meshes that are no closed surface with one side out.

use crate::shape::{Flaws, Geometry, Mesh};

/// What is to be said of an object's mesh with gaps or triangles turned inside out: fingers pass through there, and
/// what is inside is not defined.
pub(super) fn doubt(mesh: &Mesh) -> Option<String> {
    let Flaws { open, turned, crowded } = mesh.flaws();
    let kinds = [
        (open, "of a single triangle"),
        (turned, "between triangles that face opposite ways"),
        (crowded, "of more than two triangles"),
    ];
    let edges = |count: usize| if count == 1 { "edge" } else { "edges" };
    let found = kinds.iter().filter(|(count, _)| *count > 0);
    let found: Vec<String> =
        found.map(|(count, kind)| format!("{count} {} {kind}", edges(*count))).collect();
    (!found.is_empty()).then(|| {
        format!("the mesh is no closed surface whose triangles all face out: {}", found.join(", "))
    })
}

/// The same of a shape in space; an outline has no gaps.
pub(super) fn of(shape: &Geometry) -> Option<String> {
    match shape {
        Geometry::Mesh(mesh) => doubt(mesh),
        Geometry::Outline(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::ObjectSpec;

    #[test]
    fn gaps_and_turned_triangles_raise_a_doubt() {
        let object: ObjectSpec = "box:0.12x0.06x0.06".parse().unwrap();
        let Geometry::Mesh(whole) = object.geometry().unwrap() else { panic!("a mesh") };
        assert_eq!(doubt(&whole), None);
        let said = |change: fn(&mut Vec<[u32; 3]>)| {
            let mut triangles = whole.triangles().to_vec();
            change(&mut triangles);
            doubt(&Mesh::new(whole.vertices().to_vec(), triangles).unwrap()).unwrap_or_default()
        };
        let open = said(|triangles| triangles.truncate(triangles.len() - 1));
        assert!(open.ends_with("all face out: 3 edges of a single triangle"), "{open}");
        let turned = said(|triangles| triangles[3].swap(0, 1));
        assert!(turned.contains("3 edges between triangles that face opposite ways"), "{turned}");
        let both = said(|triangles| {
            triangles[3].swap(0, 1);
            triangles.push(triangles[7]);
        });
        assert!(both.contains("opposite ways, 3 edges of more than two triangles"), "{both}");
    }
}
