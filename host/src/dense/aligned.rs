//! Numbers that start on a line of the cache.

use std::ops::{Deref, DerefMut};

/// Bytes of a line of the cache, and of the widest vector.
const LINE: usize = 64;

/// Numbers of one line.
const SPARE: usize = LINE / size_of::<f64>();

/// A stretch of numbers whose first is at the start of a cache line, so that no vector lies across
/// two of them. Only speed depends on it.
#[derive(Debug)]
pub(super) struct Aligned {
    /// With up to a line of numbers before those that count.
    memory: Vec<f64>,
    start: usize,
    length: usize,
}

impl Aligned {
    pub(super) fn zeros(length: usize) -> Self {
        let memory = vec![0.0; length + SPARE];
        let start = memory.as_ptr().align_offset(LINE).min(SPARE);
        Aligned { memory, start, length }
    }
}

impl Clone for Aligned {
    fn clone(&self) -> Self {
        let mut copy = Self::zeros(self.length);
        copy.copy_from_slice(self);
        copy
    }
}

impl Deref for Aligned {
    type Target = [f64];

    fn deref(&self) -> &[f64] {
        &self.memory[self.start..self.start + self.length]
    }
}

impl DerefMut for Aligned {
    fn deref_mut(&mut self) -> &mut [f64] {
        &mut self.memory[self.start..self.start + self.length]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_are_equal_and_start_on_lines_too() {
        for length in 0..40 {
            let mut one = Aligned::zeros(length);
            (0..length).for_each(|i| one[i] = i as f64);
            let two = one.clone();
            assert_eq!((&one[..], one.len()), (&two[..], length));
            for numbers in [&one, &two] {
                assert_eq!(numbers.as_ptr().align_offset(LINE), 0);
            }
        }
    }
}
