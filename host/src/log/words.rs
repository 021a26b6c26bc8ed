//! What fingertip sensors read, in a grasp log: enough to estimate its contacts again.
//!
//! The header's field `sensors` says what they are, a contact's field `sensor` what they read:
//!
//! ```text
//! "sensors": {"kind":"wrench", "skin":{"radius":0.007,"length":0.018}, "period":1000,
//!             "calibration":[[[6 × 6]] per finger], "rest":[[[words], …] per finger]}
//! "sensor":  {"translation":[x,y,z], "rotation":[x,y,z,w], "words":[[words], …]}
//! ```
//!
//! `rest` are the readings of the free finger that its estimator is tared with; a contact's are those
//! from the moment it closes. `translation` and `rotation` are the fingertip's pose in the world.
//! Programs that know nothing of them keep both fields as they are.

use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};
use tactile_core::sensing::calibration::GaugeCalibration;
use tactile_core::sensing::detection::Sampling;
use tactile_core::sensing::electrodes::BIOTAC_SKIN;
use tactile_core::sensing::fingertip::{Fingertip, Shape};
use tactile_core::sensing::{
    CalibrationError, ContactEstimator, ELECTRODES, ElectrodeEstimator, ElectrodeReading,
    ElectrodeSettings, GaugeReading, NoContact, Touch, WrenchEstimator, WrenchSettings,
};
use tactile_core::wire::{self, SensorPart};

use super::{GraspLog, LoggedContact};
use crate::space::{Point, Pose};

/// Field of a log's header.
const HEADER: &str = "sensors";
/// Field of a contact.
pub(super) const CONTACT: &str = "sensor";
/// Readings that make a tare: shorter than a board's, as a log keeps them all.
pub const TARE: usize = 32;

/// What is in the fingertips.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A six-axis transducer of strain gauges, as an ATI Nano17.
    Wrench,
    /// An array of 19 electrodes, as in a BioTac.
    Electrodes,
}

impl Kind {
    /// Words of one reading.
    pub fn channels(self) -> usize {
        match self {
            Kind::Wrench => 6,
            Kind::Electrodes => ELECTRODES,
        }
    }

    /// Least and most that its converter gives.
    fn range(self) -> (i32, i32) {
        match self {
            Kind::Wrench => (-0x80_0000, 0x7f_ffff),
            Kind::Electrodes => (0, 0xfff),
        }
    }

    /// Whether its converter gives such words.
    fn gives(self, finger: usize, reading: &[i32]) -> Result<(), WordsError> {
        let (from, to) = self.range();
        let word = reading.iter().copied().find(|word| !(from..=to).contains(word));
        word.map_or(Ok(()), |word| Err(WordsError::Word { finger, word, from, to }))
    }
}

/// A cylinder with a spherical cap, metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Skin {
    /// Of both.
    pub radius: f64,
    /// Of the cylinder.
    pub length: f64,
}

/// What the header says of the sensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sensors {
    /// What is in every fingertip.
    pub kind: Kind,
    /// The fingertips' skin.
    pub skin: Skin,
    /// Microseconds between readings.
    pub period: u32,
    /// For each finger, newtons and newton metres of each gauge's words; empty for electrodes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub calibration: Vec<[[f64; 6]; 6]>,
    /// For each finger, readings at rest.
    pub rest: Vec<Vec<Vec<i32>>>,
}

/// What a contact's sensor read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Words {
    /// Where the fingertip is in the world, metres.
    pub translation: [f64; 3],
    /// Its orientation, a quaternion x, y, z, w.
    pub rotation: [f64; 4],
    /// Reading after reading.
    pub words: Vec<Vec<i32>>,
}

/// Why a log's words cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum WordsError {
    /// A field is not what this module writes.
    #[error("field \"{field}\" of {place}: {reason}")]
    Field {
        /// Which.
        field: &'static str,
        /// Where in the log.
        place: String,
        /// What is wrong.
        reason: String,
    },
    /// A finger has no calibration or no readings at rest.
    #[error("finger {0}: no calibration, or no readings at rest")]
    Finger(usize),
    /// A converter cannot give such a word.
    #[error("finger {finger}: a word of {word}, expected {from} to {to} of its converter")]
    Word {
        /// Which.
        finger: usize,
        /// What it is.
        word: i32,
        /// Least that there is.
        from: i32,
        /// Most that there is.
        to: i32,
    },
    /// A reading has too few or too many words.
    #[error("finger {finger}: a reading of {found} words, expected {expected}")]
    Reading {
        /// Which.
        finger: usize,
        /// How many there are.
        found: usize,
        /// How many there should be.
        expected: usize,
    },
    /// The estimator refuses the settings.
    #[error("finger {finger}: {reason}")]
    Settings {
        /// Which.
        finger: usize,
        /// Why.
        reason: CalibrationError,
    },
}

impl Sensors {
    /// What a log's header says; `None` when it says nothing.
    ///
    /// # Errors
    /// [`WordsError::Field`].
    pub fn of(log: &GraspLog) -> Result<Option<Sensors>, WordsError> {
        let Some(value) = log.unknown.get(HEADER) else { return Ok(None) };
        let bad = |e: serde_json::Error| WordsError::Field {
            field: HEADER,
            place: "the header".into(),
            reason: e.to_string(),
        };
        let sensors = Sensors::deserialize(value).map_err(bad)?;
        if sensors.period == 0 {
            let reason = "period is 0; expected the microseconds between readings".into();
            return Err(WordsError::Field { field: HEADER, place: "the header".into(), reason });
        }
        Ok(Some(sensors))
    }

    /// Writes this into a log's header.
    ///
    /// # Errors
    /// [`WordsError::Field`], when a number is not finite.
    pub fn put(&self, log: &mut GraspLog) -> Result<(), WordsError> {
        let value = serde_json::to_value(self).map_err(|e| WordsError::Field {
            field: HEADER,
            place: "the header".into(),
            reason: e.to_string(),
        })?;
        log.unknown.insert(HEADER.into(), value);
        Ok(())
    }

    /// A finger's readings at rest, at least one.
    fn at_rest(&self, finger: usize) -> Result<&[Vec<i32>], WordsError> {
        let rest = self.rest.get(finger).filter(|rest| !rest.is_empty());
        rest.map(Vec::as_slice).ok_or(WordsError::Finger(finger))
    }

    /// What a board has to be told of a finger for its estimator to be [`estimator`](Self::estimator)'s;
    /// it is tared by the readings at rest.
    ///
    /// # Errors
    /// When the finger has no calibration or no readings at rest.
    pub fn parts(&self, finger: usize) -> Result<Vec<SensorPart>, WordsError> {
        let rest = self.at_rest(finger)?;
        let skin = SensorPart::Skin(wire::Skin::CappedCylinder {
            radius: self.skin.radius as f32,
            length: self.skin.length as f32,
        });
        let sampling = |usual: Sampling| SensorPart::Sampling {
            window: usual.window,
            gap: usual.gap,
            tare: rest.len().min(usize::from(u16::MAX)) as u16,
            spread: usual.spread,
        };
        let mut parts = Vec::new();
        match self.kind {
            Kind::Wrench => {
                let matrix = self.calibration.get(finger).ok_or(WordsError::Finger(finger))?;
                parts.push(SensorPart::Gauges);
                parts.extend(matrix.iter().enumerate().map(|(row, numbers)| SensorPart::Row {
                    row: row as u8,
                    numbers: numbers.map(|v| v as f32),
                }));
                parts.extend([skin, sampling(WrenchSettings::NANO17_SAMPLING)]);
            }
            Kind::Electrodes => {
                parts.extend([SensorPart::Electrodes, skin]);
                parts.extend(
                    BIOTAC_SKIN.edge.map(|edge| SensorPart::Edge {
                        normal: edge.normal.0,
                        offset: edge.offset,
                    }),
                );
                parts.push(sampling(ElectrodeSettings::BIOTAC.sampling));
            }
        }
        Ok(parts)
    }

    /// A finger's reading as it goes to a board.
    ///
    /// # Errors
    /// [`WordsError::Reading`] and [`WordsError::Word`].
    pub fn on_wire(&self, finger: usize, reading: &[i32]) -> Result<wire::Words, WordsError> {
        let expected = self.kind.channels();
        let bad = || WordsError::Reading { finger, found: reading.len(), expected };
        self.kind.gives(finger, reading)?;
        match self.kind {
            Kind::Wrench => reading.try_into().map(wire::Words::Gauges).map_err(|_| bad()),
            Kind::Electrodes => {
                let words: Vec<u16> = reading.iter().map(|word| *word as u16).collect();
                let electrodes = words.try_into().map_err(|_| bad())?;
                // The log has the electrodes alone, and contacts are made of them alone.
                let [pressure, vibration, temperature, heat_flow] = [2048; 4];
                Ok(wire::Words::Electrodes {
                    electrodes,
                    pressure,
                    vibration,
                    temperature,
                    heat_flow,
                })
            }
        }
    }

    /// The estimator of a finger, tared.
    ///
    /// # Errors
    /// When the finger is not there, a reading is not one, or the settings are refused.
    pub fn estimator(&self, finger: usize) -> Result<Estimator, WordsError> {
        let rest = self.at_rest(finger)?;
        let refused = |reason| WordsError::Settings { finger, reason };
        let shape = Shape::CappedCylinder {
            radius: self.skin.radius as f32,
            length: self.skin.length as f32,
        };
        let tare = rest.len().min(usize::from(u16::MAX)) as u16;
        let sensor = match self.kind {
            Kind::Wrench => {
                let matrix = self.calibration.get(finger).ok_or(WordsError::Finger(finger))?;
                let matrix = matrix.map(|row| row.map(|v| v as f32));
                let range = self.kind.range();
                let gauges = GaugeCalibration::new(matrix, range, WrenchSettings::NANO17);
                let skin = Fingertip { shape, edge: None };
                let mut settings = WrenchSettings::nano17(gauges.map_err(refused)?, skin);
                settings.sampling = Sampling { tare, ..settings.sampling };
                let mut estimator = Box::new(WrenchEstimator::new());
                estimator.configure(&settings).map_err(refused)?;
                Sensor::Wrench(estimator)
            }
            Kind::Electrodes => {
                let mut settings = ElectrodeSettings {
                    fingertip: Fingertip { shape, edge: BIOTAC_SKIN.edge },
                    ..ElectrodeSettings::BIOTAC
                };
                settings.sampling = Sampling { tare, ..settings.sampling };
                let mut estimator = Box::new(ElectrodeEstimator::new());
                estimator.configure(&settings).map_err(refused)?;
                Sensor::Electrodes(estimator)
            }
        };
        let mut estimator = Estimator { finger, sensor, time: 0, period: self.period };
        estimator.read(rest)?.err();
        Ok(estimator)
    }
}

impl Words {
    /// What a contact's sensor read; `None` when the log does not say.
    ///
    /// # Errors
    /// [`WordsError::Field`], also where there is not one reading: nothing can be felt of it.
    pub fn of(contact: &LoggedContact) -> Result<Option<Words>, WordsError> {
        let Some(value) = contact.unknown.get(CONTACT) else { return Ok(None) };
        let bad = |reason: String| WordsError::Field {
            field: CONTACT,
            place: "a contact".into(),
            reason,
        };
        let words = Words::deserialize(value).map_err(|e| bad(e.to_string()))?;
        if words.words.is_empty() {
            return Err(bad("expected at least one reading in `words`, found none".into()));
        }
        Ok(Some(words))
    }

    /// The fingertip's pose in the world; `None` when it is not finite or no rotation.
    pub fn fingertip(&self) -> Option<Pose> {
        let [x, y, z, w] = self.rotation;
        let turn = Quaternion::new(w, x, y, z);
        let usable = (turn.norm() - 1.0).abs() < 1e-3
            && Point::from(self.translation).iter().all(|v| v.is_finite());
        usable.then(|| {
            let at = Translation3::from(Point::from(self.translation));
            Pose::from_parts(at, UnitQuaternion::new_normalize(turn))
        })
    }

    /// Writes this into a contact.
    ///
    /// # Errors
    /// [`WordsError::Field`], when a number is not finite.
    pub fn put(&self, contact: &mut LoggedContact) -> Result<(), WordsError> {
        let value = serde_json::to_value(self).map_err(|e| WordsError::Field {
            field: CONTACT,
            place: "a contact".into(),
            reason: e.to_string(),
        })?;
        contact.unknown.insert(CONTACT.into(), value);
        Ok(())
    }
}

/// The board's estimator of one finger, fed with words of a log.
#[derive(Clone, Debug)]
pub struct Estimator {
    finger: usize,
    sensor: Sensor,
    /// Of the last reading, microseconds.
    time: u32,
    period: u32,
}

#[derive(Clone, Debug)]
enum Sensor {
    Wrench(Box<WrenchEstimator>),
    Electrodes(Box<ElectrodeEstimator>),
}

/// Microseconds between one closing of the hand and the next: longer than an estimator averages
/// over.
const PAUSE: u32 = 1_000_000;

impl Estimator {
    /// What is felt at the end of some readings in a row, of which the first comes after a pause.
    ///
    /// # Errors
    /// [`WordsError::Reading`]. That nothing is felt is an answer, not an error.
    pub fn read(&mut self, readings: &[Vec<i32>]) -> Result<Result<Touch, NoContact>, WordsError> {
        self.time = self.time.wrapping_add(PAUSE);
        let mut felt = Err(NoContact::TooLight);
        for words in readings {
            self.time = self.time.wrapping_add(self.period);
            let bad = |expected| WordsError::Reading {
                finger: self.finger,
                found: words.len(),
                expected,
            };
            felt = match &mut self.sensor {
                Sensor::Wrench(estimator) => {
                    let words: [i32; 6] = words.as_slice().try_into().map_err(|_| bad(6))?;
                    estimator.estimate(&GaugeReading(words), self.time)
                }
                Sensor::Electrodes(estimator) => {
                    let words: Option<Vec<u16>> =
                        words.iter().map(|&w| u16::try_from(w).ok()).collect();
                    let words = words.and_then(|words| words.try_into().ok());
                    let words = words.ok_or(bad(ELECTRODES))?;
                    estimator.estimate(&ElectrodeReading(words), self.time)
                }
            };
        }
        Ok(felt)
    }
}
