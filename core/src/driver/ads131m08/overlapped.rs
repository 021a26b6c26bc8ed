//! The same chip on a bus that carries frames by itself.

use embedded_hal::delay::DelayNs;
use embedded_hal::digital::InputPin;

use super::{Ads131m08, CHANNELS, FRAME, Frame, LOOK_US, NOTHING, NoPin};
use crate::driver::background::BackgroundDevice;
use crate::driver::{DriverError, Sampler};

/// An [`Ads131m08`] whose frames are carried while the processor does something else: one poll
/// begins the exchange, a later one fetches it. Setting the chip up is done as ever.
///
/// With a data-ready pin the bus carries one frame a sample. Without one it carries frames all the
/// time, to look whether the chip has anything new, and the processor checks each.
#[derive(Clone, Debug)]
pub struct Overlapped<SPI, DELAY, PIN = NoPin> {
    chip: Ads131m08<SPI, DELAY, PIN>,
    under_way: bool,
}

impl<SPI, DELAY, PIN> Overlapped<SPI, DELAY, PIN> {
    /// The chip, which is started by [`Sampler::start`] as ever.
    pub const fn new(chip: Ads131m08<SPI, DELAY, PIN>) -> Self {
        Overlapped { chip, under_way: false }
    }

    /// The bus, to reach an emulated chip behind it.
    pub fn spi(&mut self) -> &mut SPI {
        self.chip.spi()
    }
}

impl<SPI: BackgroundDevice, DELAY: DelayNs, PIN: InputPin> Sampler for Overlapped<SPI, DELAY, PIN> {
    type Reading = [i32; CHANNELS];

    fn start(&mut self) -> Result<(), DriverError> {
        self.under_way = false;
        self.chip.start()
    }

    /// Begins or fetches; never waits for the bus.
    #[inline]
    fn poll(&mut self) -> Result<Option<[i32; CHANNELS]>, DriverError> {
        if !self.under_way {
            if self.chip.is_ready()? {
                self.under_way = self.chip.spi.begin(&NOTHING).map_err(DriverError::bus)?;
            }
            return Ok(None);
        }
        let mut bytes = [0; FRAME];
        let fetched = self.chip.spi.fetch(&mut bytes);
        self.under_way = matches!(fetched, Ok(false));
        if !fetched.map_err(DriverError::bus)? {
            return Ok(None);
        }
        let frame = Frame::parse(&bytes)?;
        self.chip.reading(&frame)
    }

    fn is_under_way(&self) -> bool {
        self.under_way
    }

    fn sample(&mut self) -> Result<[i32; CHANNELS], DriverError> {
        let looks = 2 * self.chip.settings.oversampling.period_us() / LOOK_US + 2;
        for _ in 0..looks {
            if let Some(channels) = self.poll()? {
                return Ok(channels);
            }
            self.chip.delay.delay_us(LOOK_US);
        }
        Err(DriverError::Timeout)
    }
}

#[cfg(test)]
mod tests;
