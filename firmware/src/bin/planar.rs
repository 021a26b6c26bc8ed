//! A planar tracker on a board: frames in, frames out, for ever.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(not(target_os = "none"))]
fn main() {}

#[cfg(target_os = "none")]
mod firmware {
    use tactile_core::device::PlanarDevice;
    use tactile_firmware::board::Selected;

    #[cortex_m_rt::entry]
    fn main() -> ! {
        static mut DEVICE: PlanarDevice = PlanarDevice::PLANAR;
        let mut board = Selected::start();
        loop {
            DEVICE.run(&mut board);
        }
    }
}
