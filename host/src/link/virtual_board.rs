//! The board's own code, with the board's own capacities, in this process.

use std::collections::VecDeque;
use std::io;
use std::time::{Duration, Instant};

use tactile_core::device::{
    Board, Device, Onboard, PlanarAutomaticDevice, PlanarCurvedDevice, PlanarDevice,
    PlanarHypothesesDevice, PlanarRaoBlackwellDevice, Scripted, SpatialAutomaticDevice,
    SpatialCurvedDevice, SpatialDevice, SpatialHypothesesDevice, SpatialRaoBlackwellDevice,
    SpatialSensingDevice, Vitals,
};
use tactile_core::wire::{BoardKind, TrackerKind, WireSpace};

use super::Link;

/// How long a board that samples is left alone.
const BETWEEN_SAMPLES: Duration = Duration::from_micros(200);

/// A device and the bytes it has sent. Its fingertip sensors, if any, are scripted.
pub struct VirtualBoard<T, S: WireSpace, const CONTACTS: usize, const FINGERS: usize = 0> {
    device: Box<Device<T, S, CONTACTS, FINGERS>>,
    wires: Scripted<Wires, FINGERS>,
}

/// What a virtual board has for hardware.
struct Wires {
    start: Instant,
    sent: VecDeque<u8>,
}

impl Board for Wires {
    const KIND: BoardKind = BoardKind::Virtual;

    fn now(&mut self) -> u32 {
        self.start.elapsed().as_micros() as u32
    }

    fn receive(&mut self, _: &mut [u8], _: bool) -> usize {
        0
    }

    fn send(&mut self, bytes: &[u8]) {
        self.sent.extend(bytes);
    }

    fn vitals(&mut self) -> Vitals {
        Vitals::default()
    }
}

impl<T: Onboard<S>, S: WireSpace, const CONTACTS: usize, const FINGERS: usize>
    VirtualBoard<T, S, CONTACTS, FINGERS>
{
    /// Switches the device on; it introduces itself.
    pub fn start(device: Box<Device<T, S, CONTACTS, FINGERS>>) -> Self {
        let wires = Wires { start: Instant::now(), sent: VecDeque::new() };
        let mut board = VirtualBoard { device, wires: Scripted::new(wires) };
        board.device.announce(&mut board.wires);
        board
    }
}

/// A virtual board of this dimension and tracker, as the firmware's image carries it; `None` where
/// there is no such image.
pub fn start(dimension: usize, tracker: TrackerKind) -> Option<Box<dyn Link>> {
    match (dimension, tracker) {
        (2, TrackerKind::Bootstrap) => on(PlanarDevice::START),
        (3, TrackerKind::Bootstrap) => on(SpatialDevice::START),
        (2, TrackerKind::Hypotheses) => on(PlanarHypothesesDevice::START),
        (3, TrackerKind::Hypotheses) => on(SpatialHypothesesDevice::START),
        (2, TrackerKind::RaoBlackwell) => on(PlanarRaoBlackwellDevice::START),
        (3, TrackerKind::RaoBlackwell) => on(SpatialRaoBlackwellDevice::START),
        (2, TrackerKind::Curved) => on(PlanarCurvedDevice::START),
        (3, TrackerKind::Curved) => on(SpatialCurvedDevice::START),
        (2, TrackerKind::Automatic) => on(PlanarAutomaticDevice::START),
        (3, TrackerKind::Automatic) => on(SpatialAutomaticDevice::START),
        _ => None,
    }
}

/// A virtual board as the firmware's image `spatial-sensing`: hypotheses in space, and five
/// fingertips whose sensors show what they are told.
pub fn start_sensing() -> Box<dyn Link> {
    Box::new(VirtualBoard::start(Box::new(SpatialSensingDevice::START)))
}

fn on<T, S, const CONTACTS: usize>(device: Device<T, S, CONTACTS>) -> Option<Box<dyn Link>>
where
    T: Onboard<S> + 'static,
    S: WireSpace,
{
    Some(Box::new(VirtualBoard::start(Box::new(device))))
}

impl<T: Onboard<S>, S: WireSpace, const CONTACTS: usize, const FINGERS: usize> Link
    for VirtualBoard<T, S, CONTACTS, FINGERS>
{
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.device.take(bytes, &mut self.wires);
        Ok(())
    }

    fn receive(&mut self, bytes: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let deadline = Instant::now() + timeout;
        // Whoever listens gives the board time to look at its sensors.
        while self.wires.is_sampling() {
            self.device.sense(&mut self.wires);
            let left = deadline.saturating_duration_since(Instant::now());
            if !self.wires.board().sent.is_empty() || left.is_zero() {
                break;
            }
            std::thread::sleep(left.min(BETWEEN_SAMPLES));
        }
        let sent = &mut self.wires.board().sent;
        let count = bytes.len().min(sent.len());
        for (byte, sent) in bytes.iter_mut().zip(sent.drain(..count)) {
            *byte = sent;
        }
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use tactile_core::space::Planar;

    use super::*;
    use crate::link::session::settings_for;
    use crate::link::{Patience, Session};
    use crate::sim::{ObjectSpec, Options, simulate};

    #[test]
    fn boards_carry_the_tracker_they_are_started_with() {
        let object: ObjectSpec = "rectangle:0.10x0.06".parse().unwrap();
        let log = simulate(&Options { grasps: Some(4), ..Options::new(object) }).unwrap().log;
        use TrackerKind::{Automatic, Bootstrap, Curved, Hypotheses, RaoBlackwell};
        let trackers =
            [(Bootstrap, 250), (RaoBlackwell, 64), (Hypotheses, 4), (Curved, 4), (Automatic, 8)];
        for (tracker, particles) in trackers {
            let board = start(2, tracker).unwrap();
            let mut session = Session::<Planar, _>::open(board, Patience::default()).unwrap();
            assert_eq!(session.hello().map(|h| h.tracker), Some(tracker));
            assert!(session.faces().unwrap().is_empty());
            let outcome = session.run(&log, settings_for(&log, 1), |_, _| ()).unwrap();
            assert_eq!((outcome.hello.particles, outcome.poses().len()), (particles, 4));
        }
        assert!(start(4, Bootstrap).is_none() && start(1, RaoBlackwell).is_none());
    }
}
