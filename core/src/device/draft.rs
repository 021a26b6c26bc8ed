//! A sensor's settings as they are told, part by part.

use crate::matrix::Vector;
use crate::sensing::calibration::{CalibrationError, GaugeCalibration, Weight};
use crate::sensing::detection::{Hysteresis, Sampling};
use crate::sensing::electrodes::ElectrodeSettings;
use crate::sensing::fingertip::{Edge, Fingertip, Shape};
use crate::sensing::{Tolerance, WrenchSettings};
use crate::space::{Spatial, SpatialPose};
use crate::wire::{Refusal, SensorFrame, SensorPart, WireSpace};

/// Settings of one finger's sensor that are not in use yet. The number of the variant comes first in
/// memory, so that zero bits are the first variant.
#[derive(Clone, Debug)]
#[repr(u8)]
pub(super) enum Draft {
    /// Nothing was begun.
    None,
    /// Of the transducer of this finger.
    Gauges(u8, GaugeDraft),
    /// Of the electrodes of this finger.
    Electrodes(u8, ElectrodeSettings),
}

/// A transducer's settings, whose calibration is checked when it is complete.
#[derive(Clone, Debug)]
pub(super) struct GaugeDraft {
    matrix: [[f32; 6]; 6],
    range: (i32, i32),
    capacity: [f32; 6],
    rest: WrenchSettings,
}

/// Ends of a 24-bit converter.
const CONVERTER: (i32, i32) = (-0x80_0000, 0x7f_ffff);

impl GaugeDraft {
    /// A Nano17's capacity and noise, a skin without size, and no calibration: both have to be told.
    fn new() -> Result<Self, CalibrationError> {
        let capacity = WrenchSettings::NANO17;
        let mut matrix = [[0.0; 6]; 6];
        for (k, row) in matrix.iter_mut().enumerate() {
            row[k] = capacity[k];
        }
        // Completes the struct; `settings` puts in its place what was told, or refuses.
        let untold = GaugeCalibration::new(matrix, CONVERTER, capacity)?;
        let skin = Fingertip { shape: Shape::Sphere { radius: 0.0 }, edge: None };
        Ok(GaugeDraft {
            matrix: [[0.0; 6]; 6],
            range: CONVERTER,
            capacity,
            rest: WrenchSettings::nano17(untold, skin),
        })
    }

    /// The settings with the calibration as it was told.
    pub(super) fn settings(&self) -> Result<WrenchSettings, CalibrationError> {
        let gauges = GaugeCalibration::new(self.matrix, self.range, self.capacity)?;
        Ok(WrenchSettings { gauges, ..self.rest })
    }

    fn tell(&mut self, part: &SensorPart) -> Result<(), Refusal> {
        let rest = &mut self.rest;
        match *part {
            SensorPart::Row { row, numbers } => {
                *self.matrix.get_mut(usize::from(row)).ok_or(Refusal::Part)? = numbers;
            }
            SensorPart::Range { least, most } => self.range = (least, most),
            SensorPart::Capacity(capacity) => self.capacity = capacity,
            SensorPart::Noise(noise) => rest.noise = noise,
            SensorPart::Mount(numbers) => rest.sensor = mount(numbers)?,
            SensorPart::Weight { mass, centre } => {
                rest.weight = Weight { mass, centre: Vector(centre) };
            }
            SensorPart::Limits { friction, torsion, precision } => {
                (rest.friction, rest.torsion, rest.precision) = (friction, torsion, precision);
            }
            SensorPart::Drift(drift) => rest.drift = drift,
            ref other => {
                return Common {
                    fingertip: &mut rest.fingertip,
                    tolerance: &mut rest.tolerance,
                    detection: &mut rest.detection,
                    sampling: &mut rest.sampling,
                }
                .tell(other);
            }
        }
        Ok(())
    }
}

fn mount(numbers: [f32; 7]) -> Result<SpatialPose, Refusal> {
    Spatial::unpack_pose(numbers).ok_or(Refusal::Sensor)
}

/// What every kind of sensor is told.
struct Common<'a> {
    fingertip: &'a mut Fingertip,
    tolerance: &'a mut Tolerance,
    detection: &'a mut Hysteresis,
    sampling: &'a mut Sampling,
}

impl Common<'_> {
    fn tell(self, part: &SensorPart) -> Result<(), Refusal> {
        match *part {
            SensorPart::Skin(skin) => {
                *self.fingertip = Fingertip { shape: skin.into(), edge: None };
            }
            SensorPart::Edge { normal, offset } => {
                self.fingertip.edge = Some(Edge { normal: Vector(normal), offset });
            }
            SensorPart::Tolerance { point, normal } => {
                *self.tolerance = Tolerance { point, normal }
            }
            SensorPart::Detection { begin, end, begin_readings, end_readings } => {
                *self.detection = Hysteresis { begin, end, begin_readings, end_readings };
            }
            SensorPart::Sampling { window, gap, tare, spread } => {
                *self.sampling = Sampling { window, gap, tare, spread };
            }
            _ => return Err(Refusal::Part),
        }
        Ok(())
    }
}

fn tell_electrodes(settings: &mut ElectrodeSettings, part: &SensorPart) -> Result<(), Refusal> {
    match *part {
        SensorPart::Electrode { number, position } => {
            let place = settings.positions.get_mut(usize::from(number)).ok_or(Refusal::Part)?;
            *place = Vector(position);
            Ok(())
        }
        SensorPart::Range { least, most } => {
            let word = |count: i32| u16::try_from(count).map_err(|_| Refusal::Sensor);
            settings.range = (word(least)?, word(most)?);
            Ok(())
        }
        SensorPart::Response { noise, footprint, mismatch, stray, stiffness, precision } => {
            *settings = ElectrodeSettings {
                noise,
                footprint,
                mismatch,
                stray,
                stiffness,
                precision,
                ..*settings
            };
            Ok(())
        }
        SensorPart::Drift(drift) => {
            settings.drift = drift;
            Ok(())
        }
        ref other => Common {
            fingertip: &mut settings.fingertip,
            tolerance: &mut settings.tolerance,
            detection: &mut settings.detection,
            sampling: &mut settings.sampling,
        }
        .tell(other),
    }
}

impl Draft {
    /// Begins the settings of a finger's sensor, or takes a part of them.
    pub(super) fn tell(&mut self, frame: &SensorFrame) -> Result<(), Refusal> {
        let finger = frame.finger;
        match (&mut *self, &frame.part) {
            (_, SensorPart::Gauges) => {
                let begun = GaugeDraft::new().map_err(|_| Refusal::Sensor)?;
                *self = Draft::Gauges(finger, begun);
                Ok(())
            }
            (_, SensorPart::Electrodes) => {
                *self = Draft::Electrodes(finger, ElectrodeSettings::BIOTAC);
                Ok(())
            }
            (Draft::Gauges(of, gauges), part) if *of == finger => gauges.tell(part),
            (Draft::Electrodes(of, settings), part) if *of == finger => {
                tell_electrodes(settings, part)
            }
            _ => Err(Refusal::Part),
        }
    }
}
