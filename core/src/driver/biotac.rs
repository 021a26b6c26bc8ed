//! The BioTac's SPI protocol (SynTouch; also spoken by the BioTac SP): mode 0, at most 4.4 MHz.
//!
//! A command byte is `1 cccccc p`: a six-bit channel and a bit that makes the number of ones odd;
//! a second byte 0x01 follows. The sensor samples that channel; 50 µs later two bytes are clocked
//! out that carry the upper seven and the lower five bits of a twelve-bit value, each with its own
//! odd parity in bit 0. Sampled in this order, 44 times at 4.4 kHz, the channels make one frame
//! every 10 ms:
//!
//! ```text
//! E1 PAC E2 PAC … E19 PAC PDC PAC TAC PAC TDC PAC
//! ```
//!
//! so that the fast pressure channel (PAC) comes every second slot.

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::SpiDevice;

use super::{DriverError, Sampler, is_silent};

pub use crate::sensing::ELECTRODES;

/// Channels sampled for one frame, repetitions of PAC included.
pub const SLOTS: usize = 2 * PRESSURES;
/// Times PAC is sampled in one frame.
pub const PRESSURES: usize = ELECTRODES + 3;
/// From the command to the sampled value.
const SAMPLING_US: u32 = 50;
/// From a value to the next command.
const BETWEEN_US: u32 = 10;

/// What can be sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Fluid pressure, high-passed: vibrations.
    Pac,
    /// Fluid pressure.
    Pdc,
    /// Temperature, high-passed: heat flow.
    Tac,
    /// Temperature.
    Tdc,
    /// Impedance of an electrode, from 0 (E1) to 18 (E19); larger numbers wrap.
    Electrode(u8),
}

impl Channel {
    /// The channel of a slot of the frame; slots beyond the last start over.
    pub const fn of_slot(slot: usize) -> Self {
        let slot = slot % SLOTS;
        match (slot % 2, slot / 2) {
            (1, _) => Channel::Pac,
            (_, ELECTRODES) => Channel::Pdc,
            (_, 20) => Channel::Tac,
            (_, 21) => Channel::Tdc,
            (_, electrode) => Channel::Electrode(electrode as u8),
        }
    }

    /// The sensor's number for it.
    pub const fn number(self) -> u8 {
        match self {
            Channel::Pac => 0,
            Channel::Pdc => 1,
            Channel::Tac => 2,
            Channel::Tdc => 3,
            Channel::Electrode(electrode) => 17 + electrode % ELECTRODES as u8,
        }
    }

    /// The two bytes that ask for a sample of it.
    pub const fn command(self) -> [u8; 2] {
        [odd(0x80 | self.number() << 1), odd(0)]
    }
}

/// The upper seven bits, with bit 0 such that the number of ones is odd.
const fn odd(byte: u8) -> u8 {
    let data = byte & 0xfe;
    data | (data.count_ones() as u8 & 1 ^ 1)
}

/// The two bytes that carry the lower twelve bits of a value.
pub const fn encode(value: u16) -> [u8; 2] {
    [odd((value >> 5 << 1) as u8), odd((value << 3) as u8 & 0xf8)]
}

/// The value that two bytes carry; `None` when either has an even number of ones.
pub const fn decode(bytes: [u8; 2]) -> Option<u16> {
    if bytes[0].count_ones() % 2 == 1 && bytes[1].count_ones() % 2 == 1 {
        Some((bytes[0] as u16 >> 1) << 5 | bytes[1] as u16 >> 3)
    } else {
        None
    }
}

/// One frame: every channel once, PAC 22 times; twelve bits each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Voltages over the electrodes' impedances, E1 first. They fall where the skin is pressed
    /// towards an electrode.
    pub electrodes: [u16; ELECTRODES],
    /// Vibrations, one value every two slots.
    pub pac: [u16; PRESSURES],
    /// Fluid pressure.
    pub pdc: u16,
    /// Heat flow.
    pub tac: u16,
    /// Temperature.
    pub tdc: u16,
}

impl Frame {
    /// All zeros.
    pub const ZERO: Self =
        Frame { electrodes: [0; ELECTRODES], pac: [0; PRESSURES], pdc: 0, tac: 0, tdc: 0 };

    /// The value of a slot; zero beyond the last.
    pub fn slot(&self, slot: usize) -> u16 {
        let of = |values: &[u16], at: usize| values.get(at).copied().unwrap_or(0);
        match Channel::of_slot(slot) {
            Channel::Pac => of(&self.pac, slot / 2),
            Channel::Pdc => self.pdc,
            Channel::Tac => self.tac,
            Channel::Tdc => self.tdc,
            Channel::Electrode(electrode) => of(&self.electrodes, electrode.into()),
        }
    }

    fn set_slot(&mut self, slot: usize, value: u16) {
        let place = match Channel::of_slot(slot) {
            Channel::Pac => self.pac.get_mut(slot / 2),
            Channel::Pdc => Some(&mut self.pdc),
            Channel::Tac => Some(&mut self.tac),
            Channel::Tdc => Some(&mut self.tdc),
            Channel::Electrode(electrode) => self.electrodes.get_mut(usize::from(electrode)),
        };
        if let Some(place) = place {
            *place = value;
        }
    }
}

/// A BioTac behind its chip-select line.
///
/// ```
/// use embedded_hal::delay::DelayNs;
/// use tactile_core::driver::Sampler;
/// use tactile_core::driver::biotac::{BioTac, Frame};
/// use tactile_core::driver::emulated::BioTacChip;
///
/// struct NoDelay;
/// impl DelayNs for NoDelay {
///     fn delay_ns(&mut self, _: u32) {}
/// }
///
/// let mut frame = Frame::ZERO;
/// frame.electrodes[3] = 2893;
/// let mut sensor = BioTac::new(BioTacChip::showing(frame), NoDelay);
/// assert_eq!(sensor.sample().unwrap().electrodes[3], 2893);
/// ```
#[derive(Clone, Debug)]
pub struct BioTac<SPI, DELAY> {
    spi: SPI,
    delay: DELAY,
    frame: Frame,
    /// Slot that is sampled next.
    next: u8,
}

impl<SPI, DELAY> BioTac<SPI, DELAY> {
    /// A sensor at the start of a frame; the bus in mode 0, most significant bit first.
    pub const fn new(spi: SPI, delay: DELAY) -> Self {
        BioTac { spi, delay, frame: Frame::ZERO, next: 0 }
    }

    /// The bus, to reach an emulated chip behind it.
    pub fn spi(&mut self) -> &mut SPI {
        &mut self.spi
    }
}

impl<SPI: SpiDevice, DELAY: DelayNs> BioTac<SPI, DELAY> {
    /// One sample of one channel: twelve bits. Takes 60 µs and the transfer of four bytes.
    ///
    /// # Errors
    /// [`DriverError::Bus`], [`DriverError::Missing`] or [`DriverError::Parity`].
    pub fn read(&mut self, channel: Channel) -> Result<u16, DriverError> {
        self.spi.write(&channel.command()).map_err(DriverError::bus)?;
        self.delay.delay_us(SAMPLING_US);
        let mut answer = [0; 2];
        self.spi.transfer_in_place(&mut answer).map_err(DriverError::bus)?;
        self.delay.delay_us(BETWEEN_US);
        decode(answer).ok_or(if is_silent(&answer) {
            DriverError::Missing
        } else {
            DriverError::Parity { slot: self.next }
        })
    }
}

impl<SPI: SpiDevice, DELAY: DelayNs> Sampler for BioTac<SPI, DELAY> {
    type Reading = Frame;

    /// Begins a new frame and looks whether anybody answers: the sensor has nothing to set.
    fn start(&mut self) -> Result<(), DriverError> {
        self.next = 0;
        self.read(Channel::Tdc).map(|_| ())
    }

    /// Samples the next slot; the last one completes a frame. An error begins a new frame.
    fn poll(&mut self) -> Result<Option<Frame>, DriverError> {
        let slot = usize::from(self.next);
        let outcome = self.read(Channel::of_slot(slot));
        self.next = if outcome.is_ok() && slot + 1 < SLOTS { self.next + 1 } else { 0 };
        self.frame.set_slot(slot, outcome?);
        Ok((self.next == 0).then_some(self.frame))
    }

    /// A whole frame from its first slot.
    fn sample(&mut self) -> Result<Frame, DriverError> {
        self.next = 0;
        for _ in 0..SLOTS {
            if let Some(frame) = self.poll()? {
                return Ok(frame);
            }
        }
        Err(DriverError::Timeout)
    }
}

mod paced;

pub use paced::Paced;

#[cfg(test)]
mod tests;
