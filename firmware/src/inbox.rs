//! Bytes from an interrupt to the main loop.

use core::sync::atomic::{AtomicU8, AtomicU32, AtomicUsize, Ordering};

/// Room for the longest frame and the delimiter before it; a power of two.
const ROOM: usize = 256;

/// A queue that one interrupt handler fills and the main loop empties.
pub struct Inbox {
    bytes: [AtomicU8; ROOM],
    /// Bytes put and taken since the start, wrapping.
    put: AtomicUsize,
    taken: AtomicUsize,
    lost: AtomicU32,
}

impl Inbox {
    /// An empty one.
    pub const fn new() -> Self {
        Inbox {
            bytes: [const { AtomicU8::new(0) }; ROOM],
            put: AtomicUsize::new(0),
            taken: AtomicUsize::new(0),
            lost: AtomicU32::new(0),
        }
    }

    /// Adds a byte, or counts it as lost where there is no room: for the handler only.
    pub fn put(&self, byte: u8) {
        let put = self.put.load(Ordering::Relaxed);
        if put.wrapping_sub(self.taken.load(Ordering::Acquire)) >= ROOM {
            return self.lose();
        }
        if let Some(slot) = self.bytes.get(put % ROOM) {
            slot.store(byte, Ordering::Relaxed);
        }
        self.put.store(put.wrapping_add(1), Ordering::Release);
    }

    /// Counts a byte that the hardware lost: for the handler only.
    pub fn lose(&self) {
        self.lost.store(self.lost().saturating_add(1), Ordering::Relaxed);
    }

    /// The byte that came first, if any: for the main loop only.
    pub fn take(&self) -> Option<u8> {
        let taken = self.taken.load(Ordering::Relaxed);
        if self.is_empty() {
            return None;
        }
        let byte = self.bytes.get(taken % ROOM)?.load(Ordering::Relaxed);
        self.taken.store(taken.wrapping_add(1), Ordering::Release);
        Some(byte)
    }

    /// Whether nothing waits.
    pub fn is_empty(&self) -> bool {
        self.put.load(Ordering::Acquire) == self.taken.load(Ordering::Relaxed)
    }

    /// Bytes lost since the start.
    pub fn lost(&self) -> u32 {
        self.lost.load(Ordering::Relaxed)
    }
}
