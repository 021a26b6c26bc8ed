//! Harness of the cross-crate tests: finds data, builds firmware and runs it in QEMU.
