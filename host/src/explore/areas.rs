//! Where the surface is uncertain, as contact areas, and the grasps that face them (thesis 4.5.1).

use std::f64::consts::PI;

use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::belief::Belief;
use super::clustering::{Area, Settings, cluster};
use super::placement::Placement;
use crate::space::{Point, Pose};

/// Points of the believed surface that are looked at.
const SAMPLES: usize = 400;

/// Standard deviation of the surface above which a point is to be touched, metres. The thesis has a
/// "predefined threshold value" and does not name it.
const DOUBTFUL: f64 = 1.8e-3;

/// Where nothing is that doubtful, the most doubtful part of the surface.
const PART: usize = 10;

/// A placement faces an area when its palm does within this angle, and the middle of its fingers meets
/// it within this distance, radians and metres.
const FACING: (f64, f64) = (30.0 * PI / 180.0, 15e-3);

/// Which contact area comes next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum NextArea {
    /// The nearest one that the last two grasps did not face
    #[default]
    Near,
    /// Any: the criterion decides among the grasps that face all of them
    Gain,
}

/// The contact areas of the believed surface: its points with a standard deviation above 1.8 mm, or the
/// most uncertain tenth where there are none, clustered. From the largest to the smallest, with the
/// points they are made of.
pub fn areas(belief: &Belief, settings: &Settings) -> (Vec<(Point, Point)>, Vec<Area>) {
    let samples = belief.geometry.samples(SAMPLES);
    let points: Vec<Point> = samples.iter().map(|s| s.0).collect();
    let deviations: Vec<f64> = belief.surface.variances(&points).iter().map(|v| v.sqrt()).collect();
    let mut sorted = deviations.clone();
    sorted.sort_by(f64::total_cmp);
    let most = sorted.get(sorted.len() - sorted.len() / PART).copied().unwrap_or(0.0);
    let enough = DOUBTFUL.min(most);
    let doubtful: Vec<_> =
        samples.into_iter().zip(deviations).filter(|(_, d)| *d >= enough).map(|(s, _)| s).collect();
    let areas = cluster(belief.dimension, &doubtful, 2.0 * belief.radius, settings);
    (doubtful, areas)
}

/// Grasps of the next contact area, or of all of them, the hand's last placements being `recent`
/// (object frame, the last one last). Empty where there is no surface.
pub fn candidates(belief: &Belief, next: NextArea, recent: &[Placement]) -> Vec<Placement> {
    let (_, areas) = areas(belief, &Settings::default());
    match next {
        NextArea::Gain => areas.iter().flat_map(|area| facing(belief, area)).collect(),
        NextArea::Near => {
            let open = |area: &&Area| !recent.iter().any(|p| faces(p, area));
            let chosen = nearest(belief, areas.iter().filter(open), recent.last())
                .or_else(|| nearest(belief, areas.iter(), recent.last()));
            chosen.map_or_else(Vec::new, |area| facing(belief, area))
        }
    }
}

/// The area nearest to where the hand's fingers touched last; the largest where there was no grasp.
fn nearest<'a>(
    belief: &Belief,
    mut areas: impl Iterator<Item = &'a Area>,
    last: Option<&Placement>,
) -> Option<&'a Area> {
    let Some(last) = last else { return areas.next() };
    let touched = last.hand.translation.vector + last.hand.rotation * Point::y() * belief.radius;
    let far = |area: &&Area| (area.centre - touched).norm();
    areas.min_by(|a, b| far(a).total_cmp(&far(b)))
}

/// Whether the fingers close on the area.
fn faces(placement: &Placement, area: &Area) -> bool {
    let palm = placement.hand.rotation * Point::y();
    let away = area.centre - placement.hand.translation.vector;
    let aside = away - palm * away.dot(&palm);
    palm.angle(&area.normal) < FACING.0 && aside.norm() < FACING.1
}

/// The grasps whose palm faces the area, the middle of the four fingers on its centre: three postures,
/// in the plane moved aside by 15 mm or not, in space turned about the palm by steps of 30°.
pub fn facing(belief: &Belief, area: &Area) -> Vec<Placement> {
    let planar = belief.dimension == 2;
    let toward = if planar {
        let turn = area.normal.y.atan2(area.normal.x) - 0.5 * PI;
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn)
    } else {
        UnitQuaternion::rotation_between(&Vector3::y(), &area.normal)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI))
    };
    let away = area.centre - belief.centre;
    let palm = toward * Point::y();
    let middle = belief.centre + away - palm * away.dot(&palm);
    let turns: &[f64] = if planar { &[0.0] } else { &[0.0, 30.0, 60.0, 90.0, 120.0, 150.0] };
    let slides: &[f64] = if planar { &[0.0, -15e-3, 15e-3] } else { &[0.0] };
    let mut placements = Vec::with_capacity(18);
    for spread in [1.0, 0.75, 0.5] {
        for turn in turns {
            let about = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), turn.to_radians());
            let rotation = toward * about;
            for slide in slides {
                let at = middle + rotation * Point::x() * *slide;
                let hand = Pose::from_parts(Translation3::from(at), rotation);
                placements.push(Placement { hand, spread });
            }
        }
    }
    placements
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::explore::prediction::predict;
    use crate::sim::{Options, simulate};
    use crate::slam::track;

    fn belief(object: &str) -> Belief {
        let options = Options { grasps: Some(2), ..Options::new(object.parse().unwrap()) };
        let log = simulate(&options).unwrap().log;
        Belief::new(&log, &track::truth(&log).unwrap()).unwrap()
    }

    #[test]
    fn grasps_that_face_an_area_touch_it() {
        for object in ["rectangle:0.1x0.06", "box:0.1x0.06x0.08"] {
            let belief = belief(object);
            let (points, areas) = areas(&belief, &Settings::default());
            assert!(areas.len() > 1, "{object}");
            let felt_near = |p: &Point| {
                belief.contacts.iter().map(|c| (c.point - p).norm()).fold(f64::INFINITY, f64::min)
            };
            assert!(points.iter().any(|(p, _)| felt_near(p) > 0.02));
            let mut met = 0;
            for area in &areas {
                let placements = facing(&belief, area);
                assert!(placements.iter().any(|p| faces(p, area)), "{object}");
                let palm = placements[0].hand.rotation * Point::y();
                assert!((palm - area.normal).norm() < 1e-9);
                let near =
                    |p: Point| area.members.iter().any(|m| (points[*m].0 - p).norm() < 0.015);
                let felt = predict(&belief, &placements);
                met += usize::from(felt.iter().flatten().any(|e| near(e.point)));
            }
            assert!(met * 10 >= areas.len() * 8, "{object}: {met} of {}", areas.len());
        }
    }

    #[test]
    fn the_next_area_is_near_and_not_the_one_just_faced() {
        let belief = belief("rectangle:0.1x0.06");
        let (_, areas) = areas(&belief, &Settings::default());
        let last = facing(&belief, &areas[0])[0];
        let next = candidates(&belief, NextArea::Near, &[last]);
        assert_eq!(next.len(), 9);
        assert!(next.iter().all(|p| !p.repeats(&last)));
        assert!(!faces(&next[0], &areas[0]));
        let all = candidates(&belief, NextArea::Gain, &[last]);
        assert_eq!(all.len(), 9 * areas.len());
        assert_eq!(candidates(&belief, NextArea::Near, &[]).len(), 9);
    }
}
