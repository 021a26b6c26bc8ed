//! The same sensor without a processor that waits for it.

use embedded_hal::spi::SpiDevice;

use super::{BETWEEN_US, Channel, Frame, SAMPLING_US, SLOTS, decode};
use crate::driver::{DriverError, Sampler, is_silent};

/// A BioTac whose pauses are given back: a poll sends a command or fetches an answer when a clock
/// says that it is time to, and otherwise returns at once. A frame takes 88 such polls.
///
/// The clock gives microseconds since any moment, wrapping.
///
/// ```
/// use core::cell::Cell;
/// use tactile_core::driver::Sampler;
/// use tactile_core::driver::biotac::{Frame, Paced};
/// use tactile_core::driver::emulated::BioTacChip;
///
/// let now = Cell::new(0);
/// let mut frame = Frame::ZERO;
/// frame.electrodes[3] = 2893;
/// let mut sensor = Paced::new(BioTacChip::showing(frame), || now.get());
/// let read = (0..3000).find_map(|time| {
///     now.set(time); // what the processor does meanwhile
///     sensor.poll().unwrap()
/// });
/// assert_eq!(read, Some(frame));
/// ```
#[derive(Clone, Debug)]
pub struct Paced<SPI, CLOCK> {
    spi: SPI,
    clock: CLOCK,
    frame: Frame,
    /// Slot that is sampled next, and whether it was asked for.
    pub(super) next: u8,
    pub(super) asked: bool,
    /// When the bus was last used, microseconds; `None` before.
    used: Option<u32>,
}

/// Looks at the clock for one reading at most: a clock that stands still ends in a time-out.
const LOOKS: u32 = 1_000_000;

impl<SPI, CLOCK> Paced<SPI, CLOCK> {
    /// A sensor at the start of a frame; the bus in mode 0, most significant bit first.
    pub const fn new(spi: SPI, clock: CLOCK) -> Self {
        Paced { spi, clock, frame: Frame::ZERO, next: 0, asked: false, used: None }
    }

    /// The bus, to reach an emulated chip behind it.
    pub fn spi(&mut self) -> &mut SPI {
        &mut self.spi
    }
}

impl<SPI: SpiDevice, CLOCK: FnMut() -> u32> Paced<SPI, CLOCK> {
    /// Whether the pause after the last use of the bus is over.
    fn is_due(&mut self) -> bool {
        let pause = if self.asked { SAMPLING_US } else { BETWEEN_US };
        match self.used {
            // One tick more, as the first may have been nearly over.
            Some(used) => (self.clock)().wrapping_sub(used) > pause,
            None => true,
        }
    }

    /// Asks for a channel, or fetches the answer of the one that was asked for.
    fn step(&mut self, channel: Channel) -> Result<Option<u16>, DriverError> {
        if !self.is_due() {
            return Ok(None);
        }
        let mut answer = [0; 2];
        let outcome = match self.asked {
            true => self.spi.transfer_in_place(&mut answer),
            false => self.spi.write(&channel.command()),
        };
        self.used = Some((self.clock)());
        self.asked = !self.asked && outcome.is_ok();
        outcome.map_err(DriverError::bus)?;
        if self.asked {
            return Ok(None);
        }
        decode(answer).map(Some).ok_or(if is_silent(&answer) {
            DriverError::Missing
        } else {
            DriverError::Parity { slot: self.next }
        })
    }

    /// Goes on until something is there.
    fn wait<T>(
        &mut self,
        mut work: impl FnMut(&mut Self) -> Result<Option<T>, DriverError>,
    ) -> Result<T, DriverError> {
        for _ in 0..LOOKS {
            if let Some(done) = work(self)? {
                return Ok(done);
            }
        }
        Err(DriverError::Timeout)
    }
}

impl<SPI: SpiDevice, CLOCK: FnMut() -> u32> Sampler for Paced<SPI, CLOCK> {
    type Reading = Frame;

    /// Begins a new frame and looks whether anybody answers: the one work that waits.
    fn start(&mut self) -> Result<(), DriverError> {
        (self.next, self.asked) = (0, false);
        self.wait(|sensor| sensor.step(Channel::Tdc)).map(|_| ())
    }

    /// Uses the bus if it is time to. The last slot completes a frame, an error begins a new one.
    fn poll(&mut self) -> Result<Option<Frame>, DriverError> {
        let slot = usize::from(self.next);
        let value = match self.step(Channel::of_slot(slot)) {
            Ok(Some(value)) => value,
            Ok(None) => return Ok(None),
            Err(error) => {
                self.next = 0;
                return Err(error);
            }
        };
        self.frame.set_slot(slot, value);
        self.next = if slot + 1 < SLOTS { self.next + 1 } else { 0 };
        Ok((self.next == 0).then_some(self.frame))
    }

    /// What is left of the frame, or a whole one.
    fn sample(&mut self) -> Result<Frame, DriverError> {
        self.wait(Self::poll)
    }
}
