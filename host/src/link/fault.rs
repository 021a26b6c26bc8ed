//! A link that misbehaves on purpose, the same way for the same seed.

use std::io;
use std::time::{Duration, Instant};

use tactile_core::random::Random;

use super::Link;

/// How often a frame suffers, each from 0 to 1, in both directions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Faults {
    /// Vanishes.
    pub drop: f32,
    /// Has one byte changed, its delimiter included.
    pub corrupt: f32,
    /// Comes twice.
    pub double: f32,
    /// Comes after the frame that follows it.
    pub reorder: f32,
}

/// A link wrapped in [`Faults`].
pub struct Faulty<L> {
    link: L,
    faults: Faults,
    random: Random,
    outgoing: Direction,
    incoming: Direction,
    /// Bytes on their way to the caller.
    ready: Vec<u8>,
    injected: u32,
}

/// One direction: the frame that is being collected and one that is held back.
#[derive(Default)]
struct Direction {
    frame: Vec<u8>,
    held: Option<Vec<u8>>,
}

impl Direction {
    /// Cuts bytes into frames and passes on what the faults leave of them.
    fn pass(
        &mut self,
        bytes: &[u8],
        faults: &Faults,
        random: &mut Random,
        injected: &mut u32,
    ) -> Vec<u8> {
        let mut out = Vec::new();
        for &byte in bytes {
            self.frame.push(byte);
            if byte != 0 {
                continue;
            }
            let mut frame = std::mem::take(&mut self.frame);
            let mut happens = |chance: f32| {
                let hit = random.uniform() < chance;
                *injected += u32::from(hit);
                hit
            };
            if happens(faults.drop) {
                continue;
            }
            let corrupt = happens(faults.corrupt);
            let double = happens(faults.double);
            let reorder = happens(faults.reorder);
            if corrupt {
                let at = (random.uniform() * frame.len() as f32) as usize;
                if let Some(byte) = frame.get_mut(at) {
                    *byte ^= 1 << ((random.uniform() * 8.0) as u32 & 7);
                }
            }
            if double {
                frame.extend_from_within(..);
            }
            if reorder && self.held.is_none() {
                self.held = Some(frame);
                continue;
            }
            out.extend(frame);
            out.extend(self.held.take().unwrap_or_default());
        }
        out
    }
}

impl<L: Link> Faulty<L> {
    /// Wraps `link`.
    pub fn new(link: L, faults: Faults, seed: u64) -> Self {
        Faulty {
            link,
            faults,
            random: Random::new(seed),
            outgoing: Direction::default(),
            incoming: Direction::default(),
            ready: Vec::new(),
            injected: 0,
        }
    }

    /// How many faults there have been.
    pub fn injected(&self) -> u32 {
        self.injected
    }
}

impl<L: Link> Link for Faulty<L> {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let out = self.outgoing.pass(bytes, &self.faults, &mut self.random, &mut self.injected);
        if out.is_empty() { Ok(()) } else { self.link.send(&out) }
    }

    fn receive(&mut self, bytes: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let deadline = Instant::now() + timeout;
        while self.ready.is_empty() {
            let mut raw = [0; 512];
            let left = deadline.saturating_duration_since(Instant::now());
            let count = self.link.receive(&mut raw, left)?;
            if count == 0 {
                return Ok(0);
            }
            let raw = raw.get(..count).unwrap_or(&[]);
            self.ready =
                self.incoming.pass(raw, &self.faults, &mut self.random, &mut self.injected);
            // The other side may never fall silent, and every frame of it may be lost.
            if self.ready.is_empty() && left.is_zero() {
                return Ok(0);
            }
        }
        let count = bytes.len().min(self.ready.len());
        for (byte, ready) in bytes.iter_mut().zip(self.ready.drain(..count)) {
            *byte = ready;
        }
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Never falls silent.
    struct Chatter;

    impl Link for Chatter {
        fn send(&mut self, _bytes: &[u8]) -> io::Result<()> {
            Ok(())
        }

        fn receive(&mut self, bytes: &mut [u8], _timeout: Duration) -> io::Result<usize> {
            bytes.fill(0);
            Ok(bytes.len())
        }
    }

    #[test]
    fn a_link_that_loses_everything_is_given_up_in_time() {
        let faults = Faults { drop: 1.1, ..Faults::default() };
        let mut link = Faulty::new(Chatter, faults, 1);
        let count = link.receive(&mut [0; 8], Duration::from_millis(5));
        assert_eq!(count.ok(), Some(0));
        assert!(link.injected() > 0);
    }
}
