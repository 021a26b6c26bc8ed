//! Chips that show what they are told, behind the same `SpiDevice` as real ones: for an emulator
//! without sensors, a virtual board, and tests. They know the protocol from the sensor's side,
//! command by command, and nothing of the drivers.

use core::convert::Infallible;

use embedded_hal::spi::{ErrorType, Operation, SpiDevice};
use serde::{Deserialize, Serialize};

use super::ads131m08::{
    self, CHANNELS, FRAME, READ, READY, RESET, STANDBY, STATUS_COMMAND_CRC, STATUS_RESET, WAKE_UP,
    WRITE, WRITTEN, checksum, place, register,
};
use super::biotac;

/// Gives `transfer` the bytes out and takes the bytes in of every operation in turn.
fn each(operations: &mut [Operation<'_, u8>], mut transfer: impl FnMut(u8) -> u8) {
    for operation in operations {
        match operation {
            Operation::Read(read) => read.iter_mut().for_each(|r| *r = transfer(0)),
            Operation::Write(write) => {
                for w in write.iter() {
                    transfer(*w);
                }
            }
            Operation::Transfer(read, write) => {
                for i in 0..read.len().max(write.len()) {
                    let answer = transfer(write.get(i).copied().unwrap_or(0));
                    if let Some(r) = read.get_mut(i) {
                        *r = answer;
                    }
                }
            }
            Operation::TransferInPlace(bytes) => {
                bytes.iter_mut().for_each(|b| *b = transfer(*b));
            }
            Operation::DelayNs(_) => {}
        }
    }
}

/// What is wrong with an emulated sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Fault {
    /// Nothing.
    #[default]
    None,
    /// One bit of every answer arrives wrong.
    Noise,
    /// It is not there: the line stays low.
    Missing,
    /// Data never becomes new; a BioTac, which has no such signal, is as without a fault.
    Stuck,
}

/// A BioTac that shows one frame over and over.
#[derive(Clone, Debug)]
pub struct BioTacChip {
    frame: biotac::Frame,
    fault: Fault,
    answer: [u8; 2],
    /// Slot of the frame in which PAC is asked for next.
    pressure: u8,
}

impl BioTacChip {
    /// Shows `frame`, of which the lower twelve bits of every value are seen.
    pub const fn showing(frame: biotac::Frame) -> Self {
        BioTacChip { frame, fault: Fault::None, answer: [0; 2], pressure: 0 }
    }

    /// Shows another frame, from its first vibration on.
    pub fn show(&mut self, frame: &biotac::Frame) {
        self.frame = *frame;
        self.pressure = 0;
    }

    /// Breaks or mends the sensor.
    pub fn set_fault(&mut self, fault: Fault) {
        self.fault = fault;
    }

    fn obey(&mut self, command: u8) {
        let channel = command >> 1 & 0x3f;
        let frame = &self.frame;
        let value = match channel {
            0 => {
                let at = usize::from(self.pressure);
                self.pressure = (self.pressure + 1) % biotac::PRESSURES as u8;
                frame.pac.get(at).copied()
            }
            1 => Some(frame.pdc),
            2 => Some(frame.tac),
            3 => Some(frame.tdc),
            other => frame.electrodes.get(usize::from(other).wrapping_sub(17)).copied(),
        };
        self.answer = biotac::encode(value.unwrap_or(0));
    }
}

impl ErrorType for BioTacChip {
    type Error = Infallible;
}

impl SpiDevice for BioTacChip {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        let (mut at, mut command) = (0, 0);
        let mut answer = self.answer;
        match self.fault {
            Fault::None | Fault::Stuck => {}
            Fault::Noise => answer[0] ^= 0x10,
            Fault::Missing => answer = [0; 2],
        }
        each(operations, |byte| {
            if at == 0 {
                command = byte;
            }
            at += 1;
            answer.get(at - 1).copied().unwrap_or(0)
        });
        // A damaged command is not obeyed; the answer to the one before stays.
        if command & 0x80 != 0 && command.count_ones() % 2 == 1 {
            self.obey(command);
        }
        Ok(())
    }
}

/// An ADS131M08 that shows the same counts in every frame.
#[derive(Clone, Debug)]
pub struct Ads131m08Chip {
    channels: [i32; CHANNELS],
    fault: Fault,
    /// Writable registers by their address.
    registers: [u16; REGISTERS],
    /// What the next frame begins with; `None` stands for the status.
    answer: Option<u16>,
    /// Whether the last command came damaged.
    refused: bool,
    asleep: bool,
}

const REGISTERS: usize = 6;
const IDENTITY: u16 = 0x2000 | (CHANNELS as u16) << 8;
const AFTER_RESET: [u16; REGISTERS] = [IDENTITY, 0, 0x0510, 0xff0e, 0, 0];

impl Ads131m08Chip {
    /// Fresh from power-up; the lower 24 bits of every count are seen.
    pub const fn showing(channels: [i32; CHANNELS]) -> Self {
        Ads131m08Chip {
            channels,
            fault: Fault::None,
            registers: AFTER_RESET,
            answer: Some(READY),
            refused: false,
            asleep: false,
        }
    }

    /// Shows other counts.
    pub fn show(&mut self, channels: [i32; CHANNELS]) {
        self.channels = channels;
    }

    /// Breaks or mends the sensor.
    pub fn set_fault(&mut self, fault: Fault) {
        self.fault = fault;
    }

    /// Cuts the power for a moment: registers forget, and the chip says so.
    pub fn restart(&mut self) {
        let (channels, fault) = (self.channels, self.fault);
        *self = Ads131m08Chip { fault, answer: None, ..Self::showing(channels) };
    }

    fn register(&self, address: u8) -> u16 {
        self.registers.get(usize::from(address)).copied().unwrap_or(0)
    }

    fn status(&self) -> u16 {
        let on = self.register(register::CLOCK) >> 8;
        let new = if self.asleep || self.fault == Fault::Stuck { 0 } else { on };
        let mode = self.register(register::MODE);
        let refused = if self.refused { STATUS_COMMAND_CRC } else { 0 };
        refused | mode & (STATUS_RESET | 0b11 << 8) | new
    }

    /// The frame that the chip sends next.
    fn frame(&self) -> [u8; FRAME] {
        let mut bytes = [0; FRAME];
        bytes[..2].copy_from_slice(&self.answer.unwrap_or(self.status()).to_be_bytes());
        let on = self.register(register::CLOCK) >> 8;
        for (i, (count, word)) in
            self.channels.iter().zip(bytes[3..].chunks_exact_mut(3)).enumerate()
        {
            if on >> i & 1 == 1 {
                word.copy_from_slice(&(count << 8).to_be_bytes()[..3]);
            }
        }
        let crc = checksum(&bytes[..FRAME - 3]);
        bytes[FRAME - 3..FRAME - 1].copy_from_slice(&crc.to_be_bytes());
        match self.fault {
            Fault::None | Fault::Stuck => {}
            Fault::Noise => bytes[7] ^= 0x10,
            Fault::Missing => bytes = [0; FRAME],
        }
        bytes
    }

    fn obey(&mut self, words: &[u8; FRAME]) {
        let word = |i: usize| u16::from_be_bytes([words[3 * i], words[3 * i + 1]]);
        let command = word(0);
        let writes = command & 0xe000 == WRITE;
        let after = if writes { 2 } else { 1 };
        let checked = self.register(register::MODE) & 1 << 12 != 0;
        self.refused = checked && checksum(&words[..3 * after]) != word(after);
        self.answer = None;
        if self.refused {
            return;
        }
        let address = (command >> 7 & 0x3f) as u8;
        match command {
            RESET => {
                let (channels, fault) = (self.channels, self.fault);
                *self = Ads131m08Chip { fault, ..Self::showing(channels) };
            }
            STANDBY | WAKE_UP => {
                self.asleep = command == STANDBY;
                self.answer = Some(command);
            }
            _ if writes => {
                if address > register::STATUS
                    && let Some(r) = self.registers.get_mut(usize::from(address))
                {
                    *r = word(1);
                }
                self.answer = Some(WRITTEN | place(address));
            }
            _ if command & 0xe000 == READ => {
                self.answer = Some(match address {
                    register::STATUS => self.status(),
                    other => self.register(other),
                });
            }
            _ => {}
        }
    }
}

impl ErrorType for Ads131m08Chip {
    type Error = Infallible;
}

impl SpiDevice for Ads131m08Chip {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        let out = self.frame();
        let mut taken = [0; FRAME];
        let mut at = 0;
        each(operations, |byte| {
            if let Some(t) = taken.get_mut(at) {
                *t = byte;
            }
            at += 1;
            out.get(at - 1).copied().unwrap_or(0)
        });
        // Of an unfinished frame nothing is obeyed.
        if at >= ads131m08::FRAME && self.fault != Fault::Missing {
            self.obey(&taken);
        }
        Ok(())
    }
}
