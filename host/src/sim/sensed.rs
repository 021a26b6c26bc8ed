//! Simulated grasps as fingertip sensors feel them: words, and the contacts that the board's
//! estimators make of them.

use nalgebra::{Rotation3, Translation3, UnitQuaternion};
use tactile_core::sensing::Touch as Felt;
use tactile_core::space::Spatial;

use super::random::Random;
use super::sensors::{FluidFinger, Push, Skin, Transducer, film, gauges};
use super::world::{SimError, Simulation};
use crate::log::words::{self, Kind, Sensors, TARE, Words};
use crate::space::{Bridge, Point, Pose};

/// Force of a finger, newtons, uniform; of it along the skin, the same for every direction.
const FORCE: [f64; 2] = [0.5, 3.0];
const SLIDE: f64 = 0.2;
/// How far from the tip, metres, and from the middle of the pad, radians, a finger touches.
const ALONG: [f64; 2] = [0.008, 0.022];
const AROUND: f64 = 0.7;
/// Readings of a contact: the estimators' window and what they take to believe in it.
const READINGS: usize = 12;
const GRAVITY: Point = Point::new(0.0, 0.0, -9.81);

/// A finger's sensor, forwards.
enum Forward {
    Wrench(Box<Transducer>),
    Electrodes(Box<FluidFinger>),
}

impl Forward {
    fn read(&mut self, pushes: &[Push], gravity: Point, step: f64) -> Vec<i32> {
        match self {
            Forward::Wrench(sensor) => sensor.sample(pushes, gravity, step).to_vec(),
            Forward::Electrodes(sensor) => sensor.sample(pushes, step).map(i32::from).to_vec(),
        }
    }
}

/// What became of a simulation's contacts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sensed {
    /// Contacts that the estimators found.
    pub felt: usize,
    /// Contacts of the hand that they did not report, which the log then does not have.
    pub unfelt: usize,
}

/// Replaces the contacts of a simulation in space, which must be without noise, by what sensors in
/// the fingertips make of them; their words go into the log ([`crate::log::words`]).
///
/// Each finger is pressed at a place of its pad that is drawn anew, with 0.5 to 3 N of which up to
/// a fifth is along the skin.
///
/// # Errors
/// In the plane, and when contacts are of no finger.
pub fn sense(simulation: &mut Simulation, kind: Kind, seed: u64) -> Result<Sensed, SimError> {
    let refused = |expected, found: &str| {
        Err(SimError::Option { option: "--sensors", expected, found: found.into() })
    };
    let log = &mut simulation.log;
    if log.dimension != 3 {
        return refused("a spatial object", "a planar one");
    }
    if log.grasps.iter().flat_map(|g| &g.contacts).any(|c| c.finger.is_none()) {
        return refused("--touch hand", "contacts of no finger");
    }
    let (Skin::Finger { radius, length }, skin) = (Skin::BIOTAC, Skin::BIOTAC) else {
        return refused("a finger's skin", "another");
    };
    let [mut places, mut directions] = Random::streams(seed);
    let (sensors, mut forward) =
        mounted(kind, words::Skin { radius, length }, log.fingers.len(), seed);
    let step = f64::from(sensors.period) * 1e-6;
    let estimators = (0..log.fingers.len()).map(|finger| sensors.estimator(finger));
    let mut estimators: Vec<_> = estimators.collect::<Result<_, _>>().map_err(SimError::Words)?;
    let mut sensed = Sensed { felt: 0, unfelt: 0 };
    let (mut points, mut normals) = (Vec::new(), Vec::new());
    for grasp in &mut log.grasps {
        for mut contact in std::mem::take(&mut grasp.contacts) {
            let (Some(finger), Some(normal)) = (contact.finger, contact.normal) else { continue };
            let place = skin.at(between(ALONG, &mut places), places.around_zero(AROUND));
            let fingertip = facing(&contact.point, &normal, &place, places.around_zero(0.5));
            let newtons = between(FORCE, &mut places);
            let slide = SLIDE * places.unit();
            let push = Push::new(place, newtons, slide, directions.direction(3));
            let gravity = fingertip.rotation.inverse() * GRAVITY;
            let words: Vec<Vec<i32>> =
                (0..READINGS).map(|_| forward[finger].read(&[push], gravity, step)).collect();
            let felt = estimators[finger].read(&words).map_err(SimError::Words)?;
            let Some((felt, touch)) = felt.ok().and_then(|touch| {
                Some((touch.contact::<Spatial>(&Spatial::pose(&fingertip), finger as u8)?, touch))
            }) else {
                sensed.unfelt += 1;
                continue;
            };
            sensed.felt += 1;
            contact.point = Spatial::point(&felt.point);
            contact.normal = felt.normal.map(|n| Spatial::point(&n).normalize());
            contact.normal_noise = Some(f64::from(felt.normal_deviation));
            contact.force = Some(pressing(&touch));
            points.push(f64::from(felt.point_deviation));
            normals.push(f64::from(felt.normal_deviation));
            Words {
                translation: fingertip.translation.vector.into(),
                rotation: fingertip.rotation.coords.into(),
                words,
            }
            .put(&mut contact)
            .map_err(SimError::Words)?;
            grasp.contacts.push(contact);
        }
    }
    log.noise.point = rms(&points);
    log.noise.normal = rms(&normals);
    sensors.put(log).map_err(SimError::Words)?;
    Ok(sensed)
}

/// Sensors in all fingertips, and what each reads while nothing touches it.
fn mounted(kind: Kind, skin: words::Skin, fingers: usize, seed: u64) -> (Sensors, Vec<Forward>) {
    let period = match kind {
        Kind::Wrench => 1000,
        Kind::Electrodes => 10_000,
    };
    let mut sensors = Sensors { kind, skin, period, calibration: Vec::new(), rest: Vec::new() };
    let mut forward = Vec::new();
    for finger in 0..fingers {
        let seed = seed.wrapping_mul(31).wrapping_add(finger as u64);
        let mut sensor = match kind {
            Kind::Wrench => {
                let transducer = Transducer::new(gauges::Options::default(), seed);
                sensors.calibration.extend(transducer.calibration());
                Forward::Wrench(Box::new(transducer))
            }
            Kind::Electrodes => {
                Forward::Electrodes(Box::new(FluidFinger::new(film::Options::default(), seed)))
            }
        };
        let step = f64::from(period) * 1e-6;
        sensors.rest.push((0..TARE).map(|_| sensor.read(&[], GRAVITY, step)).collect());
        forward.push(sensor);
    }
    (sensors, forward)
}

/// A number drawn evenly between two.
fn between([low, high]: [f64; 2], random: &mut Random) -> f64 {
    low + (high - low) * random.unit()
}

/// Magnitude of the force, newtons.
fn pressing(touch: &Felt) -> f64 {
    Spatial::point(&touch.force).norm()
}

fn rms(values: &[f64]) -> Option<f64> {
    let sum: f64 = values.iter().map(|v| v * v).sum();
    (!values.is_empty()).then(|| (sum / values.len() as f64).sqrt())
}

/// The fingertip that touches at `point` with `place` of its skin, rolled about the normal.
fn facing(point: &Point, normal: &Point, (at, outward): &(Point, Point), roll: f64) -> Pose {
    let turn = Rotation3::rotation_between(outward, &-normal)
        .unwrap_or_else(|| Rotation3::new(Point::x() * std::f64::consts::PI));
    let rotation = Rotation3::new(normal * roll) * turn;
    Pose::from_parts(Translation3::from(point - rotation * at), UnitQuaternion::from(rotation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::GraspLog;
    use crate::quantity::Deviation;
    use crate::sim::{ObjectSpec, Options, simulate};

    fn exact(object: &str) -> Simulation {
        let object: ObjectSpec = object.parse().unwrap();
        let contact_noise = Deviation { length: 0.0, angle: 0.0 };
        let options = Options { grasps: Some(6), contact_noise, ..Options::new(object) };
        simulate(&options).unwrap()
    }

    /// Contacts are near the true ones, and the log's words give them again.
    fn senses(kind: Kind, point: f64, normal: f64) {
        let truth = exact("box:0.12x0.06x0.06");
        let mut simulation = truth.clone();
        let sensed = sense(&mut simulation, kind, 5).unwrap();
        let all: usize = truth.log.grasps.iter().map(|g| g.contacts.len()).sum();
        assert_eq!(sensed.felt + sensed.unfelt, all);
        assert!(sensed.felt * 10 >= all * 8, "{sensed:?}");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.jsonl");
        simulation.write(&path).unwrap();
        let log = GraspLog::read(&path).unwrap();
        let sensors = Sensors::of(&log).unwrap().unwrap();
        assert_eq!((sensors.kind, sensors.rest.len()), (kind, 5));
        let mut estimators: Vec<_> = (0..5).map(|f| sensors.estimator(f).unwrap()).collect();
        let (mut points, mut normals) = (Vec::new(), Vec::new());
        for (grasp, exact) in log.grasps.iter().zip(&truth.log.grasps) {
            for contact in &grasp.contacts {
                let finger = contact.finger.unwrap();
                let words = Words::of(contact).unwrap().unwrap();
                assert!(words.words.iter().all(|w| w.len() == kind.channels()));
                let touch = estimators[finger].read(&words.words).unwrap();
                if let Ok(touch) = touch {
                    assert!((pressing(&touch) - contact.force.unwrap()).abs() < 1e-9);
                }
                let twin = exact.contacts.iter().find(|c| c.finger == Some(finger)).unwrap();
                points.push((contact.point - twin.point).norm());
                normals.push(contact.normal.unwrap().angle(&twin.normal.unwrap()));
            }
        }
        let (p, n) = (rms(&points).unwrap(), rms(&normals).unwrap());
        assert!(p < point && n < normal, "{p} m, {n} rad");
    }

    #[test]
    fn transducers_feel_the_object() {
        senses(Kind::Wrench, 1e-3, 0.1);
    }

    #[test]
    fn electrodes_feel_the_object() {
        senses(Kind::Electrodes, 3e-3, 0.4);
    }

    #[test]
    fn what_has_no_fingertips_is_refused() {
        let error = sense(&mut exact("rectangle:0.1x0.06"), Kind::Wrench, 0).unwrap_err();
        assert!(error.to_string().contains("--sensors: expected a spatial object"), "{error}");
        let mut simulation = exact("sphere:0.08");
        simulation.log.grasps[0].contacts[0].finger = None;
        let error = sense(&mut simulation, Kind::Wrench, 0).unwrap_err();
        assert!(error.to_string().contains("--touch hand"), "{error}");
    }

    #[test]
    fn words_that_are_none_are_named() {
        let mut simulation = exact("sphere:0.08");
        sense(&mut simulation, Kind::Wrench, 1).unwrap();
        let mut log = simulation.log;
        let sensors = Sensors::of(&log).unwrap().unwrap();
        assert!(sensors.estimator(5).unwrap_err().to_string().contains("finger 5"));
        let mut estimator = sensors.estimator(0).unwrap();
        let error = estimator.read(&[vec![1, 2, 3]]).unwrap_err();
        assert!(error.to_string().contains("3 words, expected 6"), "{error}");
        let mut singular = sensors.clone();
        singular.calibration[2] = [[0.0; 6]; 6];
        let error = singular.estimator(2).unwrap_err();
        assert!(error.to_string().contains("singular"), "{error}");
        Sensors { period: 0, ..sensors }.put(&mut log).unwrap();
        let error = Sensors::of(&log).unwrap_err();
        assert!(error.to_string().contains("header: period is 0; expected"), "{error}");
        log.unknown.insert("sensors".into(), 3.into());
        let error = Sensors::of(&log).unwrap_err();
        assert!(error.to_string().contains("\"sensors\" of the header"), "{error}");
    }
}
