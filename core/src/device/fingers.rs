//! The fingertips of a board: from samples to contacts in the world.

use super::draft::Draft;
use super::sampling::{Reading, Sample};
use crate::contact::Contact;
use crate::driver::DriverError;
use crate::matrix::{Coordinates, Matrix, Vector};
use crate::sensing::calibration::CalibrationError;
use crate::sensing::electrodes::ElectrodeEstimator;
use crate::sensing::wrench::WrenchEstimator;
use crate::sensing::{ContactEstimator, NoContact, Touch};
use crate::space::Pose;
use crate::wire::{
    FingerFrame, FingerState, FingertipFrame, Refusal, SHORTEST_STREAM, SensorFault, SensorFrame,
    SensorPart, WireSpace,
};

/// Gravity in a level world, metres per second squared along z.
const GRAVITY: f32 = -9.81;

/// `N` fingertips, each with an estimator for every kind of sensor; all zero bits at first.
///
/// What a finger feels lasts until its sensor says something else, or until it has become part of a
/// grasp: the next grasp needs it to be felt again.
#[derive(Clone, Debug)]
pub struct Fingers<S: WireSpace, const N: usize> {
    fingers: [Finger<S>; N],
    draft: Draft,
    /// Least microseconds from contact to contact of one finger; 0: none are streamed.
    period: u32,
}

#[derive(Clone, Debug)]
struct Finger<S: WireSpace> {
    /// Fingertip to world.
    pose: Option<S::Pose>,
    wrench: WrenchEstimator,
    electrodes: ElectrodeEstimator,
    last: Last,
    /// What is felt while `last` is touching.
    touch: Touch,
    /// Time of the sample that was last streamed.
    streamed: Option<u32>,
    readings: u32,
    contacts: u32,
    faults: u32,
}

/// What came of the last sample. The number of the variant comes first in memory, so that zero bits
/// are the first variant.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(u8)]
enum Last {
    Waiting,
    Fault(SensorFault),
    Free(NoContact),
    Touching,
}

const UNTOUCHED: Touch = Touch {
    time: 0,
    point: Vector([0.0; 3]),
    normal: Vector([0.0; 3]),
    force: Vector([0.0; 3]),
    covariance: Matrix([[0.0; 3]; 3]),
    normal_deviation: 0.0,
    slip: None,
};

impl<S: WireSpace> Finger<S> {
    const NEW: Self = Finger {
        pose: None,
        wrench: WrenchEstimator::new(),
        electrodes: ElectrodeEstimator::new(),
        last: Last::Waiting,
        touch: UNTOUCHED,
        streamed: None,
        readings: 0,
        contacts: 0,
        faults: 0,
    };

    /// The contact in the world that is felt now; `None` without one, or where nobody has said where
    /// the fingertip is.
    fn felt(&self, number: u8) -> Option<Contact<S>> {
        match self.last {
            Last::Touching => self.touch.contact::<S>(&self.pose?, number),
            _ => None,
        }
    }

    fn set_gravity(&mut self) {
        let Some(pose) = self.pose else { return };
        // In the plane the fingertip's z stands on it.
        let mut down = Vector([0.0, 0.0, GRAVITY]);
        if S::DIMENSION == 3 {
            let mut gravity = S::Vector::ZERO;
            gravity[2] = GRAVITY;
            let gravity = pose.unrotate(gravity);
            down = Vector([gravity[0], gravity[1], gravity[2]]);
        }
        self.wrench.set_gravity(down);
        self.electrodes.set_gravity(down);
    }
}

impl<S: WireSpace, const N: usize> Fingers<S, N> {
    /// Fingertips that know nothing of their sensors.
    pub const fn new() -> Self {
        Fingers { fingers: [Finger::NEW; N], draft: Draft::None, period: 0 }
    }

    /// How many there are.
    pub fn count(&self) -> u8 {
        N.min(u8::MAX.into()) as u8
    }

    fn finger(&mut self, number: u8) -> Result<&mut Finger<S>, Refusal> {
        self.fingers.get_mut(usize::from(number)).ok_or(Refusal::NoSuch)
    }

    /// Says where a fingertip is, and so which way gravity pulls in it.
    ///
    /// # Errors
    /// [`Refusal::NoSuch`] or [`Refusal::Pose`].
    pub fn place(&mut self, frame: &FingertipFrame<S>) -> Result<(), Refusal> {
        let finger = self.finger(frame.finger)?;
        finger.pose = Some(frame.pose().ok_or(Refusal::Pose)?);
        finger.set_gravity();
        Ok(())
    }

    /// Takes a part of a sensor's settings.
    ///
    /// # Errors
    /// [`Refusal::NoSuch`], [`Refusal::Part`]; [`Refusal::Singular`] and [`Refusal::Sensor`] when
    /// the parts are put to use, which changes nothing then.
    pub fn tell(&mut self, frame: &SensorFrame) -> Result<(), Refusal> {
        let finger = self.fingers.get_mut(usize::from(frame.finger)).ok_or(Refusal::NoSuch)?;
        if frame.part != SensorPart::Use {
            return self.draft.tell(frame);
        }
        let outcome = match &self.draft {
            Draft::Gauges(number, gauges) if *number == frame.finger => {
                gauges.settings().and_then(|settings| finger.wrench.configure(&settings))
            }
            Draft::Electrodes(number, settings) if *number == frame.finger => {
                finger.electrodes.configure(settings)
            }
            _ => return Err(Refusal::Part),
        };
        outcome.map_err(|error| match error {
            CalibrationError::Singular => Refusal::Singular,
            _ => Refusal::Sensor,
        })?;
        finger.last = Last::Waiting;
        finger.set_gravity();
        Ok(())
    }

    /// Takes the finger for free.
    ///
    /// # Errors
    /// [`Refusal::NoSuch`].
    pub fn tare(&mut self, number: u8) -> Result<(), Refusal> {
        let finger = self.finger(number)?;
        finger.wrench.tare();
        finger.electrodes.tare();
        finger.last = Last::Waiting;
        Ok(())
    }

    /// Sets how often contacts are streamed; 0 for not at all.
    ///
    /// # Errors
    /// [`Refusal::Rate`] above 200 Hz.
    pub fn set_stream(&mut self, period: u32) -> Result<(), Refusal> {
        if period != 0 && period < SHORTEST_STREAM {
            return Err(Refusal::Rate);
        }
        self.period = period;
        Ok(())
    }

    /// Takes what came of sampling a finger; gives the contact that is felt now.
    pub fn feel(
        &mut self,
        number: u8,
        outcome: Result<Option<Sample>, DriverError>,
    ) -> Option<Contact<S>> {
        let finger = self.fingers.get_mut(usize::from(number))?;
        let sample = match outcome {
            Ok(sample) => sample?,
            Err(error) => {
                finger.faults = finger.faults.saturating_add(1);
                finger.last = Last::Fault(error.into());
                return None;
            }
        };
        finger.readings = finger.readings.saturating_add(1);
        let felt = match &sample.reading {
            Reading::Gauges(reading) => finger.wrench.estimate(reading, sample.time),
            Reading::Electrodes(reading) => finger.electrodes.estimate(reading, sample.time),
        };
        match felt {
            Ok(touch) => {
                finger.contacts = finger.contacts.saturating_add(1);
                (finger.last, finger.touch) = (Last::Touching, touch);
                finger.felt(number)
            }
            Err(reason) => {
                finger.last = Last::Free(reason);
                None
            }
        }
    }

    /// Whether what a finger felt at `time` is to be streamed; it counts as streamed then.
    pub fn is_due(&mut self, number: u8, time: u32) -> bool {
        let period = self.period;
        let Ok(finger) = self.finger(number) else { return false };
        let due =
            period > 0 && finger.streamed.is_none_or(|last| time.wrapping_sub(last) >= period);
        if due {
            finger.streamed = Some(time);
        }
        due
    }

    /// The contact that a finger feels, for a grasp: it has to be felt again for the next.
    pub fn take(&mut self, number: u8) -> Option<Contact<S>> {
        let finger = self.finger(number).ok()?;
        let contact = finger.felt(number);
        if finger.last == Last::Touching {
            finger.last = Last::Waiting;
        }
        contact
    }

    /// Forgets what is felt; sensors stay set up and tared.
    pub fn forget(&mut self) {
        for finger in &mut self.fingers {
            finger.last = Last::Waiting;
        }
    }

    /// How a finger fares; `None` beyond the last.
    pub fn report(&self, number: u8) -> Option<FingerFrame> {
        let finger = self.fingers.get(usize::from(number))?;
        let state = match finger.last {
            Last::Waiting => FingerState::Waiting,
            Last::Fault(fault) => FingerState::Fault(fault),
            Last::Free(reason) => FingerState::Free(reason),
            Last::Touching => {
                FingerState::Touching { force: finger.touch.force.0, slip: finger.touch.slip }
            }
        };
        let Finger { readings, contacts, faults, .. } = *finger;
        Some(FingerFrame { finger: number, state, readings, contacts, faults })
    }
}

impl<S: WireSpace, const N: usize> Default for Fingers<S, N> {
    fn default() -> Self {
        Self::new()
    }
}
