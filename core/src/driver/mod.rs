//! Drivers of fingertip sensors: words over SPI in, one reading out.
//!
//! Generic over the traits of `embedded-hal` 1.0, so the same driver runs on a board's SPI
//! peripheral, against a mock in a test, and against an [`emulated`] chip in an emulator. A driver
//! waits for a bounded time only, checks what its sensor lets it check (parity, CRC, identity) and
//! tells in a [`DriverError`] what was wrong; no pattern of words makes it panic.
//!
//! * [`biotac`]: electrodes, pressure and temperature of a BioTac fingertip.
//! * [`ads131m08`]: eight simultaneous 24-bit channels, the front end of a strain-gauge transducer.
//! * [`background`]: buses that carry a frame by themselves, with DMA, meanwhile.

pub mod ads131m08;
pub mod background;
pub mod biotac;
pub mod emulated;

/// The traits a board implements for its buses and pins.
pub use embedded_hal;

use embedded_hal::{digital, spi};

/// A sensor behind its driver.
pub trait Sampler {
    /// What one sample says.
    type Reading;

    /// Sets the sensor up, or up again after an error; everything it says before is forgotten.
    ///
    /// # Errors
    /// When the sensor does not answer, is another one, or does not keep what it is told.
    fn start(&mut self) -> Result<(), DriverError>;

    /// Does the next piece of work, without waiting for the sensor: `None` when the next reading is
    /// not complete yet. For a main loop that serves several sensors in turn.
    ///
    /// # Errors
    /// When the sensor's words cannot be trusted; the reading they belong to is dropped.
    fn poll(&mut self) -> Result<Option<Self::Reading>, DriverError>;

    /// Whether the next reading was sampled already and is on its way: it belongs to the poll that
    /// began to read it.
    fn is_under_way(&self) -> bool {
        false
    }

    /// The next reading, waited for at most two periods of the sensor.
    ///
    /// # Errors
    /// As [`Sampler::poll`], and [`DriverError::Timeout`].
    fn sample(&mut self) -> Result<Self::Reading, DriverError>;
}

/// Why there is no reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DriverError {
    /// The SPI peripheral failed.
    Bus(spi::ErrorKind),
    /// The data-ready pin cannot be read.
    Pin(digital::ErrorKind),
    /// Nobody drives the line: all ones or all zeros.
    Missing,
    /// A byte has an even number of ones.
    Parity {
        /// Slot of the sensor's frame, from 0.
        slot: u8,
    },
    /// The sensor's checksum is not that of its words.
    Crc {
        /// Of the words.
        computed: u16,
        /// What the sensor sent.
        received: u16,
    },
    /// The sensor did not obey a command because its checksum arrived damaged.
    Command,
    /// No new data within two periods: the data-ready signal is stuck, or the clock has stopped.
    Timeout,
    /// Another device, or one in a state that a reset does not mend.
    Device {
        /// What it answered where its identity was expected.
        answer: u16,
    },
    /// A register did not keep what was written.
    Register {
        /// Address of the register.
        address: u8,
        /// What was written.
        written: u16,
        /// What was read back.
        read: u16,
    },
    /// The sensor was never set up, or has reset itself since: its settings are gone.
    Restarted,
}

impl DriverError {
    fn bus(error: impl spi::Error) -> Self {
        DriverError::Bus(error.kind())
    }

    fn pin(error: impl digital::Error) -> Self {
        DriverError::Pin(error.kind())
    }
}

impl core::fmt::Display for DriverError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            DriverError::Bus(kind) => write!(f, "the SPI bus failed: {kind}"),
            DriverError::Pin(kind) => write!(f, "the data-ready pin cannot be read: {kind}"),
            DriverError::Missing => f.write_str("no sensor: all bits are the same"),
            DriverError::Parity { slot } => write!(f, "a byte of slot {slot} has even parity"),
            DriverError::Crc { computed, received } => {
                write!(f, "the words' checksum is {computed:04x}, the sensor sent {received:04x}")
            }
            DriverError::Command => f.write_str("the sensor did not take a command"),
            DriverError::Timeout => f.write_str("no new data within two periods of the sensor"),
            DriverError::Device { answer } => {
                write!(f, "another device than expected, it answered {answer:04x}")
            }
            DriverError::Register { address, written, read } => {
                write!(f, "register {address:02x} was set to {written:04x} and reads {read:04x}")
            }
            DriverError::Restarted => f.write_str("the sensor is not set up, or has restarted"),
        }
    }
}

impl core::error::Error for DriverError {}

/// Whether no sensor drives the line.
fn is_silent(bytes: &[u8]) -> bool {
    bytes.iter().all(|&b| b == 0) || bytes.iter().all(|&b| b == 0xff)
}

#[cfg(test)]
mod tests;
