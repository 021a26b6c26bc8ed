//! A board that tracks in space with hypotheses over pose and faces, and reads the strain gauges of
//! five fingertips: an ADS131M08 each, on `SPI1`.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod gauges {
    use tactile_core::device::Sensing;
    use tactile_core::driver::ads131m08::{Ads131m08, Settings};
    use tactile_firmware::board::{Chip, Delay, Selected};

    /// The board with an ADS131M08 behind each chip-select line.
    pub fn on(board: Selected) -> Sensing<Selected, Ads131m08<Chip, Delay>, 5> {
        let chip = |line| Ads131m08::polled(Chip::new(line), Delay, Settings::GAUGES);
        Sensing::new(board, [0, 1, 2, 3, 4].map(chip))
    }
}

tactile_firmware::image!(SpatialSensingDevice, crate::gauges::on);
