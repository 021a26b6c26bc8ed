//! Frames that a bus carries while the processor does something else.

use embedded_hal::spi::SpiDevice;

/// A device on a bus that can exchange a whole frame by itself, as one with DMA does.
///
/// One frame of one device is under way at a time. A device that wants the bus for an ordinary
/// transaction waits, for a bounded time, until it is through; the frame stays there to be fetched, unless
/// it is that device's own, which is given up.
pub trait BackgroundDevice: SpiDevice {
    /// Begins to exchange `frame`; false, and nothing is begun, while the bus carries another
    /// device's frame or that was not fetched yet. An earlier frame of this device is given up.
    ///
    /// # Errors
    /// When the bus fails, or the frame is empty or too long for it.
    fn begin(&mut self, frame: &[u8]) -> Result<bool, Self::Error>;

    /// Fetches what came back, as many bytes as `frame` has; false while it is under way. A frame is
    /// fetched once.
    ///
    /// # Errors
    /// When the exchange failed, was cut short, or none was begun.
    fn fetch(&mut self, frame: &mut [u8]) -> Result<bool, Self::Error>;
}
