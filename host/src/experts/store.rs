//! Factors of experts, as many as fit into memory.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::dense::Cholesky;

/// The factors at hand, by leaf. Where they are too many, a random one gives way: that needs no
/// account of who was asked when, keeps what is asked again and again nearly as well as if there
/// were one, and does not lose everything in a pass over more than fits.
#[derive(Debug)]
pub struct Store {
    most: usize,
    held: Mutex<Held>,
}

#[derive(Debug, Default)]
struct Held {
    /// Factor and the version of the expert it belongs to.
    factors: HashMap<u32, (u64, Arc<Cholesky>)>,
    /// Leaves in `factors`, in any order.
    leaves: Vec<u32>,
    bytes: usize,
    random: u64,
}

impl Store {
    /// Of up to `most` bytes.
    pub fn new(most: usize) -> Store {
        Store { most, held: Mutex::default() }
    }

    /// Bytes in use.
    pub fn bytes(&self) -> usize {
        self.lock().bytes
    }

    /// The factor of this version of a leaf's expert, if it is at hand.
    pub fn get(&self, leaf: u32, version: u64) -> Option<Arc<Cholesky>> {
        let held = self.lock();
        held.factors.get(&leaf).filter(|f| f.0 == version).map(|f| f.1.clone())
    }

    /// Keeps a factor in place of the leaf's last, if it fits at all.
    pub fn put(&self, leaf: u32, version: u64, factor: Arc<Cholesky>) {
        let bytes = factor.bytes();
        if bytes > self.most {
            return;
        }
        let mut held = self.lock();
        match held.factors.remove(&leaf) {
            Some((_, old)) => held.bytes -= old.bytes(),
            None => held.leaves.push(leaf),
        }
        held.bytes += bytes;
        held.factors.insert(leaf, (version, factor));
        while held.bytes > self.most {
            held.drop_one();
        }
    }

    fn lock(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Held {
    fn drop_one(&mut self) {
        self.random = self.random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        let place = (self.random >> 33) as usize % self.leaves.len().max(1);
        let leaf = self.leaves.swap_remove(place);
        if let Some((_, factor)) = self.factors.remove(&leaf) {
            self.bytes -= factor.bytes();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    fn factor(rows: usize) -> Arc<Cholesky> {
        Arc::new(Cholesky::new(DMatrix::identity(rows, rows)).unwrap())
    }

    #[test]
    fn holds_what_fits_and_only_the_version_asked_for() {
        let small = factor(24);
        let store = Store::new(10 * small.bytes());
        for leaf in 0..1000 {
            store.put(leaf, 1, small.clone());
            assert!(store.get(leaf, 2).is_none());
        }
        let held = || (0..1000).filter(|leaf| store.get(*leaf, 1).is_some()).count();
        assert_eq!((held(), store.bytes()), (10, 10 * small.bytes()));
        let kept = (0..1000).find(|leaf| store.get(*leaf, 1).is_some()).unwrap();
        store.put(kept, 2, small.clone());
        assert!(store.get(kept, 1).is_none() && store.get(kept, 2).is_some());
        assert_eq!((held(), store.bytes()), (9, 10 * small.bytes()));
        // Larger than everything: not kept, and nothing is lost for it.
        store.put(kept, 3, factor(500));
        assert!(store.get(kept, 3).is_none() && store.get(kept, 2).is_some());
    }

    #[test]
    fn a_pass_over_twice_what_fits_finds_some_again() {
        let one = factor(24);
        let store = Store::new(100 * one.bytes());
        let mut found = 0;
        for pass in 0..20 {
            for leaf in 0..200 {
                if store.get(leaf, 0).is_some() {
                    found += usize::from(pass > 0);
                } else {
                    store.put(leaf, 0, one.clone());
                }
            }
        }
        // The share h found again has h = 0.99^(200 (1 − h)), one drop in a hundred per miss: a fifth.
        assert!(found > 19 * 200 / 10, "{found}");
    }
}
