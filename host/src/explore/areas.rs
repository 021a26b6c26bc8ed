//! Where the surface is uncertain, as contact areas, and the grasps that face them (thesis 4.5.1).

use std::f64::consts::PI;

use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

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

/// A fingertip that met nothing went past an area where its way is this near to the area's middle, metres
/// (half the distance of two fingers and some more, so that nothing hides between two of them), and ran
/// against it within this angle, radians: what lies along its way it would not have met.
const PASSED: (f64, f64) = (20e-3, 60.0 * PI / 180.0);

/// The areas that so many last grasps faced are left.
const LEFT: usize = 2;

/// Which finger is aimed in space.
const MIDDLE_FINGER: usize = 1;

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

/// Grasps of the next contact area, or of all of them, `done` being where the hand closed so far (object
/// frame, the last one last) and `missed` where it met nothing. What was done before is not done again
/// as long as there is anything else, since these grasps, unlike drawn ones, would come back at every
/// choice. Areas that the fingers of a missed grasp went past are left: where the surface is a guess,
/// pieces of it may be that no object has. Empty where there is no surface.
pub fn candidates(
    belief: &Belief,
    next: NextArea,
    done: &[Placement],
    missed: &[Placement],
) -> Vec<Placement> {
    let (_, all) = areas(belief, &Settings::default());
    let there = |area: &&Area| !missed.iter().any(|p| passes(belief, p, area));
    let mut areas: Vec<Area> = all.iter().filter(there).cloned().collect();
    if areas.is_empty() {
        areas = all;
    }
    let grasps: Vec<Placement> = match next {
        NextArea::Gain => areas.iter().flat_map(|area| facing(belief, area)).collect(),
        NextArea::Near => {
            let recent = &done[done.len().saturating_sub(LEFT)..];
            let open = |area: &&Area| !recent.iter().any(|p| faces(p, area));
            let chosen = nearest(belief, areas.iter().filter(open), done.last())
                .or_else(|| nearest(belief, areas.iter(), done.last()));
            chosen.map_or_else(Vec::new, |area| facing(belief, area))
        }
    };
    let new: Vec<Placement> =
        grasps.iter().copied().filter(|g| !done.iter().any(|d| d.repeats(g))).collect();
    if new.is_empty() { grasps } else { new }
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

/// Whether a finger of the grasp, which met nothing, would have met the area.
fn passes(belief: &Belief, missed: &Placement, area: &Area) -> bool {
    let off = (missed.hand.translation.vector - belief.centre).norm();
    missed.strokes(belief.dimension, belief.radius + off).iter().any(|stroke| {
        let start = (missed.hand * Point3::from(stroke.start)).coords;
        let way = missed.hand.rotation * stroke.direction;
        let along = (area.centre - start).dot(&way).clamp(0.0, stroke.travel);
        let aside = area.centre - (start + along * way);
        aside.norm() < PASSED.0 && area.normal.angle(&-way) < PASSED.1
    })
}

/// The grasps whose palm faces the area, in three postures. In the plane the middle of the four fingers
/// is on the area's centre, or 15 mm to either side of it; in space the middle, or a middle finger, and
/// the hand is turned about the palm by steps of 60°.
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
    let height = away.dot(&palm);
    let middle = area.centre - palm * height;
    let turns: &[f64] = if planar { &[0.0] } else { &[0.0, 60.0, 120.0] };
    let mut placements = Vec::with_capacity(18);
    for spread in [1.0, 0.75, 0.5] {
        let slides = match planar {
            true => vec![Point::zeros(), Point::x() * -15e-3, Point::x() * 15e-3],
            false => vec![Point::zeros(), -landing(spread, belief.radius, height)],
        };
        for turn in turns {
            let about = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), turn.to_radians());
            let rotation = toward * about;
            for slide in &slides {
                let at = Translation3::from(middle + rotation * slide);
                placements.push(Placement { hand: Pose::from_parts(at, rotation), spread });
            }
        }
    }
    placements
}

/// How far aside of the hand's middle a middle finger is, `height` metres above it, hand frame.
fn landing(spread: f64, radius: f64, height: f64) -> Point {
    let hand = Placement { hand: Pose::identity(), spread };
    let finger = hand.strokes(3, radius).into_iter().find(|s| s.finger == MIDDLE_FINGER);
    finger.map_or_else(Point::zeros, |s| {
        let at = s.start + s.direction * ((height - s.start.y) / s.direction.y);
        Point::new(at.x, 0.0, at.z)
    })
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
                if belief.dimension == 3 {
                    // The second placement of each turn aims a finger at the centre.
                    let stroke = &placements[1].strokes(3, belief.radius)[MIDDLE_FINGER];
                    let start = (placements[1].hand * nalgebra::Point3::from(stroke.start)).coords;
                    let way = placements[1].hand.rotation * stroke.direction;
                    let off = area.centre - start;
                    assert!((off - way * off.dot(&way)).norm() < 1e-9);
                }
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
        let next = candidates(&belief, NextArea::Near, &[last], &[]);
        assert!(!next.is_empty() && next.len() <= 9);
        assert!(next.iter().all(|p| !p.repeats(&last)));
        assert!(!faces(&next[0], &areas[0]));
        let all = candidates(&belief, NextArea::Gain, &[last], &[]);
        assert!(all.len() > 9 * (areas.len() - 1) && all.iter().all(|p| !p.repeats(&last)));
        assert_eq!(candidates(&belief, NextArea::Near, &[], &[]).len(), 9);
        let left = candidates(&belief, NextArea::Gain, &[], &[last]);
        assert!(!left.is_empty() && left.len() <= 9 * (areas.len() - 1));
        // A finger on its way along a face says nothing about it; one that runs against it does.
        let area = &areas[0];
        let turned = |angle: f64| {
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
            let middle = Translation3::from(area.centre);
            Placement { hand: Pose::from_parts(middle, turn * last.hand.rotation), ..last }
        };
        assert!(passes(&belief, &turned(0.0), area) && passes(&belief, &turned(0.5), area));
        assert!(!passes(&belief, &turned(0.5 * PI), area));
    }
}
