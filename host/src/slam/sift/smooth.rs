//! Contacts that a smooth surface through all others has no place for.

use super::{ROUNDS, WILD, are_few, only};
use crate::model::body::Body;
use crate::reference::hyper::Belief;
use crate::reference::{Contact, Gpis, Kernel, Prior, Training};
use crate::slam::fit::{self, DECIDING, exactness};
use crate::thin::evenly;

/// Odds that a contact is no wild one, nats, before it is compared with others: a fifth may be.
const RARE: f64 = 1.4;

/// Contacts from which on some may be left out: the surface through four others is a guess, and a fifth that it
/// misses belongs to the part it does not show.
const LEAST: usize = 10;

/// Deviation of wild contacts from the surface, as a part of the object's radius.
const FAR: f64 = 0.5;

/// Which contacts belong to an object of which nothing is known but that its surface is smooth: all, or without the few
/// that are likelier anywhere and of any normal than where the others lead the surface. `None` of fewer than ten
/// contacts, where they are too many or too coincident for a dense surface, and where those left out are many or agree
/// with one another.
///
/// A surface that is fitted to all follows wild contacts, and its hyper-parameters account for them. So each is
/// judged by the surface of the others, the strangest goes first, for it makes its neighbours look strange, and the
/// hyper-parameters are at first what suits most objects and then found from those that are left.
pub fn beside_surface(dimension: usize, contacts: &[Contact]) -> Option<Vec<bool>> {
    if contacts.len() < LEAST {
        return None;
    }
    let Some(Prior::Ball { radius, .. }) = Prior::fitted(contacts) else { return None };
    let usual = fit::usual(dimension, contacts);
    let of = |amplitude: f64, lengthscale: f64| Kernel::Matern32 { amplitude, lengthscale };
    let mut kernel = of(usual.amplitude.mode * radius, usual.lengthscale.mode * radius);
    let mut noise = usual.noise.map_or(1.0, |noise: Belief| noise.mode);
    let mut trusted = vec![true; contacts.len()];
    for _ in 0..ROUNDS {
        let own = only(contacts, &trusted);
        let body = Body::doubtful_ball(dimension, &own)?;
        let noisy: Vec<Contact> =
            contacts.iter().map(|c| c.with_noise(noise * exactness(dimension, contacts))).collect();
        let surface = Gpis::fit(dimension, kernel, body, Training::Derivative, &noisy).ok()?;
        let next = plausible(&surface, radius, contacts)?;
        if next == trusted {
            break;
        }
        trusted = next;
        let deciding = evenly(&only(contacts, &trusted), DECIDING);
        let ball = Body::ball(dimension, &deciding)?;
        let found =
            usual.run(dimension, of(radius, radius), ball, Training::Derivative, &deciding, radius);
        let found = found.ok()?;
        (kernel, noise) = (found.kernel, found.noise);
    }
    are_few(&trusted, contacts, radius).then_some(trusted)
}

/// Which contacts of a surface are likelier its own than wild, each judged by those that are left; `None` where many are
/// not.
fn plausible(surface: &Gpis, radius: f64, contacts: &[Contact]) -> Option<Vec<bool>> {
    let mut left = surface.left_out();
    let mut trusted = vec![true; contacts.len()];
    let most = (WILD * contacts.len() as f64) as usize;
    for _ in 0..=most {
        let odds = |i: usize| {
            let density = left.density(i)?;
            let wild = anywhere(surface.dimension(), radius, &contacts[i]) - RARE;
            Some((density - wild, i))
        };
        let strangest = (0..contacts.len()).filter_map(odds).min_by(|a, b| a.0.total_cmp(&b.0));
        match strangest {
            Some((odds, i)) if odds < 0.0 => {
                left.remove(i);
                trusted[i] = false;
            }
            _ => return Some(trusted),
        }
    }
    None
}

/// ln of the density of what a wild contact measured: anywhere about the surface, and with a normal of any direction,
/// whose components vary by 1/√dimension.
pub(super) fn anywhere(dimension: usize, radius: f64, contact: &Contact) -> f64 {
    let tau = std::f64::consts::TAU;
    let off = -0.5 * (tau * (FAR * radius).powi(2)).ln() - 0.5;
    let d = dimension as f64;
    let turned = contact.normal.map_or(0.0, |_| -0.5 * d * ((tau / d).ln() + 1.0));
    off + turned
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slam::choose::Choice;
    use crate::slam::fit::tests::touched_of;
    use crate::slam::reconstruct::{Poses, shape};
    use crate::slam::sift::tests::{felt, hausdorff};

    /// An outline whose radius differs by such a part of it at each angle, as an object's text.
    fn outline(radius: f64, part: impl Fn(f64) -> f64) -> String {
        let corner = |i: u32| {
            let angle = f64::from(i) * std::f64::consts::TAU / 60.0;
            let radius = radius * (1.0 + part(angle));
            format!("{:.5}x{:.5}", radius * angle.cos(), radius * angle.sin())
        };
        format!("corners:{}", (0..60).map(corner).collect::<Vec<_>>().join(","))
    }

    /// Neither flat nor of few numbers.
    fn peanut() -> String {
        outline(0.04, |angle| 0.3 * (2.0 * angle).cos() + 0.05 * (3.0 * angle).sin())
    }

    #[test]
    fn wild_contacts_on_a_smooth_outline_are_found_and_no_others() {
        let (mut found, mut all, mut lost) = (0, 0, 0);
        for seed in 0..6 {
            let (dimension, contacts, wild) = felt(&peanut(), seed, 0.1);
            let trusted = beside_surface(dimension, &contacts).unwrap();
            for (trusted, wild) in trusted.iter().zip(&wild) {
                found += usize::from(!trusted && *wild);
                lost += usize::from(!trusted && !wild);
                all += usize::from(*wild);
            }
        }
        assert!(4 * found >= 3 * all && lost <= all / 8, "{found} of {all}, {lost}");
    }

    #[test]
    fn where_no_contact_is_wild_none_is_left_out_but_a_few_beside_edges() {
        let most = |object: &str| {
            let lost = |seed: u64| {
                let (dimension, contacts, _) = felt(object, seed, 0.0);
                let trusted = beside_surface(dimension, &contacts).unwrap();
                trusted.iter().filter(|t| !**t).count()
            };
            (0..3).map(lost).max().unwrap_or_default()
        };
        assert_eq!(most(&peanut()), 0);
        assert_eq!(most("ellipse:0.1x0.06"), 0);
        // Of eighty contacts: no smooth surface turns as an edge does.
        for object in ["rectangle:0.1x0.06", "lshape:0.09x0.09x0.035"] {
            assert!(most(object) <= 3, "{object}: {}", most(object));
        }
    }

    #[test]
    fn a_smooth_shape_is_made_without_wild_contacts() {
        let kidney = outline(0.045, |angle| {
            0.35 * (2.0 * angle).cos() + 0.22 * angle.sin() + 0.06 * (3.0 * angle).sin()
        });
        for seed in [24, 26] {
            let (dimension, contacts, _) = touched_of(&kidney, 25, 0.1, seed);
            let (poses, auto) = (Poses::Known, Choice::Auto);
            let made = shape(dimension, &contacts, &[], poses, auto, &|_, _| {}).unwrap();
            let error = hausdorff(&made.geometry, &kidney);
            // With the wild ones, 16 and 17 mm.
            assert!(error < 5e-3, "{seed}: {error}");
        }
    }

    #[test]
    fn many_wild_contacts_are_no_reason_and_none_are_none() {
        let (dimension, contacts, _) = felt(&peanut(), 0, 0.5);
        assert_eq!(beside_surface(dimension, &contacts), None);
        assert_eq!(beside_surface(2, &[]), None);
        assert_eq!(beside_surface(dimension, &contacts[..LEAST - 1]), None);
        // One contact, or one that was felt again and again, says nothing against itself.
        for same in [LEAST, 30] {
            let trusted = beside_surface(dimension, &vec![contacts[0]; same]);
            assert!(trusted.is_none_or(|trusted| trusted.iter().all(|t| *t)));
        }
    }
}
