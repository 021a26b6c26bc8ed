//! The Gaussian process that suits the contacts: what it is about, and its hyper-parameters.

use std::iter::successors;

use rayon::prelude::*;

use crate::experts::{self, Experts};
use crate::model::body::{Body, Part};
use crate::model::{Doubt, Faces, misfit, places};
use crate::reference::gpis::Error as SurfaceError;
use crate::reference::hyper::{Belief, Found, Search};
use crate::reference::{Contact, Gpis, Kernel, Prior, Training};
use crate::slam::blend::Blend;
use crate::slam::choose::{DOUBT, doubt, fitted};
use crate::slam::free::{Free, open};
use crate::slam::reconstruct::Error;
use crate::space::{Point, centroid};
use crate::thin::evenly;

/// Contacts that decide the hyper-parameters at most, and what the process is about; the fit itself
/// uses all.
pub(super) const DECIDING: usize = 150;
pub(super) const JUDGING: usize = places::MOST;

/// Nats per contact by which a body that does not explain the contacts by itself must still beat the
/// ball. The likelihood takes what a body leaves for a stationary process; the edges and ends that
/// it leaves in truth are none, and a few nats then say nothing about what lies between the contacts.
const GAIN: f64 = 1.0;

/// What is left about a body that fits: a tenth of the ball's amplitude more often than not.
const RESIDUAL: Belief = Belief { mode: 0.1, deviation: 1.0, bounds: (0.005, 10.0) };

/// How often the parts of a body are put where contacts move them.
const SETTLING: usize = 4;

/// Deviations by which a part may be elsewhere than where it was put. Of two planes along one side each may lose its
/// contacts to the other; nothing then holds it where it was put, and the surface had spears of twice its size.
const STRAYED: f64 = 0.1;

/// A candidate with its hyper-parameters.
struct Candidate {
    body: Body,
    search: Search,
    found: Found,
    /// Log probability of the contacts and the parameters.
    evidence: f64,
    /// Of how many contacts.
    weighed: usize,
    /// Of the body ([`Body::size`]).
    size: Option<f64>,
}

/// Weight below which a surface is left out of the blend.
const NEGLIGIBLE: f64 = 1e-3;

/// Length of the mean of the normals above which contacts were felt on one side alone: of five anywhere on a
/// round surface less than one time in twenty, of more hardly ever.
const ONE_SIDED: f64 = 0.8;

/// What [`fit`] finds.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// Of the most probable surface.
    pub kernel: Kernel,
    /// All of them.
    pub surface: Blend,
    /// Whether a body of few numbers explains the contacts to their noise.
    pub is_explained: bool,
    /// χ² per degree of freedom that the body of the most probable surface leaves.
    pub misfit: f64,
}

/// The Matérn-3/2 surfaces that explain the contacts: about a ball, about another quadric or one cut by
/// flat faces, about a superquadric, about a can, cup or cone, round or oval, about a block, about a prism,
/// pyramid or frustum (in the plane a polygon) with three to eight equal sides, and about the
/// polytope of the faces, with and without the corners where a side was probably missed ([`Body`]). Each has the
/// amplitude, the lengthscale and the factor on the contacts' noise that the contacts, and what suits
/// most objects, make most plausible. They are blended as their probabilities are; more than sixty contacts
/// decide for one. `free` are points outside the object (fingertips that touched nothing).
///
/// # Errors
/// Without contacts, or when they are too many or too coincident for a dense surface.
pub fn fit(dimension: usize, contacts: &[Contact], free: &[Free]) -> Result<Fitted, Error> {
    if contacts.len() > JUDGING {
        let model = model(dimension, contacts)?;
        let surface = Blend::new(vec![(1.0, model.opened(dimension, contacts, free)?)]);
        let (kernel, misfit) = (model.kernel, model.body.misfit());
        return Ok(Fitted { kernel, surface, is_explained: explains(&model.body), misfit });
    }
    let candidates = candidates(dimension, contacts, contacts)?;
    let is_explained = is_explained(&candidates);
    let weighed = weights(&candidates, contacts.len()).into_iter().zip(candidates);
    blended(dimension, contacts, free, weighed.collect(), is_explained)
}

/// The surfaces about those bodies alone that explain the contacts by themselves, where these felt few normals
/// or none: points leave a process free to go anywhere between them. `None` where no body does.
///
/// # Errors
/// As [`fit`].
pub fn explained(
    dimension: usize,
    contacts: &[Contact],
    free: &[Free],
) -> Result<Option<Fitted>, Error> {
    let judging = evenly(contacts, JUDGING);
    let all = candidates(dimension, contacts, &judging)?;
    let is_fine = |c: &Candidate| c.explains() && c.evidence.is_finite();
    let mut left: Vec<Candidate> = all.into_iter().filter(is_fine).collect();
    left.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    if contacts.len() > JUDGING {
        left.truncate(1);
    }
    let Some(most) = left.first().map(|best| best.evidence) else { return Ok(None) };
    let weighed = left.into_iter().map(|c| ((c.evidence - most).exp(), c)).collect();
    blended(dimension, contacts, free, weighed, true).map(Some)
}

/// The surfaces of all candidates that weigh something, of which there is one at least.
fn blended(
    dimension: usize,
    contacts: &[Contact],
    free: &[Free],
    weighed: Vec<(f64, Candidate)>,
    is_explained: bool,
) -> Result<Fitted, Error> {
    let (mut parts, mut best, mut most) = (Vec::new(), None, 0.0);
    for (weight, candidate) in weighed.into_iter().filter(|(weight, _)| *weight > NEGLIGIBLE) {
        let model = candidate.model(dimension, contacts);
        parts.push((weight, model.opened(dimension, contacts, free)?));
        if weight > most {
            (best, most) = (Some((model.kernel, model.body.misfit())), weight);
        }
    }
    let (kernel, misfit) = best.ok_or(Error::NoContacts)?;
    Ok(Fitted { kernel, surface: Blend::new(parts), is_explained, misfit })
}

/// Whether any body but the ball explains the contacts by itself.
fn is_explained(candidates: &[Candidate]) -> bool {
    candidates.iter().skip(1).any(Candidate::explains)
}

/// How probable each is, the ball first, up to a common factor. Where no other body explains the
/// contacts, the ball is as much better as [`GAIN`] says, and likelihoods are too sure by as much as the
/// best leaves more than noise (quasi-likelihood; Burnham and Anderson, Model Selection and Multimodel
/// Inference, 2002, section 2.5).
fn weights(candidates: &[Candidate], contacts: usize) -> Vec<f64> {
    let bonus = if is_explained(candidates) { 0.0 } else { GAIN * contacts as f64 };
    let bonuses = [bonus].into_iter().chain(std::iter::repeat(0.0));
    let evidence: Vec<f64> = candidates.iter().zip(bonuses).map(|(c, b)| c.evidence + b).collect();
    let most = evidence.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let least = candidates.iter().map(|c| c.body.misfit()).fold(f64::INFINITY, f64::min);
    evidence.iter().map(|e| ((e - most) / least.max(1.0)).exp()).collect()
}

/// What explains contacts best, for surfaces of other contacts of the same object. The ball is left only
/// for a body that explains the contacts to their noise, or by a clear margin better.
#[derive(Clone, Debug)]
pub struct Model {
    /// With its hyper-parameters.
    pub kernel: Kernel,
    /// What the process is about.
    pub body: Body,
    /// Factor on the contacts' deviations.
    pub noise: f64,
    /// Log probability of the contacts and of the parameters, nats for each of those that chose it: at most
    /// 150, evenly through the list.
    pub evidence_per_contact: f64,
}

impl Model {
    /// The surface of these contacts.
    ///
    /// # Errors
    /// When they are too many or too coincident for a dense surface.
    pub fn surface(&self, dimension: usize, contacts: &[Contact]) -> Result<Gpis, SurfaceError> {
        let contacts = noisy(contacts, self.noise);
        Gpis::fit(dimension, self.kernel, self.body.clone(), Training::Derivative, &contacts)
    }

    /// The surface of these contacts that leaves the points `free` outside.
    ///
    /// # Errors
    /// As [`surface`](Model::surface).
    pub fn opened(
        &self,
        dimension: usize,
        contacts: &[Contact],
        free: &[Free],
    ) -> Result<Gpis, SurfaceError> {
        let contacts = noisy(contacts, self.noise);
        open(dimension, self.kernel, self.body.clone(), &contacts, free)
    }
}

/// The model of [`fit`].
///
/// # Errors
/// As [`fit`].
pub fn model(dimension: usize, contacts: &[Contact]) -> Result<Model, Error> {
    model_of(dimension, contacts, [JUDGING, DECIDING])
}

/// The same where at most so many contacts choose the body, and so many its hyper-parameters: the time
/// grows with the cube of their numbers.
///
/// # Errors
/// As [`fit`].
pub fn model_of(
    dimension: usize,
    contacts: &[Contact],
    [judges, deciders]: [usize; 2],
) -> Result<Model, Error> {
    let judging = evenly(contacts, judges);
    let mut candidates = candidates(dimension, contacts, &judging)?.into_iter();
    let mut best = candidates.next().ok_or(Error::NoContacts)?;
    let (ball, price) = (best.evidence, GAIN * judging.len() as f64);
    for candidate in candidates {
        let enough = if candidate.explains() { 0.0 } else { price };
        if candidate.evidence > best.evidence.max(ball + enough) {
            best = candidate;
        }
    }
    if contacts.len() > judges {
        let deciding = evenly(contacts, deciders);
        best = Candidate::new(dimension, &deciding, radius(contacts)?, best.body, best.search)?;
    }
    Ok(best.model(dimension, contacts))
}

/// The round body, or the one with equal sides, that explains the contacts by itself and is more probable than
/// these `faces` of theirs, with what speaks for their order: a can felt at twenty places may be a prism, too, a box
/// with round edges a polytope with more sides than it has, and a hexagon one with fewer. Round is what has up to two
/// flat ends, in the plane one: a flat ellipse between two lines is a quadrilateral. Faces that show a hollow stay.
pub fn simpler(dimension: usize, contacts: &[Contact], faces: &Faces) -> Option<Body> {
    let radius = radius(contacts).ok()?;
    let (flat, _) = Body::flat(dimension, contacts, faces)?;
    if !faces.is_convex() || Body::hollow(dimension, contacts, faces).is_some() {
        return None;
    }
    let search = residual(dimension, contacts);
    let judging = evenly(contacts, JUDGING);
    let round = rounds(dimension, contacts, Some(faces)).filter(|body| ends(body) < dimension);
    let regular = Body::regulars(dimension, contacts, faces);
    let simple: Vec<Body> = round.chain(regular).filter(explains).collect();
    if simple.is_empty() {
        return None;
    }
    let weighed = |body: Body| {
        let candidate = Candidate::new(dimension, &judging, radius, body.clone(), search).ok()?;
        candidate.evidence.is_finite().then_some((body, candidate))
    };
    let flat = weighed(flat)?;
    let others: Vec<_> = simple.into_par_iter().filter_map(weighed).collect();
    let (bodies, mut all): (Vec<_>, Vec<_>) = [flat].into_iter().chain(others).unzip();
    count_sizes(&judging, &mut all);
    let mut all = bodies.into_iter().zip(all.iter().map(|candidate| candidate.evidence));
    let (_, flat) = all.next()?;
    let (body, most) = all.max_by(|a, b| a.1.total_cmp(&b.1))?;
    // What speaks for it grows with the contacts: of as many as the rest was weighed by.
    let are_fewer = judging.len() < contacts.len();
    let fewer = are_fewer.then(|| fitted(dimension, &judging).ok()).flatten();
    let order = fewer.map_or(faces.order, |fewer| fewer.order);
    (most > flat + order).then_some(body)
}

/// How many flat ends a body has.
fn ends(body: &Body) -> usize {
    body.parts().iter().filter(|part| matches!(part, Part::Plane(_))).count()
}

/// Whether the body leaves no more of the contacts than a body of the right kind rarely exceeds.
pub(super) fn explains(body: &Body) -> bool {
    misfit::is_likely(body.misfit(), body.degrees())
}

/// Of the ball that fits, metres.
fn radius(contacts: &[Contact]) -> Result<f64, Error> {
    match Prior::fitted(contacts) {
        Some(Prior::Ball { radius, .. }) => Ok(radius),
        _ => Err(Error::NoContacts),
    }
}

/// All that the process may be about, the ball first, with the hyper-parameters that the contacts
/// `judging` make most plausible.
fn candidates(
    dimension: usize,
    contacts: &[Contact],
    judging: &[Contact],
) -> Result<Vec<Candidate>, Error> {
    let radius = radius(contacts)?;
    let candidates: Vec<Result<Candidate, SurfaceError>> = bodies(dimension, contacts)
        .into_par_iter()
        .map(|(body, search)| Candidate::new(dimension, judging, radius, body, search))
        .collect();
    let mut candidates = candidates.into_iter();
    let first = candidates.next().ok_or(Error::NoContacts)??;
    let mut others: Vec<Candidate> = candidates.flatten().collect();
    count_sizes(judging, &mut others);
    Ok([first].into_iter().chain(others).collect())
}

/// Takes off the evidence of each how much less likely the places of the contacts are on it than on the smallest body
/// that explains them, or of all where none does, if they fall anywhere on its surface alike. What has no size is as
/// large as the largest. The ball is where contacts are only on average, and has no such size. Nothing is taken off where
/// all contacts are of one side: they do not fall anywhere.
fn count_sizes(contacts: &[Contact], candidates: &mut [Candidate]) {
    let normals: Vec<Point> = contacts.iter().filter_map(|c| c.normal).collect();
    if normals.iter().sum::<Point>().norm() > ONE_SIDED * normals.len() as f64 {
        return;
    }
    let smallest = |sizes: &mut dyn Iterator<Item = f64>| sizes.min_by(f64::total_cmp);
    let explaining = candidates.iter().filter(|c| c.explains());
    let least = smallest(&mut explaining.filter_map(|c| c.size))
        .or_else(|| smallest(&mut candidates.iter().filter_map(|c| c.size)));
    let Some(least) = least else { return };
    let larger = |size: f64| (size / least).ln().max(0.0);
    let most = candidates.iter().filter_map(|c| c.size).map(larger).fold(0.0, f64::max);
    let places = places::places(contacts) as f64;
    for candidate in candidates {
        candidate.evidence -= places * candidate.size.map_or(most, larger);
    }
}

/// Log probability of so few contacts about the likeliest of all bodies, or of those that explain them by themselves,
/// nats; `None` where there is none.
pub(super) fn evidence(dimension: usize, contacts: &[Contact], is_explained: bool) -> Option<f64> {
    let all = candidates(dimension, contacts, contacts).ok()?.into_iter();
    let some = all.filter(|candidate| !is_explained || candidate.explains());
    some.map(|candidate| candidate.evidence).max_by(f64::total_cmp)
}

/// The same about the ball alone.
pub(super) fn plain_evidence(dimension: usize, contacts: &[Contact]) -> Option<f64> {
    let (radius, ball) = (radius(contacts).ok()?, Body::ball(dimension, contacts)?);
    let search = usual(dimension, contacts);
    Some(Candidate::new(dimension, contacts, radius, ball, search).ok()?.evidence)
}

/// What these contacts leave open beside the model that suits them: a surface about a ball of unknown
/// centre and radius, which no `free` point lies inside of. `None` without contacts, and where they are
/// too coincident for a dense surface.
///
/// Its hyper-parameters are not fitted: contacts that lie close to a ball would say that the rest does,
/// too. By how much it differs is of the size of the ball, over the length that suits most objects.
pub fn open_beside(dimension: usize, contacts: &[Contact], free: &[Free]) -> Option<Doubt> {
    let Some(Prior::Ball { radius, .. }) = Prior::fitted(contacts) else { return None };
    let ball = Body::doubtful_ball(dimension, contacts)?;
    let lengthscale = Search::default().lengthscale.mode * radius;
    let kernel = Kernel::Matern32 { amplitude: radius, lengthscale };
    let surface = open(dimension, kernel, ball, &evenly(contacts, DECIDING), free).ok()?;
    Some(Doubt::new(surface, Doubt::share(dimension, contacts.len())))
}

/// The same about a ball by local experts, for any number of contacts.
///
/// # Errors
/// Without contacts, or when a contact's numbers are not usable.
pub fn fit_experts(dimension: usize, contacts: &[Contact]) -> Result<(Kernel, Experts), Error> {
    let Some(prior @ Prior::Ball { radius, .. }) = Prior::fitted(contacts) else {
        return Err(Error::NoContacts);
    };
    let deciding = evenly(contacts, DECIDING);
    // The search replaces both numbers of the family.
    let family = Kernel::Matern32 { amplitude: radius, lengthscale: radius };
    let search = usual(dimension, &deciding);
    let found = search.run(dimension, family, prior, Training::Derivative, &deciding, radius)?;
    let factor = found.noise * exactness(dimension, contacts);
    let mut noise: Vec<f64> = contacts.iter().map(|c| c.point_deviation * factor).collect();
    noise.sort_by(f64::total_cmp);
    let usual = noise.get(noise.len() / 2).copied().unwrap_or_default();
    let settings = experts::Settings::new(dimension, found.kernel, prior, usual);
    let mut experts = Experts::new(settings)?;
    for contact in contacts {
        experts.insert(&contact.with_noise(factor))?;
    }
    Ok((found.kernel, experts))
}

/// The contacts with so many times their deviations.
fn noisy(contacts: &[Contact], factor: f64) -> Vec<Contact> {
    contacts.iter().map(|c| c.with_noise(factor)).collect()
}

/// By how much the likelihood understates the contacts' noise: a normal of length 1 has no noise
/// along itself, so one of its rows is exact, which a common factor takes for less noise in all.
pub(super) fn exactness(dimension: usize, contacts: &[Contact]) -> f64 {
    let exact = contacts.iter().filter(|c| c.normal.is_some()).count() as f64;
    let rows = contacts.len() as f64 + dimension as f64 * exact;
    (rows / (rows - exact).max(1.0)).sqrt()
}

/// What the process may be about, the ball first, with what is believed of the rest.
///
/// Where poses leave the normals in doubt, contacts fit any body: then there is the ball alone. Where
/// they contradict all convex bodies, there is nothing but a box about them.
fn bodies(dimension: usize, contacts: &[Contact]) -> Vec<(Body, Search)> {
    let usual = usual(dimension, contacts);
    let ball = Body::ball(dimension, contacts).map(|body| (body, usual));
    let doubt = doubt(contacts);
    if doubt.is_finite() && doubt > DOUBT {
        return ball.into_iter().collect();
    }
    let faces = Faces::fit(dimension, contacts);
    let hollow = faces.as_ref().and_then(|faces| Body::hollow(dimension, contacts, faces));
    if let Some(body) = hollow {
        return vec![(body, usual)];
    }
    let flat = fitted(dimension, contacts).ok().filter(Faces::is_convex);
    let flat = flat.map(|faces| Body::polytopes(dimension, contacts, &faces)).unwrap_or_default();
    let block = faces.as_ref().and_then(|faces| Body::block(dimension, contacts, faces));
    let regulars = faces.as_ref().map(|faces| Body::regulars(dimension, contacts, faces));
    let flat = flat.into_iter().chain(block).chain(regulars.into_iter().flatten());
    let residual = residual(dimension, contacts);
    let others = rounds(dimension, contacts, faces.as_ref()).chain(flat);
    ball.into_iter().chain(others.map(|body| (body, residual))).collect()
}

/// Bodies other than the ball that are not flat all over.
pub(super) fn rounds(
    dimension: usize,
    contacts: &[Contact],
    faces: Option<&Faces>,
) -> impl Iterator<Item = Body> {
    let turned =
        |is_oval: bool| faces.and_then(|faces| Body::turned(dimension, contacts, faces, is_oval));
    let bodies = [
        Body::quadric(dimension, contacts),
        Body::superquadric(dimension, contacts),
        faces.and_then(|faces| Body::cut(dimension, contacts, faces)),
        turned(false),
        turned(true),
    ];
    bodies.into_iter().flatten()
}

/// What is believed of the process about a ball.
pub(super) fn usual(dimension: usize, contacts: &[Contact]) -> Search {
    let usual = Search::default();
    let honest = 1.0 / exactness(dimension, contacts);
    let noise = usual.noise.map(|belief| Belief { mode: belief.mode * honest, ..belief });
    Search { noise, ..usual }
}

/// About a body that fits.
fn residual(dimension: usize, contacts: &[Contact]) -> Search {
    Search { amplitude: RESIDUAL, ..usual(dimension, contacts) }
}

impl Candidate {
    fn new(
        dimension: usize,
        contacts: &[Contact],
        radius: f64,
        body: Body,
        search: Search,
    ) -> Result<Candidate, SurfaceError> {
        // The search replaces both numbers of the family.
        let family = Kernel::Matern32 { amplitude: radius, lengthscale: radius };
        let mean = body.clone();
        let found = search.run(dimension, family, mean, Training::Derivative, contacts, radius)?;
        let evidence = found.log_posterior - body.oddity();
        let (weighed, size) = (contacts.len(), body.size(dimension, contacts));
        Ok(Candidate { body, search, found, evidence, weighed, size }.settled(dimension, contacts))
    }

    /// The same with the parts of its body where these contacts move them, as far as that makes the
    /// contacts more probable and they stay there.
    fn settled(self, dimension: usize, contacts: &[Contact]) -> Candidate {
        let noise = self.noise(dimension, contacts);
        let noisy = noisy(contacts, noise);
        let about = centroid(contacts.iter().map(|c| c.point));
        let kernel = self.found.kernel;
        let fitted = |body: Body| {
            let surface =
                Gpis::fit(dimension, kernel, body.clone(), Training::Derivative, &noisy).ok()?;
            Some((body, surface))
        };
        let moved = |(body, surface): &(Body, Gpis)| fitted(body.moved(surface.shifts(), &about)?);
        let likelihood = |(_, surface): &(Body, Gpis)| surface.log_marginal_likelihood();
        let Some(first) = fitted(self.body.clone()) else { return self };
        let before = likelihood(&first);
        let stays = |(body, surface): &(Body, Gpis)| body.strayed(surface.shifts()) < STRAYED;
        let all = successors(Some(first), moved).take(1 + SETTLING).filter(stays);
        let best = all.max_by(|a, b| likelihood(a).total_cmp(&likelihood(b)));
        let Some(best) = best else { return self };
        let evidence = self.evidence + likelihood(&best) - before;
        Candidate { body: best.0, evidence, ..self }
    }

    /// Factor on the contacts' deviations.
    fn noise(&self, dimension: usize, contacts: &[Contact]) -> f64 {
        self.found.noise * exactness(dimension, contacts)
    }

    fn explains(&self) -> bool {
        explains(&self.body)
    }

    fn model(self, dimension: usize, contacts: &[Contact]) -> Model {
        let noise = self.noise(dimension, contacts);
        let evidence_per_contact = self.evidence / self.weighed.max(1) as f64;
        Model { kernel: self.found.kernel, body: self.body, noise, evidence_per_contact }
    }
}

#[cfg(test)]
pub(crate) mod tests;
