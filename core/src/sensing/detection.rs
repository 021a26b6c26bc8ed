//! When a contact begins and ends, and what is averaged meanwhile.

use super::CalibrationError;

/// Readings a window can hold.
pub const LONGEST_WINDOW: usize = 16;

/// Readings a tare can ask for.
pub const LONGEST_TARE: u16 = 4096;

/// Largest magnitude of a word: sixteen of them still fit 32 bits.
pub(super) const LARGEST_WORD: i32 = 1 << 26;

/// How readings are averaged and a sensor is tared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sampling {
    /// Readings averaged, 1 to [`LONGEST_WINDOW`].
    pub window: u8,
    /// Longest time between two of them, microseconds.
    pub gap: u32,
    /// Readings of the free sensor in a row that make a tare, 1 to [`LONGEST_TARE`].
    pub tare: u16,
    /// Most that these may differ in any channel, words.
    pub spread: i32,
}

impl Sampling {
    /// The same, if it makes sense.
    ///
    /// # Errors
    /// Numbers that are zero or too large.
    pub fn checked(self) -> Result<Self, CalibrationError> {
        let window = (1..=LONGEST_WINDOW).contains(&(self.window as usize));
        let tare = (1..=LONGEST_TARE).contains(&self.tare);
        if !window || !tare || self.gap == 0 {
            Err(CalibrationError::Window)
        } else if self.spread <= 0 {
            Err(CalibrationError::NotPositive)
        } else {
            Ok(self)
        }
    }
}

/// When a contact is believed to begin and to end.
///
/// The level that has to be reached for a contact to begin is above that at which it ends, so that
/// noise about either does not make contacts come and go, and each has to be passed a few times in
/// a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hysteresis {
    /// A contact begins at this level, and
    pub begin: f32,
    /// ends below this one, which is at most that: newtons, or the sensor's measure of strength.
    pub end: f32,
    /// Readings in a row at `begin` or above before a contact is believed; at least one.
    pub begin_readings: u8,
    /// Readings in a row below `end` before it is given up; at least one.
    pub end_readings: u8,
}

impl Hysteresis {
    /// The same, if it makes sense.
    ///
    /// # Errors
    /// Levels that are not finite and positive or out of order, counts of zero.
    pub fn checked(self) -> Result<Self, CalibrationError> {
        if !(self.begin.is_finite() && self.end.is_finite()) {
            Err(CalibrationError::NotFinite)
        } else if !(self.end > 0.0) {
            Err(CalibrationError::NotPositive)
        } else if self.end > self.begin {
            Err(CalibrationError::Range)
        } else if self.begin_readings == 0 || self.end_readings == 0 {
            Err(CalibrationError::Window)
        } else {
            Ok(self)
        }
    }
}

/// What the level of one reading says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Nothing touches.
    Free,
    /// Something may have begun to touch.
    Beginning,
    /// Something touches.
    Touching,
    /// Too light to be located, but the contact is not given up yet.
    Ending,
}

/// Follows the level of a sensor through contacts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detector {
    touching: bool,
    /// Readings in a row that speak against `touching`.
    against: u8,
}

impl Detector {
    /// Nothing touches.
    pub const fn new() -> Self {
        Detector { touching: false, against: 0 }
    }

    /// Takes the next level; one that is NaN counts as none.
    #[inline]
    pub fn update(&mut self, level: f32, hysteresis: &Hysteresis) -> Phase {
        let (speaks_against, needed) = if self.touching {
            (!(level >= hysteresis.end), hysteresis.end_readings)
        } else {
            (level >= hysteresis.begin, hysteresis.begin_readings)
        };
        if !speaks_against {
            self.against = 0;
            return if self.touching { Phase::Touching } else { Phase::Free };
        }
        self.against = self.against.saturating_add(1);
        if self.against >= needed {
            self.touching = !self.touching;
            self.against = 0;
            return if self.touching { Phase::Touching } else { Phase::Free };
        }
        if self.touching { Phase::Ending } else { Phase::Beginning }
    }
}

impl Default for Detector {
    fn default() -> Self {
        Self::new()
    }
}

/// How long ago nothing touched, when a sensor's zero was last seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Held {
    last: u32,
    elapsed: u32,
}

impl Held {
    /// Not at all.
    pub const fn new() -> Self {
        Held { last: 0, elapsed: 0 }
    }

    /// Nothing touches.
    #[inline]
    pub fn release(&mut self) {
        self.elapsed = 0;
    }

    /// A reading at `time`, microseconds, wrapping; one that goes back adds nothing.
    #[inline]
    pub fn pass(&mut self, time: u32) {
        let step = time.wrapping_sub(self.last);
        self.last = time;
        if step as i32 > 0 {
            self.elapsed = self.elapsed.saturating_add(step);
        }
    }

    /// For so long; from 71 minutes on for ever as long.
    #[inline]
    pub fn seconds(&self) -> f32 {
        self.elapsed as f32 * 1e-6
    }
}

/// The last readings of a sensor, their exact sum and their times.
///
/// Words are whole numbers of at most 2²⁶ in magnitude, so that nothing is lost however long a
/// window runs; larger ones make a sum that wraps for as long as they are held.
#[derive(Clone, Debug, PartialEq)]
pub struct Window<const CHANNELS: usize> {
    rows: [[i32; CHANNELS]; LONGEST_WINDOW],
    times: [u32; LONGEST_WINDOW],
    sums: [i32; CHANNELS],
    next: u8,
    count: u8,
}

impl<const CHANNELS: usize> Window<CHANNELS> {
    /// Holds nothing.
    pub const fn new() -> Self {
        Window {
            rows: [[0; CHANNELS]; LONGEST_WINDOW],
            times: [0; LONGEST_WINDOW],
            sums: [0; CHANNELS],
            next: 0,
            count: 0,
        }
    }

    /// Forgets all readings.
    pub fn clear(&mut self) {
        self.sums = [0; CHANNELS];
        self.next = 0;
        self.count = 0;
    }

    /// Takes a reading and lets go of that `depth` readings ago (at most [`LONGEST_WINDOW`]). Starts
    /// again where `time` is not after the last reading's, or by more than `gap` microseconds.
    #[inline]
    pub fn push(&mut self, words: &[i32; CHANNELS], time: u32, depth: u8, gap: u32) {
        self.push_each(|k| words[k], time, depth, gap, (), |(), _, _| ());
    }

    /// As [`Self::push`], where `word` has the word of each channel, and `fold` goes on from `start`
    /// over channels and their new sums while they are at hand.
    #[inline(always)]
    pub(super) fn push_each<T>(
        &mut self,
        word: impl Fn(usize) -> i32,
        time: u32,
        depth: u8,
        gap: u32,
        start: T,
        fold: impl Fn(T, usize, i32) -> T,
    ) -> T {
        let depth = (depth.max(1) as usize).min(LONGEST_WINDOW);
        let wrap = |i: usize| if i == 0 { depth - 1 } else { i - 1 };
        if self.count as usize > depth || self.next as usize >= depth {
            self.clear();
        }
        let last = self.times[wrap(self.next as usize)];
        if self.count > 0 && !(1..=gap).contains(&time.wrapping_sub(last)) {
            self.clear();
        }
        let at = self.next as usize;
        let full = self.count as usize == depth;
        let row = &mut self.rows[at];
        if !full {
            *row = [0; CHANNELS];
        }
        let folded = exchange(row, &mut self.sums, word, start, fold);
        self.times[at] = time;
        self.next = if at + 1 == depth { 0 } else { at as u8 + 1 };
        if !full {
            self.count += 1;
        }
        folded
    }

    /// Readings held.
    #[inline]
    pub fn count(&self) -> u8 {
        self.count
    }

    /// Sum of the readings held, per channel.
    #[inline]
    pub fn sums(&self) -> &[i32; CHANNELS] {
        &self.sums
    }

    /// Midway between the first and the last reading held; 0 without any.
    #[inline]
    pub fn middle(&self) -> u32 {
        if self.count == 0 {
            return 0;
        }
        // Until the window is full it starts at 0, then at the reading that goes next.
        let (next, count) = (self.next as usize, self.count as usize);
        let first = if next == count { 0 } else { next };
        let last = if next == 0 { count - 1 } else { next - 1 };
        let time = |i: usize| self.times.get(i).copied().unwrap_or(0);
        let (first, last) = (time(first), time(last));
        first.wrapping_add(last.wrapping_sub(first) / 2)
    }
}

/// Puts words in the place of a row's. Alone, so that the registers suffice for its loop.
#[inline(never)]
fn exchange<const CHANNELS: usize, T>(
    row: &mut [i32; CHANNELS],
    sums: &mut [i32; CHANNELS],
    word: impl Fn(usize) -> i32,
    start: T,
    fold: impl Fn(T, usize, i32) -> T,
) -> T {
    let mut folded = start;
    for k in 0..CHANNELS {
        let now = word(k);
        sums[k] = sums[k].wrapping_add(now).wrapping_sub(row[k]);
        row[k] = now;
        folded = fold(folded, k, sums[k]);
    }
    folded
}

impl<const CHANNELS: usize> Default for Window<CHANNELS> {
    fn default() -> Self {
        Self::new()
    }
}

/// Readings of a free sensor, until enough of them in a row agreed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tare<const CHANNELS: usize> {
    sums: [i64; CHANNELS],
    least: [i32; CHANNELS],
    most: [i32; CHANNELS],
    count: u16,
}

impl<const CHANNELS: usize> Tare<CHANNELS> {
    /// None yet.
    pub const fn new() -> Self {
        Tare { sums: [0; CHANNELS], least: [0; CHANNELS], most: [0; CHANNELS], count: 0 }
    }

    /// Takes a reading; the mean once `needed` readings in a row lay within `spread` of one another,
    /// channel by channel. One that does not starts the count again.
    pub fn push(
        &mut self,
        words: &[i32; CHANNELS],
        needed: u16,
        spread: i32,
    ) -> Option<[f32; CHANNELS]> {
        if self.count == 0 {
            (self.least, self.most) = (*words, *words);
        }
        for k in 0..CHANNELS {
            self.least[k] = self.least[k].min(words[k]);
            self.most[k] = self.most[k].max(words[k]);
        }
        let wide = |k: usize| self.most[k].saturating_sub(self.least[k]) > spread;
        if (0..CHANNELS).any(wide) {
            *self = Self::new();
            return None;
        }
        for k in 0..CHANNELS {
            self.sums[k] += words[k] as i64;
        }
        self.count = self.count.saturating_add(1);
        (self.count >= needed.min(LONGEST_TARE)).then(|| {
            let count = self.count as f32;
            self.sums.map(|sum| sum as f32 / count)
        })
    }
}

impl<const CHANNELS: usize> Default for Tare<CHANNELS> {
    fn default() -> Self {
        Self::new()
    }
}
