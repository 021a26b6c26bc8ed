//! A board that tracks in space with hypotheses over pose and faces, and reads the strain gauges of
//! five fingertips: an ADS131M08 each, on `SPI1` with DMA.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod gauges {
    use tactile_core::device::Sensing;
    use tactile_core::driver::ads131m08::{Ads131m08, Overlapped, Settings};
    use tactile_firmware::board::{self, Chip, Delay, Ready, Selected};

    type Gauges = Overlapped<Chip, Delay, Ready>;

    /// The board with an ADS131M08 behind each chip-select line.
    pub fn on(board: Selected) -> Sensing<Selected, Gauges, 5> {
        let gauges = |line| {
            let (chip, ready) = (board::chip(line), board::ready(line));
            Overlapped::new(Ads131m08::new(chip, Delay, ready, Settings::GAUGES))
        };
        Sensing::new(board, [0, 1, 2, 3, 4].map(gauges))
    }
}

tactile_firmware::image!(SpatialSensingDevice, crate::gauges::on);
