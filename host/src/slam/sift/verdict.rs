//! Whether contacts that others' surface has no place for are wild, or of a part of the object that it lacks.
//!
//! The few contacts of a chamfer, of a bottle's neck or of the tip of a wedge lie far off the body that explains all
//! others, as wild ones do. What tells them apart is how likely all are together.

use super::only;
use super::smooth;
use crate::reference::{Contact, Prior};
use crate::slam::fit::{self, JUDGING};
use crate::thin::evenly;

/// Nats by which a contact is less likely to be wild than not, before anything is known of it: one of twenty is.
const RARE: f64 = 2.94;

/// Bodies that may contradict a verdict.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Bodies {
    /// All: those not trusted were found by a body of few numbers, so that what is about another is as good.
    All,
    /// Those alone that explain all contacts: those not trusted were found by the surface of the others, and a
    /// process follows wild contacts, too.
    Explaining,
}

/// Whether those not `trusted` are likelier wild than the object's. Two ways to look at it are weighed alike: by the
/// likeliest body of all contacts and that of the others, and by what the surface of the others leads to where nothing
/// is known of any body, for a body that many contacts agree with makes what it lacks look less likely than it is.
pub(super) fn are_wild(
    dimension: usize,
    contacts: &[Contact],
    trusted: &[bool],
    bodies: Bodies,
) -> bool {
    let suspects: Vec<bool> = trusted.iter().map(|trusted| !trusted).collect();
    let suspects = only(contacts, &suspects);
    let own = only(contacts, trusted);
    let Some(Prior::Ball { radius, .. }) = Prior::fitted(&own) else { return true };
    if suspects.is_empty() {
        return true;
    }
    let own = evenly(&own, JUDGING.saturating_sub(suspects.len()));
    let all = [&own[..], &suspects].concat();
    let wild = |c: &Contact| smooth::anywhere(dimension, radius, c) - RARE;
    let wild: f64 = suspects.iter().map(wild).sum();
    let by_bodies = || {
        let with = fit::evidence(dimension, &all, bodies == Bodies::Explaining)?;
        Some(fit::evidence(dimension, &own, false)? + wild - with)
    };
    let by_surface = || {
        Some(fit::plain_evidence(dimension, &own)? + wild - fit::plain_evidence(dimension, &all)?)
    };
    // Where no body explains all, or nothing can be said, what found them is right.
    by_bodies().zip(by_surface()).is_none_or(|(bodies, surface)| bodies + surface > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slam::fit::tests::touched;
    use crate::slam::sift::tests::with_wild;
    use crate::slam::sift::{beside_round, trusted_at_known};

    /// A rectangle with one corner cut off.
    const CUT: &str = "corners:-0.055x-0.035,0.055x-0.035,0.055x0.01,0.03x0.035,-0.055x0.035";

    fn lost(trusted: &[bool]) -> usize {
        trusted.iter().filter(|trusted| !**trusted).count()
    }

    #[test]
    fn the_only_contact_of_a_side_is_not_wild() {
        let mut suspected = 0;
        for seed in 0..16 {
            let (dimension, contacts, _) = touched(CUT, 20, seed);
            // Without a corner a rectangle is round enough for a superquadric.
            suspected += beside_round(dimension, &contacts).map_or(0, |trusted| lost(&trusted));
            let trusted = trusted_at_known(dimension, &contacts);
            assert_eq!(lost(&trusted), 0, "{seed}");
        }
        assert!(suspected >= 2, "{suspected}");
    }

    #[test]
    fn wild_contacts_are_convicted() {
        for (object, few) in [(CUT, 30), ("ellipse:0.1x0.06", 25), ("box:0.1x0.07x0.05", 40)] {
            for seed in 0..3 {
                let (dimension, contacts) = with_wild(object, few, seed);
                let trusted: Vec<bool> = (0..contacts.len()).map(|i| i < few).collect();
                for bodies in [Bodies::All, Bodies::Explaining] {
                    assert!(are_wild(dimension, &contacts, &trusted, bodies), "{object} {seed}");
                }
            }
        }
    }

    #[test]
    fn where_nothing_can_be_said_nothing_is_changed() {
        let (dimension, contacts, _) = touched(CUT, 20, 0);
        let all = vec![true; contacts.len()];
        assert!(are_wild(dimension, &contacts, &all, Bodies::All));
        assert!(are_wild(dimension, &contacts, &vec![false; contacts.len()], Bodies::All));
        assert!(are_wild(dimension, &[], &[], Bodies::All));
        let same = vec![contacts[0]; 20];
        let half: Vec<bool> = (0..20).map(|i| i % 2 == 0).collect();
        // Whatever is said of one place that was felt again and again, it is said.
        let _ = are_wild(dimension, &same, &half, Bodies::All);
    }
}
