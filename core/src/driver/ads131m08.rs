//! The ADS131M08 (Texas Instruments, data sheet SBAS950): eight delta-sigma converters of 24 bits
//! that sample together, here as the front end of a six-axis strain-gauge transducer. SPI mode 1.
//!
//! Every transfer is a frame of ten 24-bit words, most significant byte first, both ways at once:
//!
//! ```text
//! to the chip     command  [register]  CRC  0 …
//! from the chip   answer to the previous command, channels 0 … 7, CRC
//! ```
//!
//! Commands, registers and checksums are 16 bits, at the upper end of their word. The answer to no
//! command (`NULL`) is the status register, whose lower eight bits say which channels are new. The
//! checksum is CRC-16/CCITT (polynomial 0x1021, start 0xffff) of all words before it.

use embedded_hal::delay::DelayNs;
use embedded_hal::digital::InputPin;
use embedded_hal::spi::SpiDevice;

use super::{DriverError, Sampler, is_silent};

mod overlapped;

pub use overlapped::Overlapped;

/// Channels of the chip.
pub const CHANNELS: usize = 8;
/// Bytes of a frame: ten words of 24 bits.
pub const FRAME: usize = 3 * (CHANNELS + 2);
/// Where the chip's checksum begins.
const CHECKED: usize = FRAME - 3;

pub(super) const RESET: u16 = 0x0011;
pub(super) const STANDBY: u16 = 0x0022;
pub(super) const WAKE_UP: u16 = 0x0033;
/// Answer to a reset; 0x0011 when there was none.
pub(super) const READY: u16 = 0xff20 | CHANNELS as u16;
const NULL: u16 = 0x0000;
pub(super) const READ: u16 = 0xa000;
pub(super) const WRITE: u16 = 0x6000;
/// Answer to a write of one register, its address from bit 7.
pub(super) const WRITTEN: u16 = 0x4000;

/// The 16-bit registers that are used here.
pub mod register {
    /// Identity: number of channels in bits 8 to 11.
    pub const ID: u8 = 0x00;
    /// What the chip says of itself; see the `STATUS_` constants.
    pub const STATUS: u8 = 0x01;
    /// Checksums, word length, data-ready signal.
    pub const MODE: u8 = 0x02;
    /// Channels, oversampling, power.
    pub const CLOCK: u8 = 0x03;
    /// Gains of channels 0 to 3, three bits in every four.
    pub const GAIN1: u8 = 0x04;
    /// Gains of channels 4 to 7.
    pub const GAIN2: u8 = 0x05;
}

/// A command arrived with a wrong checksum and was ignored.
pub const STATUS_COMMAND_CRC: u16 = 1 << 12;
/// The chip has reset since the flag was cleared.
pub const STATUS_RESET: u16 = 1 << 10;
/// Length of words; 24 bits is 1.
const STATUS_WORD: u16 = 0b11 << 8;
const WORD_24: u16 = 0b01 << 8;

/// Commands are checked, words have 24 bits, an unfinished frame times out, the data-ready signal is
/// a level and follows the slowest channel; clears the reset flag.
const MODE: u16 = 1 << 12 | WORD_24 | 1 << 4;
/// Full precision: the modulators run at half of 8.192 MHz.
const HIGH_RESOLUTION: u16 = 0b10;
/// Between two looks at the data-ready signal.
const LOOK_US: u32 = 20;
/// Longest time registers need after a reset (5 µs), with a margin.
const RESET_US: u32 = 20;
/// Times a reset is tried: the first may end a frame that was left unfinished.
const RESETS: u32 = 3;

const CRC: crc::Crc<u16> = crc::Crc::<u16>::new(&crc::CRC_16_IBM_3740);

/// The checksum of words, as bytes.
pub(super) const fn checksum(bytes: &[u8]) -> u16 {
    CRC.checksum(bytes)
}

/// The frame of no command.
const NOTHING: [u8; FRAME] = framed(NULL, None);

/// A command as a frame, and a register's value where it needs one.
const fn framed(command: u16, value: Option<u16>) -> [u8; FRAME] {
    let mut bytes = [0; FRAME];
    [bytes[0], bytes[1]] = command.to_be_bytes();
    let crc = match value {
        Some(value) => {
            [bytes[3], bytes[4]] = value.to_be_bytes();
            checksum(&[bytes[0], bytes[1], 0, bytes[3], bytes[4], 0])
        }
        None => checksum(&[bytes[0], bytes[1], 0]),
    };
    let end = if value.is_some() { 6 } else { 3 };
    [bytes[end], bytes[end + 1]] = crc.to_be_bytes();
    bytes
}

/// Gain of a channel's amplifier: the full scale is ±1.2 V over it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Gain {
    X1,
    X2,
    X4,
    X8,
    X16,
    X32,
    X64,
    X128,
}

impl Gain {
    /// Volts of one count.
    pub const fn volts_per_count(self) -> f32 {
        1.2 / ((1 << 23) as f32 * (1 << self as u32) as f32)
    }
}

/// Modulator samples averaged into one: the rate is 4.096 MHz over it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Oversampling {
    By128,
    By256,
    By512,
    By1024,
    By2048,
    By4096,
    By8192,
    By16256,
}

impl Oversampling {
    /// Microseconds from sample to sample, rounded up.
    pub const fn period_us(self) -> u32 {
        let samples = match self {
            Oversampling::By16256 => 16_256,
            other => 128 << other as u32,
        };
        (samples as u32 * 1000).div_ceil(4096)
    }
}

/// What the chip is set to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Bit i: channel i is on.
    pub channels: u8,
    /// Gain of every channel.
    pub gains: [Gain; CHANNELS],
    /// Rate of all channels.
    pub oversampling: Oversampling,
}

impl Settings {
    /// Six bridges of strain gauges on channels 0 to 5, ±37.5 mV each, thousand samples a second.
    pub const GAUGES: Self = Settings {
        channels: 0b0011_1111,
        gains: [Gain::X32; CHANNELS],
        oversampling: Oversampling::By4096,
    };

    const fn clock(&self) -> u16 {
        (self.channels as u16) << 8 | (self.oversampling as u16) << 2 | HIGH_RESOLUTION
    }

    /// Gains of four channels from `first`.
    const fn gain(&self, first: usize) -> u16 {
        let g = &self.gains;
        g[first] as u16
            | (g[first + 1] as u16) << 4
            | (g[first + 2] as u16) << 8
            | (g[first + 3] as u16) << 12
    }
}

/// What one frame says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Answer to the previous command; the status register when there was none.
    pub answer: u16,
    /// Counts of the channels, in [−2²³, 2²³); zero of a channel that is off.
    pub channels: [i32; CHANNELS],
}

impl Frame {
    /// Checks and unpacks what came from the chip.
    ///
    /// # Errors
    /// [`DriverError::Missing`] or [`DriverError::Crc`].
    pub fn parse(bytes: &[u8; FRAME]) -> Result<Self, DriverError> {
        if is_silent(bytes) {
            return Err(DriverError::Missing);
        }
        let word = |at: usize| [bytes[at], bytes[at + 1], bytes[at + 2]];
        let upper = |at: usize| u16::from_be_bytes([bytes[at], bytes[at + 1]]);
        let (computed, received) = (checksum(&bytes[..CHECKED]), upper(CHECKED));
        if computed != received {
            return Err(DriverError::Crc { computed, received });
        }
        Ok(Frame { answer: upper(0), channels: core::array::from_fn(|i| signed(word(3 + 3 * i))) })
    }
}

/// Two's complement of 24 bits.
fn signed([high, middle, low]: [u8; 3]) -> i32 {
    i32::from_be_bytes([high, middle, low, 0]) >> 8
}

/// Stands for a data-ready pin where none is connected; cannot be made.
#[derive(Clone, Copy, Debug)]
pub enum NoPin {}

impl embedded_hal::digital::ErrorType for NoPin {
    type Error = core::convert::Infallible;
}

impl InputPin for NoPin {
    fn is_high(&mut self) -> Result<bool, Self::Error> {
        match *self {}
    }

    fn is_low(&mut self) -> Result<bool, Self::Error> {
        match *self {}
    }
}

/// An ADS131M08 behind its chip-select line.
///
/// ```
/// use embedded_hal::delay::DelayNs;
/// use tactile_core::driver::Sampler;
/// use tactile_core::driver::ads131m08::{Ads131m08, Settings};
/// use tactile_core::driver::emulated::Ads131m08Chip;
///
/// struct NoDelay;
/// impl DelayNs for NoDelay {
///     fn delay_ns(&mut self, _: u32) {}
/// }
///
/// let chip = Ads131m08Chip::showing([1000, -1000, 0, 0, 0, 0, 0, 0]);
/// let mut gauges = Ads131m08::polled(chip, NoDelay, Settings::GAUGES);
/// gauges.start().unwrap();
/// assert_eq!(gauges.sample().unwrap()[..2], [1000, -1000]);
/// ```
#[derive(Clone, Debug)]
pub struct Ads131m08<SPI, DELAY, PIN = NoPin> {
    spi: SPI,
    delay: DELAY,
    /// Low when new data waits.
    ready: Option<PIN>,
    settings: Settings,
    started: bool,
}

impl<SPI, DELAY> Ads131m08<SPI, DELAY> {
    /// A chip without a data-ready pin: its status is looked at instead. The bus in mode 1.
    pub const fn polled(spi: SPI, delay: DELAY, settings: Settings) -> Self {
        Ads131m08 { spi, delay, ready: None, settings, started: false }
    }
}

impl<SPI, DELAY, PIN> Ads131m08<SPI, DELAY, PIN> {
    /// A chip whose data-ready pin is connected. The bus in mode 1, most significant bit first.
    pub const fn new(spi: SPI, delay: DELAY, ready: PIN, settings: Settings) -> Self {
        Ads131m08 { spi, delay, ready: Some(ready), settings, started: false }
    }

    /// The bus, to reach an emulated chip behind it.
    pub fn spi(&mut self) -> &mut SPI {
        &mut self.spi
    }
}

impl<SPI: SpiDevice, DELAY: DelayNs, PIN: InputPin> Ads131m08<SPI, DELAY, PIN> {
    /// Sends a command, and a register's value where it needs one; gives the answer to the command
    /// before.
    fn exchange(&mut self, command: u16, value: Option<u16>) -> Result<Frame, DriverError> {
        self.transfer(framed(command, value))
    }

    fn transfer(&mut self, mut bytes: [u8; FRAME]) -> Result<Frame, DriverError> {
        self.spi.transfer_in_place(&mut bytes).map_err(DriverError::bus)?;
        Frame::parse(&bytes)
    }

    /// The value of a register.
    ///
    /// # Errors
    /// When the bus or the checksum is bad, or nobody answers.
    pub fn read_register(&mut self, address: u8) -> Result<u16, DriverError> {
        self.exchange(READ | place(address), None)?;
        Ok(self.exchange(NULL, None)?.answer)
    }

    /// Writes a register and reads it back.
    ///
    /// # Errors
    /// As [`Self::read_register`]; [`DriverError::Command`] when the chip did not take the command,
    /// [`DriverError::Register`] when the value did not stay.
    pub fn write_register(&mut self, address: u8, value: u16) -> Result<(), DriverError> {
        self.exchange(WRITE | place(address), Some(value))?;
        if self.exchange(READ | place(address), None)?.answer != WRITTEN | place(address) {
            return Err(DriverError::Command);
        }
        let read = self.exchange(NULL, None)?.answer;
        if read == value {
            Ok(())
        } else {
            Err(DriverError::Register { address, written: value, read })
        }
    }

    /// Stops the converters until [`Self::wake_up`]; registers are kept.
    ///
    /// # Errors
    /// As [`Self::read_register`]; [`DriverError::Command`] when the chip did not take the command.
    pub fn stand_by(&mut self) -> Result<(), DriverError> {
        self.order(STANDBY)
    }

    /// Ends [`Self::stand_by`].
    ///
    /// # Errors
    /// As [`Self::stand_by`].
    pub fn wake_up(&mut self) -> Result<(), DriverError> {
        self.order(WAKE_UP)?;
        self.catch_up()
    }

    /// A command that the chip repeats as its answer.
    fn order(&mut self, command: u16) -> Result<(), DriverError> {
        self.exchange(command, None)?;
        let answer = self.exchange(NULL, None)?.answer;
        if answer == command { Ok(()) } else { Err(DriverError::Command) }
    }

    fn reset(&mut self) -> Result<(), DriverError> {
        let mut outcome = Err(DriverError::Missing);
        for _ in 0..RESETS {
            // What comes with the reset belongs to an earlier life and may be damaged.
            let sent = self.exchange(RESET, None);
            if let Err(bus @ DriverError::Bus(_)) = sent {
                return Err(bus);
            }
            self.delay.delay_us(RESET_US);
            match self.exchange(NULL, None) {
                Ok(Frame { answer: READY, .. }) => return Ok(()),
                Ok(Frame { answer, .. }) => outcome = Err(DriverError::Device { answer }),
                Err(error) => outcome = Err(error),
            }
        }
        outcome
    }

    /// Empties the two frames that the chip holds back after a pause, so that the next one is new.
    fn catch_up(&mut self) -> Result<(), DriverError> {
        for _ in 0..2 {
            self.exchange(NULL, None)?;
        }
        Ok(())
    }

    /// Whether a frame is worth reading: the chip was set up, and no pin says that nothing is new.
    #[inline]
    fn is_ready(&mut self) -> Result<bool, DriverError> {
        if !self.started {
            return Err(DriverError::Restarted);
        }
        match &mut self.ready {
            Some(pin) => pin.is_low().map_err(DriverError::pin),
            None => Ok(true),
        }
    }

    /// The channels of a frame; `None` when they are not new.
    #[inline]
    fn reading(&mut self, frame: &Frame) -> Result<Option<[i32; CHANNELS]>, DriverError> {
        match self.is_new(frame.answer) {
            Ok(new) => Ok(new.then_some(frame.channels)),
            Err(error) => {
                self.started = error != DriverError::Restarted;
                Err(error)
            }
        }
    }

    /// The status, checked: whether every channel that is on has new data.
    fn is_new(&self, status: u16) -> Result<bool, DriverError> {
        if status & STATUS_COMMAND_CRC != 0 {
            return Err(DriverError::Command);
        }
        if status & STATUS_RESET != 0 || status & STATUS_WORD != WORD_24 {
            return Err(DriverError::Restarted);
        }
        let on = u16::from(self.settings.channels);
        Ok(on != 0 && status & on == on)
    }
}

/// A register's address in a command.
pub(super) const fn place(address: u8) -> u16 {
    (address as u16 & 0x3f) << 7
}

impl<SPI: SpiDevice, DELAY: DelayNs, PIN: InputPin> Sampler for Ads131m08<SPI, DELAY, PIN> {
    type Reading = [i32; CHANNELS];

    /// Resets the chip, asks who it is, and writes its settings.
    fn start(&mut self) -> Result<(), DriverError> {
        self.started = false;
        self.reset()?;
        let identity = self.read_register(register::ID)?;
        if usize::from(identity >> 8 & 0xf) != CHANNELS {
            return Err(DriverError::Device { answer: identity });
        }
        let settings = self.settings;
        for (address, value) in [
            (register::MODE, MODE),
            (register::CLOCK, settings.clock()),
            (register::GAIN1, settings.gain(0)),
            (register::GAIN2, settings.gain(4)),
        ] {
            self.write_register(address, value)?;
        }
        self.started = true;
        self.catch_up()
    }

    /// Reads one frame, and that only when the pin says so; `None` when its channels are not new.
    fn poll(&mut self) -> Result<Option<[i32; CHANNELS]>, DriverError> {
        if !self.is_ready()? {
            return Ok(None);
        }
        let frame = self.transfer(NOTHING)?;
        self.reading(&frame)
    }

    fn sample(&mut self) -> Result<[i32; CHANNELS], DriverError> {
        let looks = 2 * self.settings.oversampling.period_us() / LOOK_US + 2;
        for _ in 0..looks {
            if let Some(channels) = self.poll()? {
                return Ok(channels);
            }
            self.delay.delay_us(LOOK_US);
        }
        Err(DriverError::Timeout)
    }
}

#[cfg(test)]
mod tests;
