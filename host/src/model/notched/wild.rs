//! How probable contacts are that the surface has no place for.

use std::f64::consts::TAU;

use super::Notched;
use crate::reference::Contact;

/// Wild contacts taken for granted beside those that are known.
const ASSUMED: f64 = 0.3;

/// Most that it may be, whatever the noise: contacts that are more probable lie where the surface has them, nearly.
const MOST: f64 = 1e-3;

/// How probable contacts are that the surface has no place for, relative to one where and as it has it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wild {
    /// Any contact, at least.
    pub least: f64,
    /// One that is of a side, at least.
    pub owned: f64,
}

/// Where hardly any is wild.
pub(super) const RARE: Wild = Wild { least: 1e-7, owned: 4e-6 };

impl Wild {
    /// Beside as many that are `known` to be wild: a wild one lies anywhere in the box about the contacts and faces
    /// anywhere (the uniform part of a mixture; Fraley and Raftery, The Computer Journal 41, 1998), one of the surface
    /// lies in as thin a layer as its deviation says and faces as nearly out.
    pub fn beside(start: &Notched, contacts: &[Contact], known: usize) -> Wild {
        let [point, normal] = [|c: &Contact| c.point_deviation, |c: &Contact| c.normal_deviation]
            .map(|deviation| median(contacts.iter().map(deviation).collect()));
        let volume: f64 = (0..start.dimension).map(|axis| start.size(axis)).product();
        let area: f64 = (0..start.dimension).map(|axis| 2.0 * volume / start.size(axis)).sum();
        let layer = area * point * TAU.sqrt() / volume;
        let facing = if start.dimension == 2 { normal / TAU.sqrt() } else { 0.5 * normal * normal };
        let share = (known as f64 + ASSUMED) / (contacts.len() + known).max(1) as f64;
        let least = (share * layer * facing).clamp(RARE.least, MOST);
        Wild { least, owned: least }
    }
}

/// Of none, zero.
pub(super) fn median(mut all: Vec<f64>) -> f64 {
    all.sort_by(f64::total_cmp);
    all.get(all.len() / 2).copied().unwrap_or_default()
}
