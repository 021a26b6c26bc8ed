//! A log's raw words through a board that has scripted fingertip sensors: it estimates the contacts
//! itself.

use tactile_core::driver::emulated::Fault;
use tactile_core::wire::{Clock, Settings, WireSpace, WordsFrame};

use super::{GraspOutcome, LogOutcome, Session, SessionError};
use crate::link::Link;
use crate::log::words::{Sensors, Words, WordsError};
use crate::log::{GraspLog, LoggedContact, LoggedGrasp};
use crate::slam::track;
use crate::space::{Bridge, Pose};

/// Microseconds of the sensors' clock between one closing of the hand and the next: longer than an
/// estimator averages over.
const PAUSE: u32 = 1_000_000;

/// Why words come to nothing.
#[derive(Debug, thiserror::Error)]
pub enum SensedError {
    /// Of the board.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Of the log.
    #[error(transparent)]
    Words(#[from] WordsError),
    /// The board has no fingertip sensors.
    #[error("the board has no fingertip sensors: take an image that has")]
    NoSensors,
    /// The words are not a fingertip's: its pose is none.
    #[error("grasp {grasp}, finger {finger}: the fingertip's pose is not finite, or no rotation")]
    Pose {
        /// Number in the log.
        grasp: usize,
        /// Which.
        finger: usize,
    },
}

impl<S: Bridge + WireSpace, L: Link> Session<S, L> {
    /// Configures the board and its sensors, tares them with the readings at rest, and feeds it a log
    /// whose contacts have words: of each finger it is told where the fingertip is and shown what the
    /// sensor read, and takes for contact what it feels then. Contacts without words, of fingers that
    /// the board does not have, and a second of the same finger in a grasp are sent as they are in the
    /// log. `each` is called after every grasp with its number in the log.
    ///
    /// # Errors
    /// When the log has another dimension or its words are not what they should be, the board has no
    /// sensors, or as every command: real sensors cannot be shown words.
    pub fn run_sensed(
        mut self,
        log: &GraspLog,
        sensors: &Sensors,
        settings: Settings,
        mut each: impl FnMut(usize, &GraspOutcome<S>),
    ) -> Result<LogOutcome<S>, SensedError> {
        let hello = match self.hello {
            Some(hello) if log.dimension == S::DIMENSION => hello,
            _ => {
                let board = self.hello.map_or(S::DIMENSION as u8, |h| h.dimension);
                return Err(SessionError::Dimension { board, log: log.dimension }.into());
            }
        };
        if hello.fingers == 0 {
            return Err(SensedError::NoSensors);
        }
        self.configure(settings)?;
        let fingers = usize::from(hello.fingers).min(sensors.rest.len());
        let mut clocks = vec![0; fingers];
        for (finger, clock) in clocks.iter_mut().enumerate() {
            self.set_up_sensor(finger as u8, &sensors.parts(finger)?)?;
            self.show_all(finger, sensors, &sensors.rest[finger], clock)?;
        }
        let mut grasps = Vec::with_capacity(log.grasps.len());
        let mut all_shown = 0;
        for (number, grasp) in log.grasps.iter().enumerate() {
            let mut told = LoggedGrasp { contacts: Vec::new(), ..grasp.clone() };
            let mut shown = vec![false; fingers];
            for contact in &grasp.contacts {
                match (free_finger(contact, &shown), Words::of(contact)?) {
                    (Some(finger), Some(words)) => {
                        let bad = SensedError::Pose { grasp: number, finger };
                        let pose: Pose = words.fingertip().ok_or(bad)?;
                        self.place_fingertip(finger as u8, &S::pose(&pose))?;
                        self.show_all(finger, sensors, &words.words, &mut clocks[finger])?;
                        shown[finger] = true;
                    }
                    _ => told.contacts.push(contact.clone()),
                }
            }
            all_shown += shown.iter().filter(|is_shown| **is_shown).count();
            let motion = grasp.motion.as_ref().map(S::pose);
            let contacts = track::contacts::<S>(&told, &log.noise);
            let free = track::free_points::<S>(grasp);
            let outcome = self.grasp(motion.as_ref(), &contacts, &free)?;
            each(number, &outcome);
            grasps.push(outcome);
        }
        let received = *self.decoder.counters();
        Ok(LogOutcome { hello, grasps, received, repeated: self.repeated, shown: all_shown })
    }

    /// Shows a finger readings in a row, of which the first comes after a pause.
    fn show_all(
        &mut self,
        finger: usize,
        sensors: &Sensors,
        readings: &[Vec<i32>],
        clock: &mut u32,
    ) -> Result<(), SensedError> {
        *clock = clock.wrapping_add(PAUSE);
        for reading in readings {
            *clock = clock.wrapping_add(sensors.period);
            let words = sensors.on_wire(finger, reading)?;
            let time = Clock(*clock);
            let finger = finger as u8;
            self.show(WordsFrame { finger, time, repeats: 0, words, fault: Fault::None })?;
        }
        Ok(())
    }
}

/// The finger of a contact, if its sensor has not been shown anything in this grasp.
fn free_finger(contact: &LoggedContact, shown: &[bool]) -> Option<usize> {
    contact.finger.filter(|finger| shown.get(*finger) == Some(&false))
}

#[cfg(test)]
mod tests {
    use tactile_core::space::Spatial;
    use tactile_core::wire::TrackerKind;

    use super::*;
    use crate::link::session::settings_for;
    use crate::link::{Patience, virtual_board};
    use crate::log::words::Kind;
    use crate::quantity::Deviation;
    use crate::sim::sensed::sense;
    use crate::sim::{Options, simulate};

    fn sensed(kind: Kind) -> GraspLog {
        let object = "box:0.12x0.06x0.06".parse().unwrap();
        let contact_noise = Deviation { length: 0.0, angle: 0.0 };
        let options = Options { grasps: Some(4), seed: 3, contact_noise, ..Options::new(object) };
        let mut simulation = simulate(&options).unwrap();
        sense(&mut simulation, kind, 5).unwrap();
        simulation.log
    }

    fn session() -> Session<Spatial, Box<dyn Link>> {
        Session::open(virtual_board::start_sensing(), Patience::default()).unwrap()
    }

    /// What the board feels of the words is what the same estimators made of them when they were
    /// recorded.
    #[test]
    fn a_boards_fingers_feel_the_contacts_of_the_log() {
        for kind in [Kind::Wrench, Kind::Electrodes] {
            let log = sensed(kind);
            let sensors = Sensors::of(&log).unwrap().unwrap();
            let settings = settings_for(&log, 1);
            let mut felt = 0;
            let outcome = session().run_sensed(&log, &sensors, settings, |_, _| ()).unwrap();
            for (grasp, logged) in outcome.grasps.iter().zip(&log.grasps) {
                for frame in &grasp.felt {
                    let found = frame.contact(&settings);
                    let same = |c: &&LoggedContact| c.finger == Some(frame.finger.into());
                    let there = logged.contacts.iter().find(same).unwrap();
                    let off = (Spatial::point(&found.point) - there.point).norm();
                    assert!(off < 3e-4, "{kind:?}, finger {}: {off} m", frame.finger);
                    felt += 1;
                }
                assert_eq!(usize::from(grasp.estimate.contacts), grasp.felt.len());
            }
            let contacts: usize = log.grasps.iter().map(|g| g.contacts.len()).sum();
            assert!(felt > 10 && felt >= contacts - 1, "{kind:?}: {felt} of {contacts}");
        }
    }

    #[test]
    fn what_cannot_be_felt_is_told_or_named() {
        let mut log = sensed(Kind::Wrench);
        let sensors = Sensors::of(&log).unwrap().unwrap();
        let settings = settings_for(&log, 1);
        // A finger without words, and one that comes twice.
        log.grasps[0].contacts[0].unknown.clear();
        let again = log.grasps[1].contacts[0].clone();
        log.grasps[1].contacts.push(again);
        let outcome = session().run_sensed(&log, &sensors, settings, |_, _| ()).unwrap();
        let felt: Vec<usize> = outcome.grasps.iter().map(|g| g.felt.len()).collect();
        assert_eq!(felt[0] + 1, log.grasps[0].contacts.len());
        let all: usize = log.grasps.iter().map(|grasp| grasp.contacts.len()).sum();
        assert_eq!(outcome.shown, all - 2);
        assert_eq!(usize::from(outcome.grasps[0].estimate.contacts), felt[0] + 1);

        let error = |log: &GraspLog, sensors: &Sensors| {
            session().run_sensed(log, sensors, settings, |_, _| ()).unwrap_err().to_string()
        };
        let mut bad = sensors.clone();
        bad.rest[1][3].pop();
        assert!(error(&log, &bad).contains("5 words, expected 6"));
        bad.rest[1][3].push(9_000_000);
        assert!(error(&log, &bad).contains("a word of 9000000, expected -8388608 to 8388607"));
        bad = sensors.clone();
        bad.calibration[2][1] = bad.calibration[2][0];
        assert!(error(&log, &bad).contains("singular"), "{}", error(&log, &bad));
        bad.calibration.truncate(2);
        assert!(error(&log, &bad).contains("finger 2"));
        let mut nowhere = log.clone();
        let mut words = Words::of(&log.grasps[2].contacts[1]).unwrap().unwrap();
        words.rotation = [0.0; 4];
        words.put(&mut nowhere.grasps[2].contacts[1]).unwrap();
        assert!(error(&nowhere, &sensors).contains("grasp 2"));
        // Neither could be felt, and nobody would know.
        let mut unread = log.clone();
        words.words.clear();
        words.put(&mut unread.grasps[2].contacts[1]).unwrap();
        assert!(error(&unread, &sensors).contains("at least one reading"));
        bad = sensors.clone();
        bad.rest[1].clear();
        assert!(error(&log, &bad).contains("finger 1: no calibration, or no readings at rest"));

        let plain = virtual_board::start(3, TrackerKind::Hypotheses).unwrap();
        let plain = Session::<Spatial, _>::open(plain, Patience::default()).unwrap();
        let outcome = plain.run_sensed(&log, &sensors, settings, |_, _| ());
        assert!(matches!(outcome, Err(SensedError::NoSensors)));
        let flat = Options { grasps: Some(1), ..Options::new("ellipse:0.1x0.06".parse().unwrap()) };
        let flat = simulate(&flat).unwrap().log;
        assert!(error(&flat, &sensors).contains("dimensions"));
    }
}
