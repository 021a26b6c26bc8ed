//! The messages about fingertip sensors on the board. Their bytes are explained in [`crate::wire`].

use serde::{Deserialize, Serialize};

use super::quantity::{Clock, WireSpace};
use crate::driver::DriverError;
use crate::driver::biotac;
use crate::driver::emulated::Fault;
use crate::matrix::{Matrix, Vector};
use crate::sensing::NoContact;
use crate::sensing::fingertip::Shape;

/// Where a fingertip is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct FingertipFrame<S: WireSpace> {
    /// Which finger, from 0.
    pub finger: u8,
    /// Fingertip to world.
    pub numbers: S::Numbers,
}

impl<S: WireSpace> FingertipFrame<S> {
    /// Packs a fingertip's pose.
    pub fn new(finger: u8, fingertip: &S::Pose) -> Self {
        FingertipFrame { finger, numbers: S::pack_pose(fingertip) }
    }

    /// Fingertip to world, or `None` when a number is not finite.
    pub fn pose(&self) -> Option<S::Pose> {
        S::unpack_pose(self.numbers)
    }
}

/// What a sensor says at one moment, as its converter has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Words {
    /// Six strain gauges: counts of a 24-bit converter, of which the lower 24 bits are seen.
    Gauges([i32; 6]),
    /// A BioTac, twelve bits each.
    Electrodes {
        /// E1 to E19.
        electrodes: [u16; biotac::ELECTRODES],
        /// Fluid pressure, PDC.
        pressure: u16,
        /// Vibration, PAC: the same all frame.
        vibration: u16,
        /// Temperature, TDC.
        temperature: u16,
        /// Heat flow, TAC.
        heat_flow: u16,
    },
}

/// What a scripted sensor shows: for a board without real ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct WordsFrame {
    /// Which finger, from 0.
    pub finger: u8,
    /// When it is sampled, microseconds of the script's clock.
    pub time: Clock,
    /// How often it is shown again after the first time, a millisecond apart by the script's clock
    /// and at that pace by the board's.
    pub repeats: u16,
    /// What it shows.
    pub words: Words,
    /// What is wrong with it.
    pub fault: Fault,
}

/// One part of what a finger's sensor is told. A sensor's settings are longer than a frame: they
/// are begun with [`SensorPart::Gauges`] or [`SensorPart::Electrodes`], which stand for defaults,
/// changed part by part, and only [`SensorPart::Use`] puts them to use, all or none of them. One finger after the
/// other: what was begun for another and not put to use is forgotten.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SensorFrame {
    /// Which finger, from 0.
    pub finger: u8,
    /// What.
    pub part: SensorPart,
}

/// See [`SensorFrame`]. What the numbers mean is said where the estimators take them:
/// [`WrenchSettings`](crate::sensing::wrench::WrenchSettings) and
/// [`ElectrodeSettings`](crate::sensing::electrodes::ElectrodeSettings).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum SensorPart {
    /// Begins a force/torque transducer: a Nano17's noise and range, no calibration, no skin.
    Gauges,
    /// Begins an array of electrodes: a BioTac's.
    Electrodes,
    /// A row of the transducer's calibration, from 0: force x, y, z in newtons, moment x, y, z in
    /// newton metres, per count of each gauge.
    Row {
        /// Which component.
        row: u8,
        /// Six gauges.
        numbers: [f32; 6],
    },
    /// Between which counts of the converter a reading is credible: at an end it is saturated.
    Range {
        /// The least.
        least: i32,
        /// The most.
        most: i32,
    },
    /// Loads beyond which the transducer is overloaded, as a row each.
    Capacity([f32; 6]),
    /// Standard deviations of one reading, as a row each.
    Noise([f32; 6]),
    /// The transducer's frame in the fingertip frame: x, y, z, quaternion x, y, z, w.
    Mount([f32; 7]),
    /// What hangs on the transducer.
    Weight {
        /// Kilograms.
        mass: f32,
        /// Centre of mass in the fingertip frame, metres.
        centre: [f32; 3],
    },
    /// Where the skin is. It does not end until an [`Edge`](Self::Edge) is told after it.
    Skin(Skin),
    /// Where the skin told before ends: unit vector towards the skin, metres along it.
    Edge {
        /// Unit vector.
        normal: [f32; 3],
        /// Metres.
        offset: f32,
    },
    /// How well the skin is known: standard deviations, metres and radians.
    Tolerance {
        /// Of a point along its normal.
        point: f32,
        /// Of a normal.
        normal: f32,
    },
    /// What a contact of the transducer must satisfy.
    Limits {
        /// Tangential over normal force.
        friction: f32,
        /// Torsion over normal force, metres.
        torsion: f32,
        /// Standard deviation of the point, metres.
        precision: f32,
    },
    /// When a contact begins and ends.
    Detection {
        /// Level at which it begins.
        begin: f32,
        /// Level below which it ends.
        end: f32,
        /// Readings in a row it takes to begin.
        begin_readings: u8,
        /// Readings in a row it takes to end.
        end_readings: u8,
    },
    /// Averaging and taring.
    Sampling {
        /// Readings averaged.
        window: u8,
        /// Longest pause between them, microseconds.
        gap: u32,
        /// Readings of a free fingertip that make the bias.
        tare: u16,
        /// Counts they may differ by.
        spread: i32,
    },
    /// Share of what a free sensor reads that its bias takes over with each reading.
    Drift(f32),
    /// Where an electrode is, fingertip frame, metres.
    Electrode {
        /// Which, from 0 (E1).
        number: u8,
        /// Where.
        position: [f32; 3],
    },
    /// How the electrodes' readings scatter, and how the skin gives way.
    Response {
        /// Standard deviation of one word.
        noise: f32,
        /// How far around a contact impedances rise, metres.
        footprint: f32,
        /// How far, relatively, electrodes stray from that.
        mismatch: f32,
        /// How far contacts stray from the electrode that changes most, metres.
        stray: f32,
        /// Newtons per summed relative change.
        stiffness: f32,
        /// Standard deviation of the point above which there is no contact, metres.
        precision: f32,
    },
    /// Puts the parts to use; the sensor is tared next.
    Use,
}

/// A skin's shape; see [`Shape`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Skin {
    /// Radius.
    Sphere(f32),
    /// Half axes.
    Ellipsoid([f32; 3]),
    /// A cylinder with a spherical cap.
    CappedCylinder {
        /// Of both.
        radius: f32,
        /// Of the cylinder.
        length: f32,
    },
    /// A general convex quadric.
    Quadric {
        /// xx, xy, xz, yy, yz, zz of the symmetric matrix.
        matrix: [f32; 6],
        /// The linear part.
        linear: [f32; 3],
        /// The constant.
        constant: f32,
    },
}

impl From<Shape> for Skin {
    fn from(shape: Shape) -> Self {
        match shape {
            Shape::Sphere { radius } => Skin::Sphere(radius),
            Shape::Ellipsoid { half_axes } => Skin::Ellipsoid(half_axes.0),
            Shape::CappedCylinder { radius, length } => Skin::CappedCylinder { radius, length },
            Shape::Quadric { matrix: Matrix(m), linear, constant } => Skin::Quadric {
                matrix: [m[0][0], m[0][1], m[0][2], m[1][1], m[1][2], m[2][2]],
                linear: linear.0,
                constant,
            },
        }
    }
}

impl From<Skin> for Shape {
    fn from(skin: Skin) -> Self {
        match skin {
            Skin::Sphere(radius) => Shape::Sphere { radius },
            Skin::Ellipsoid(half_axes) => Shape::Ellipsoid { half_axes: Vector(half_axes) },
            Skin::CappedCylinder { radius, length } => Shape::CappedCylinder { radius, length },
            Skin::Quadric { matrix: [xx, xy, xz, yy, yz, zz], linear, constant } => {
                Shape::Quadric {
                    matrix: Matrix([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]),
                    linear: Vector(linear),
                    constant,
                }
            }
        }
    }
}

/// How a finger fares, and what it feels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FingerFrame {
    /// Which finger, from 0.
    pub finger: u8,
    /// What came of the last sample.
    pub state: FingerState,
    /// Readings taken since the board started.
    pub readings: u32,
    /// Readings that gave a contact.
    pub contacts: u32,
    /// Samples that failed, see [`FingerState::Fault`].
    pub faults: u32,
}

/// What came of a finger's last sample.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum FingerState {
    /// Nothing has been sampled yet, or since the last commit.
    Waiting,
    /// The sensor could not be read.
    Fault(SensorFault),
    /// It was read, and there is no contact to report.
    Free(NoContact),
    /// It touches.
    Touching {
        /// Of the object on the fingertip, fingertip frame, newtons.
        force: [f32; 3],
        /// Tangential over normal force, where the sensor feels it.
        slip: Option<f32>,
    },
}

/// Why a sensor could not be read: [`DriverError`] without its particulars.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SensorFault {
    /// The bus or a pin failed.
    Bus,
    /// Nobody drives the line.
    Missing,
    /// A byte has even parity.
    Parity,
    /// A checksum does not match.
    Crc,
    /// A command was not taken.
    Command,
    /// No new data in time.
    Timeout,
    /// Another device, or one that cannot be set up.
    Device,
    /// It has restarted, and is set up again.
    Restarted,
}

impl From<DriverError> for SensorFault {
    fn from(error: DriverError) -> Self {
        match error {
            DriverError::Bus(_) | DriverError::Pin(_) => SensorFault::Bus,
            DriverError::Missing => SensorFault::Missing,
            DriverError::Parity { .. } => SensorFault::Parity,
            DriverError::Crc { .. } => SensorFault::Crc,
            DriverError::Command => SensorFault::Command,
            DriverError::Timeout => SensorFault::Timeout,
            DriverError::Device { .. } | DriverError::Register { .. } => SensorFault::Device,
            DriverError::Restarted => SensorFault::Restarted,
        }
    }
}
