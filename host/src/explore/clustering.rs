//! Contact areas: points of a surface in groups that one grasp can cover, by hierarchical clustering
//! (thesis 4.5.1 and Appendix B, as corrected).
//!
//! What is printed differs in four places. 4.17 is a similarity; the dissimilarity of two normals is
//! (1 − cos)/2. The three terms of 4.19 have different units; here each is a share between 0 and 1. The
//! condition of B.1, that the variance between groups exceed the total, never holds; the F ratio of
//! Beale (1969) takes its place. B.3 would throw nine clusters of ten away at a quantile of 0.9; it is
//! 0.1.
//!
//! Complete linkage keeps areas from spreading: no two points of one are less alike than
//! [`Settings::widest`]. The linkage MATLAB takes unless told otherwise, [`Linkage::Single`], chains
//! around the object.

use std::collections::BTreeMap;

use nalgebra::DMatrix;

use crate::space::Point;

/// Points that are clustered at most; of more, evenly many along their order in space are taken.
pub const MOST: usize = 1024;

/// What makes points unlike each other (4.19), as parts of the whole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights {
    /// Their distance (4.16).
    pub distance: f64,
    /// The angle between their normals (4.17).
    pub normal: f64,
    /// How far one is above the other (4.18).
    pub height: f64,
}

impl Weights {
    /// Of 4.19.
    pub const THESIS: Weights = Weights { distance: 0.5, normal: 0.4, height: 0.1 };

    /// Of algorithm B.2, which differs.
    pub const APPENDIX: Weights = Weights { distance: 0.55, normal: 0.3, height: 0.15 };
}

/// How unlike two groups are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Linkage {
    /// As their least alike points.
    Complete,
    /// As their points on average.
    Average,
    /// As their most alike points.
    Single,
}

/// How surface points become contact areas.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Of 4.19.
    pub weights: Weights,
    /// What is merged first.
    pub linkage: Linkage,
    /// Dissimilarity, 0 to 1, of the least alike points that one area may hold; exact for complete
    /// linkage.
    pub widest: f64,
    /// An area is divided where the F ratio of its two halves exceeds this: 1 is what halving any
    /// evenly filled piece of surface gives.
    pub divide: f64,
    /// The areas smaller than this quantile of all sizes join another one (B.3).
    pub small: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Settings {
            weights: Weights::THESIS,
            linkage: Linkage::Complete,
            widest: 0.3,
            divide: 1.5,
            small: 0.1,
        }
    }
}

/// A part of the surface to be touched.
#[derive(Clone, Debug, PartialEq)]
pub struct Area {
    /// Which of the points, ascending.
    pub members: Vec<usize>,
    /// The member most like all others.
    pub medoid: usize,
    /// Where that is, metres.
    pub centre: Point,
    /// Mean of the normals, unit; the medoid's where they cancel.
    pub normal: Point,
    /// Dissimilarity of its least alike members, 0 to 1.
    pub width: f64,
}

/// The contact areas of points (metres) with unit outward normals on an object of this size (its
/// diameter, metres), from the largest to the smallest. The same areas in whatever order the points
/// come. Points without finite coordinates or without a normal are in none.
///
/// Merging takes n² steps (nearest-neighbour chain; Murtagh 1983), which is why n is bounded by
/// [`MOST`].
///
/// ```
/// use tactile_host::explore::clustering::{Settings, cluster};
/// use tactile_host::space::Point;
///
/// // Two opposite sides of a block.
/// let side = |y: f64| (0..20).map(move |k| Point::new(1e-3 * f64::from(k), y, 0.0));
/// let points = side(0.0).map(|p| (p, -Point::y())).chain(side(0.06).map(|p| (p, Point::y())));
/// let areas = cluster(2, &points.collect::<Vec<_>>(), 0.07, &Settings::default());
/// assert_eq!(areas.len(), 2);
/// assert_eq!(areas[0].members.len(), 20);
/// ```
pub fn cluster(
    dimension: usize,
    points: &[(Point, Point)],
    size: f64,
    settings: &Settings,
) -> Vec<Area> {
    let chosen = ordered(points);
    let size = if size.is_finite() && size > 0.0 { size } else { 1.0 };
    let n = chosen.len();
    let unlike = DMatrix::from_fn(n, n, |i, j| {
        dissimilarity(&points[chosen[i]], &points[chosen[j]], size, &settings.weights)
    });
    let tree = merge(&unlike, settings.linkage);
    let mut groups = divide(&tree, n, dimension, settings);
    join_small(&mut groups, &unlike, settings);
    let mut areas: Vec<(Vec<usize>, Area)> =
        groups.into_iter().map(|g| (g.clone(), area(&g, &unlike, &chosen, points))).collect();
    // By place among the ordered points where sizes are equal, which no order of the input changes.
    areas.sort_by(|(a, _), (b, _)| b.len().cmp(&a.len()).then_with(|| a.cmp(b)));
    areas.into_iter().map(|(_, area)| area).collect()
}

/// 4.19, each term a share of its greatest: of the object's size, of opposite normals.
pub fn dissimilarity(a: &(Point, Point), b: &(Point, Point), size: f64, weights: &Weights) -> f64 {
    let away = a.0 - b.0;
    let share = |length: f64| (length / size).min(1.0);
    let turned = 0.5 * (1.0 - a.1.dot(&b.1).clamp(-1.0, 1.0));
    let Weights { distance, normal, height } = *weights;
    let sum = distance * share(away.norm()) + normal * turned + height * share(away.z.abs());
    sum / (distance + normal + height).max(f64::MIN_POSITIVE)
}

/// The points that can be clustered, by their coordinates and normals: equal ones may change places,
/// nothing else can.
fn ordered(points: &[(Point, Point)]) -> Vec<usize> {
    let fine = |i: &usize| {
        let (p, n) = &points[*i];
        p.iter().all(|x| x.is_finite()) && (n.norm() - 1.0).abs() < 1e-3
    };
    let mut all: Vec<usize> = (0..points.len()).filter(fine).collect();
    let key = |i: usize| points[i].0.iter().chain(points[i].1.iter()).copied().collect::<Vec<_>>();
    all.sort_by(|a, b| {
        let pairs = key(*a).into_iter().zip(key(*b));
        pairs.map(|(x, y)| x.total_cmp(&y)).find(|o| o.is_ne()).unwrap_or_else(|| a.cmp(b))
    });
    let n = all.len();
    if n <= MOST { all } else { (0..MOST).map(|k| all[k * n / MOST]).collect() }
}

/// Two groups made one.
#[derive(Clone, Debug)]
struct Merge {
    /// Leaves below n, earlier merges from n on.
    halves: [usize; 2],
    /// The linkage between them.
    height: f64,
    /// All leaves, ascending.
    members: Vec<usize>,
    /// Σ D² over the pairs of members.
    squares: f64,
}

/// The tree of all merges, the last one at its root; none of fewer than two points.
fn merge(unlike: &DMatrix<f64>, linkage: Linkage) -> Vec<Merge> {
    let n = unlike.nrows();
    let mut between = unlike.clone();
    // What stands in each row: its node and its leaves.
    let mut rows: BTreeMap<usize, (usize, Vec<usize>)> =
        (0..n).map(|i| (i, (i, vec![i]))).collect();
    let mut tree: Vec<Merge> = Vec::with_capacity(n.saturating_sub(1));
    let mut chain: Vec<usize> = Vec::new();
    while rows.len() > 1 {
        if chain.is_empty() {
            chain.extend(rows.keys().next());
        }
        let Some(&last) = chain.last() else { break };
        let before = chain.len().checked_sub(2).map(|i| chain[i]);
        // The one before wins a tie, so that the chain ends.
        let nearest = rows.keys().copied().filter(|&r| r != last).min_by(|&a, &b| {
            let tie = (before != Some(a)).cmp(&(before != Some(b)));
            between[(last, a)].total_cmp(&between[(last, b)]).then(tie)
        });
        let Some(nearest) = nearest else { break };
        if before != Some(nearest) {
            chain.push(nearest);
            continue;
        }
        chain.truncate(chain.len() - 2);
        let (keep, drop) = (last.min(nearest), last.max(nearest));
        let height = between[(keep, drop)];
        let (Some(a), Some(b)) = (rows.remove(&keep), rows.remove(&drop)) else { break };
        let (share_a, share_b) = (a.1.len() as f64, b.1.len() as f64);
        for &other in rows.keys() {
            let (x, y) = (between[(keep, other)], between[(drop, other)]);
            let distance = match linkage {
                Linkage::Complete => x.max(y),
                Linkage::Average => (share_a * x + share_b * y) / (share_a + share_b),
                Linkage::Single => x.min(y),
            };
            between[(keep, other)] = distance;
            between[(other, keep)] = distance;
        }
        let across: f64 =
            a.1.iter().flat_map(|i| b.1.iter().map(|j| unlike[(*i, *j)].powi(2))).sum();
        let squares = across + squares(&tree, n, a.0) + squares(&tree, n, b.0);
        let mut members = [a.1, b.1].concat();
        members.sort_unstable();
        rows.insert(keep, (n + tree.len(), members.clone()));
        tree.push(Merge { halves: [a.0, b.0], height, members, squares });
    }
    tree
}

fn squares(tree: &[Merge], n: usize, node: usize) -> f64 {
    node.checked_sub(n).and_then(|k| tree.get(k)).map_or(0.0, |m| m.squares)
}

/// Goes down from the root and divides what is too wide or falls apart (B.1).
fn divide(tree: &[Merge], n: usize, dimension: usize, settings: &Settings) -> Vec<Vec<usize>> {
    let mut groups = Vec::new();
    let root = if tree.is_empty() { n.checked_sub(1) } else { Some(n + tree.len() - 1) };
    let mut open: Vec<usize> = root.into_iter().collect();
    while let Some(node) = open.pop() {
        let Some(merge) = node.checked_sub(n).and_then(|k| tree.get(k)) else {
            groups.push(vec![node]);
            continue;
        };
        if merge.height > settings.widest || ratio(tree, n, merge, dimension) > settings.divide {
            open.extend(merge.halves);
        } else {
            groups.push(merge.members.clone());
        }
    }
    groups
}

/// Beale's F: by how much two halves vary less than the whole, over what any halving of an evenly
/// filled piece of surface gains. Variances of dissimilarities as Σ D² over pairs by their number of
/// points (Anderson 2001). 0 for fewer than four points, of which nothing can be said.
fn ratio(tree: &[Merge], n: usize, merge: &Merge, dimension: usize) -> f64 {
    let count = |node: usize| {
        node.checked_sub(n).and_then(|k| tree.get(k)).map_or(1.0, |m| m.members.len() as f64)
    };
    let all = merge.members.len() as f64;
    if all < 4.0 {
        return 0.0;
    }
    let total = merge.squares / all;
    let within: f64 = merge.halves.iter().map(|h| squares(tree, n, *h) / count(*h)).sum();
    let evenly = (all - 1.0) / (all - 2.0) * 2f64.powf(2.0 / (dimension.max(2) - 1) as f64) - 1.0;
    match total - within {
        // Equal points: nothing to divide.
        gained if gained <= 1e-12 => 0.0,
        gained => gained / within.max(1e-12) / evenly,
    }
}

/// Joins the smallest areas to the ones they are nearest to, unless those would spread (B.3).
fn join_small(groups: &mut Vec<Vec<usize>>, unlike: &DMatrix<f64>, settings: &Settings) {
    let mut sizes: Vec<usize> = groups.iter().map(Vec::len).collect();
    sizes.sort_unstable();
    let at = (settings.small.clamp(0.0, 1.0) * sizes.len().saturating_sub(1) as f64).ceil();
    let Some(&least) = sizes.get(at as usize) else { return };
    let (mut kept, mut small): (Vec<_>, Vec<_>) =
        std::mem::take(groups).into_iter().partition(|g| g.len() >= least);
    small.sort();
    kept.sort();
    for group in small {
        let wide = |other: &Vec<usize>| width(&[&group[..], other].concat(), unlike);
        let nearest =
            (0..kept.len()).map(|k| (wide(&kept[k]), k)).min_by(|a, b| a.0.total_cmp(&b.0));
        match nearest {
            Some((width, k)) if width <= settings.widest => kept[k].extend(group),
            _ => kept.push(group),
        }
    }
    kept.iter_mut().for_each(|g| g.sort_unstable());
    *groups = kept;
}

fn width(members: &[usize], unlike: &DMatrix<f64>) -> f64 {
    let pairs = members.iter().flat_map(|i| members.iter().map(move |j| unlike[(*i, *j)]));
    pairs.fold(0.0, f64::max)
}

fn area(
    group: &[usize],
    unlike: &DMatrix<f64>,
    chosen: &[usize],
    points: &[(Point, Point)],
) -> Area {
    let far = |i: usize| -> f64 { group.iter().map(|j| unlike[(i, *j)]).sum() };
    let middle = group.iter().copied().min_by(|a, b| far(*a).total_cmp(&far(*b))).unwrap_or(0);
    let medoid = chosen[middle];
    let normal: Point = group.iter().map(|i| points[chosen[*i]].1).sum();
    let mut members: Vec<usize> = group.iter().map(|i| chosen[*i]).collect();
    members.sort_unstable();
    Area {
        members,
        medoid,
        centre: points[medoid].0,
        normal: normal.try_normalize(1e-6).unwrap_or(points[medoid].1),
        width: width(group, unlike),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A face of a cube with side 0.06, `across` × `across` points.
    fn face(axis: usize, sign: f64, across: usize) -> Vec<(Point, Point)> {
        let normal = Point::ith(axis, sign);
        let at = |k: usize| 0.06 * ((k as f64 + 0.5) / across as f64 - 0.5);
        (0..across * across)
            .map(|k| {
                let mut p = normal * 0.03;
                p[(axis + 1) % 3] = at(k % across);
                p[(axis + 2) % 3] = at(k / across);
                (p, normal)
            })
            .collect()
    }

    fn cube() -> Vec<(Point, Point)> {
        (0..3).flat_map(|a| [face(a, 1.0, 5), face(a, -1.0, 5)].concat()).collect()
    }

    const SIZE: f64 = 0.104;

    #[test]
    fn a_cube_falls_into_its_faces_and_no_area_goes_round_an_edge() {
        let points = cube();
        // Wide enough for a face, so that nothing but the F ratio divides.
        let settings = Settings { widest: 0.6, ..Settings::default() };
        let areas = cluster(3, &points, SIZE, &settings);
        assert_eq!(
            areas.len(),
            6,
            "{:?}",
            areas.iter().map(|a| a.members.len()).collect::<Vec<_>>()
        );
        for area in &areas {
            assert_eq!(area.members.len(), 25);
            assert!((area.normal - points[area.medoid].1).norm() < 1e-12);
            assert!((area.centre - area.normal * 0.03).norm() < 1e-9, "medoid in the middle");
        }
    }

    #[test]
    fn single_linkage_spreads_where_complete_linkage_does_not() {
        // A straight side: each point is near the next one.
        let side: Vec<_> =
            (0..100).map(|k| (Point::new(1e-3 * k as f64, 0.0, 0.0), Point::y())).collect();
        let by = |linkage| {
            let settings = Settings { linkage, ..Settings::default() };
            cluster(2, &side, 0.1, &settings)
        };
        let [complete, single] = [by(Linkage::Complete), by(Linkage::Single)];
        assert!(complete.iter().all(|a| a.width <= 0.3) && complete.len() >= 2);
        assert!(single.iter().any(|a| a.width > 0.45), "{single:?}");
    }

    #[test]
    fn nothing_one_point_and_duplicates_are_areas_too() {
        let settings = Settings::default();
        assert!(cluster(3, &[], SIZE, &settings).is_empty());
        let one = (Point::x(), Point::x());
        let areas = cluster(3, &[one], SIZE, &settings);
        assert_eq!((areas.len(), areas[0].width, areas[0].medoid), (1, 0.0, 0));
        let areas = cluster(3, &[one; 7], SIZE, &settings);
        assert_eq!(areas.len(), 1);
        assert_eq!(areas[0].members, (0..7).collect::<Vec<_>>());
        let two = cluster(3, &[one, (-Point::x(), -Point::x()), one], SIZE, &settings);
        assert_eq!(
            two.iter().map(|a| a.members.clone()).collect::<Vec<_>>(),
            [vec![0, 2], vec![1]]
        );
    }

    #[test]
    fn points_that_are_none_are_in_no_area() {
        let mut points = face(2, 1.0, 3);
        points[4].0.x = f64::NAN;
        points[5].0.y = f64::INFINITY;
        points[6].1 = Point::zeros();
        points[7].1 = Point::new(f64::NAN, 0.0, 0.0);
        let areas = cluster(3, &points, f64::NAN, &Settings::default());
        let members: Vec<usize> = areas.iter().flat_map(|a| a.members.clone()).collect();
        assert_eq!(members, [0, 1, 2, 3, 8]);
    }

    #[test]
    fn too_many_points_are_thinned_evenly() {
        let side = (0..3 * MOST).map(|k| (Point::new(1e-5 * k as f64, 0.0, 0.0), Point::y()));
        let areas = cluster(2, &side.collect::<Vec<_>>(), 0.05, &Settings::default());
        assert_eq!(areas.iter().map(|a| a.members.len()).sum::<usize>(), MOST);
        let (low, high) = (0.002, 3e-5 * MOST as f64 - 0.002);
        assert!(areas.iter().any(|a| a.centre.x < low + 0.01));
        assert!(areas.iter().any(|a| a.centre.x > high - 0.01));
    }

    fn cloud() -> impl Strategy<Value = Vec<(Point, Point)>> {
        // On a coarse grid, so that ties and duplicates are common.
        let one = (0i32..5, 0i32..5, 0i32..3, 0usize..6).prop_map(|(x, y, z, n)| {
            let p = Point::new(f64::from(x), f64::from(y), f64::from(z)) * 0.02;
            (p, Point::ith(n % 3, if n < 3 { 1.0 } else { -1.0 }))
        });
        proptest::collection::vec(one, 0..60)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        #[test]
        fn areas_part_the_points_and_never_spread(points in cloud(), widest in 0.05..0.8f64) {
            let settings = Settings { widest, ..Settings::default() };
            let areas = cluster(3, &points, 0.12, &settings);
            let mut members: Vec<usize> = areas.iter().flat_map(|a| a.members.clone()).collect();
            members.sort_unstable();
            prop_assert_eq!(members, (0..points.len()).collect::<Vec<_>>());
            for area in &areas {
                for &i in &area.members {
                    for &j in &area.members {
                        let d = dissimilarity(&points[i], &points[j], 0.12, &settings.weights);
                        prop_assert!(d <= widest + 1e-12 && d <= area.width + 1e-12);
                    }
                }
            }
        }

        #[test]
        fn the_order_of_the_points_does_not_matter(points in cloud(), seed in 0usize..1000) {
            let n = points.len();
            // A permutation: a stride that shares no factor with n.
            let stride = (seed..seed + n).find(|s| gcd(*s, n) == 1).unwrap_or(1);
            let shuffled: Vec<usize> = (0..n).map(|k| (k * stride + seed) % n).collect();
            let mixed: Vec<_> = shuffled.iter().map(|i| points[*i]).collect();
            let settings = Settings::default();
            let places = |areas: Vec<Area>, of: &[(Point, Point)]| -> Vec<Vec<String>> {
                areas.iter().map(|a| {
                    let mut all: Vec<String> =
                        a.members.iter().map(|i| format!("{:?}", of[*i])).collect();
                    all.sort();
                    all
                }).collect()
            };
            let one = places(cluster(3, &points, 0.12, &settings), &points);
            prop_assert_eq!(one, places(cluster(3, &mixed, 0.12, &settings), &mixed));
        }
    }

    fn gcd(a: usize, b: usize) -> usize {
        if b == 0 { a } else { gcd(b, a % b) }
    }
}
