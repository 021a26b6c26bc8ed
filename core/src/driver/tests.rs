use std::collections::VecDeque;
use std::vec::Vec;

use embedded_hal::spi::{ErrorType, Operation, SpiDevice};

/// A bus that answers each transfer with the next bytes, whatever it is asked; zeros at the end.
pub(super) struct Echo(VecDeque<Vec<u8>>);

impl Echo {
    pub(super) fn new(answers: Vec<Vec<u8>>) -> Self {
        Echo(answers.into())
    }
}

impl ErrorType for Echo {
    type Error = core::convert::Infallible;
}

impl SpiDevice for Echo {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Self::Error> {
        for operation in operations {
            if let Operation::TransferInPlace(bytes) = operation {
                let answer = self.0.pop_front().unwrap_or_default();
                for (i, byte) in bytes.iter_mut().enumerate() {
                    *byte = answer.get(i).copied().unwrap_or(0);
                }
            }
        }
        Ok(())
    }
}

/// A bus whose peripheral fails.
pub(super) struct Broken;

impl ErrorType for Broken {
    type Error = embedded_hal::spi::ErrorKind;
}

impl SpiDevice for Broken {
    fn transaction(&mut self, _: &mut [Operation<'_, u8>]) -> Result<(), Self::Error> {
        Err(embedded_hal::spi::ErrorKind::ModeFault)
    }
}
