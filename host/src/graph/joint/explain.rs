//! Which contact lies on which face: handing contacts over, and faces that merge, appear, part and go.
//!
//! Every such move is tried on the whole graph and kept if the cost, a negative log evidence, falls;
//! so there is no limit in millimetres or degrees at which faces are the same.

use nalgebra::{DMatrix, DVector};

use super::problem::{Labels, Problem, State};
use super::regular::MOST_FACES;
use super::relation::Relation;
use super::ridge;
use super::solve::{Solved, offset_row, rough, solve};
use super::tangent::{Face, six_by_six};
use crate::model::faces::{Faces, Owner};
use crate::reference::Contact;
use crate::slam::place::doubt;
use crate::space::Point;

/// Rounds of solving and handing contacts over.
const ROUNDS: usize = 4;

/// Faces turned against each other by more than this cannot be one, cosine.
const ALIKE: f64 = 0.7;

/// Most grasps with which faces are moved that are too many for a flat object: every move solves all grasps
/// with all of them, and what comes of it is not believed.
const LONG: usize = 48;

/// Nats that a rough solution may cost more than the best graph and yet become cheaper.
const NEARLY: f64 = 8.0;

/// Merges tried at most each time; those less plausible by this many nats than what the linearised
/// problem allows are not tried.
const MOST_MERGES: usize = 4;
const HOPELESS: f64 = 15.0;

/// Solves, hands every contact to the face that suits it best, and again until nothing changes. Of faces that
/// are too many (`is_endless`) it is only found about where they lie: they merge on, and are then solved, or
/// are not believed.
pub fn settle<const D: usize>(
    problem: &Problem,
    state: State,
    labels: Labels,
) -> Option<Solved<D>> {
    let (state, labels) = supported(problem, state, labels);
    let solve = if is_endless(&state) { rough::<D> } else { solve::<D> };
    let mut best = solve(problem, state, labels)?;
    for _ in 0..ROUNDS {
        let (state, labels) =
            supported(problem, best.state.clone(), assigned(problem, &best.state));
        if labels == best.labels && state.faces.len() == best.state.faces.len() {
            break;
        }
        let next = solve(problem, state, labels)?;
        if next.cost > best.cost - 1e-6 {
            break;
        }
        best = next;
    }
    Some(best)
}

/// The face, edge or corner that suits each contact best, if one suits it better than none.
pub fn assigned(problem: &Problem, state: &State) -> Labels {
    (0..problem.until(state))
        .map(|i| {
            let contact = problem.placed(&state.poses, i);
            best(problem, &state.faces, &contact, None)
        })
        .collect()
}

/// What suits a contact (object frame) best, the face `barred` aside; `None` where having no face costs
/// less.
pub fn best(
    problem: &Problem,
    faces: &[Face],
    contact: &Contact,
    barred: Option<usize>,
) -> Option<Owner> {
    let allowed = faces.iter().copied().enumerate().filter(|(j, _)| Some(*j) != barred);
    let allowed: Vec<(usize, Face)> = allowed.collect();
    let mut found = None;
    let mut least = problem.unexplained(contact);
    let mut consider = |owner: Owner, cost: f64| {
        if cost < least {
            (found, least) = (Some(owner), cost);
        }
    };
    for (j, face) in &allowed {
        consider(Owner::Face(*j), problem.on(face, contact));
    }
    for (owner, ridge) in ridge::near(problem, &allowed, contact, |_| contact.point_deviation) {
        consider(owner, ridge.cost(problem, contact, 1.0));
    }
    found
}

/// Without the faces that fewer than two contacts support, one of them on the face alone and with a
/// normal. Contacts on edges of such a face are without a label.
pub fn supported(problem: &Problem, state: State, labels: Labels) -> (State, Labels) {
    let mut counts = vec![[0usize; 2]; state.faces.len()];
    for (felt, label) in problem.felt.iter().zip(&labels) {
        for face in label.iter().flat_map(|owner| owner.faces()) {
            counts[*face][0] += 1;
        }
        if let Some(Owner::Face(face)) = label {
            counts[*face][1] += usize::from(felt.contact.normal.is_some());
        }
    }
    let mut numbers = vec![None; counts.len()];
    let mut faces = Vec::new();
    for (j, count) in counts.iter().enumerate() {
        if count[0] >= 2 && count[1] >= 1 {
            numbers[j] = Some(faces.len());
            faces.push(state.faces[j]);
        }
    }
    let labels = labels.into_iter().map(|label| renamed(label?, |face| numbers[face])).collect();
    let kept = |relation: &Relation| {
        let [i, j] = relation.faces;
        Some(Relation { faces: [numbers[i]?, numbers[j]?], ..*relation })
    };
    let relations = state.relations.iter().filter_map(kept).collect();
    (State { faces, relations, ..state }, labels)
}

/// The same with other numbers of the faces; `None` where one has none. Where faces have become one, it is
/// that one, or where that meets the other.
pub(super) fn renamed(owner: Owner, number: impl Fn(usize) -> Option<usize>) -> Option<Owner> {
    let mut faces = owner.faces().iter().map(|face| number(*face)).collect::<Option<Vec<_>>>()?;
    faces.sort_unstable();
    faces.dedup();
    match faces[..] {
        [i] => Some(Owner::Face(i)),
        [i, j] => Some(Owner::Edge([i, j])),
        [i, j, k] => Some(Owner::Corner([i, j, k])),
        _ => None,
    }
}

/// Faces fitted to contacts in the object frame (`None`: not to be used), and the labels.
pub fn fitted(dimension: usize, contacts: &[Option<Contact>]) -> (Vec<Face>, Labels) {
    let given: Vec<Contact> = contacts.iter().flatten().copied().collect();
    let Some(faces) = Faces::fit(dimension, &given) else {
        return (Vec::new(), vec![None; contacts.len()]);
    };
    let mut owners = faces.owners.iter();
    let label = |contact: &Option<Contact>| {
        contact.as_ref()?;
        *owners.next()?
    };
    let labels = contacts.iter().map(label).collect();
    let faces = faces.faces.iter().map(|f| Face { normal: f.normal, offset: f.offset });
    (faces.collect(), labels)
}

/// Pairs of faces that may be one, the most plausible first.
///
/// The Bayes factor for "the same plane" is the density of their difference at zero after all contacts
/// over that before any (Savage–Dickey, Dickey 1971), with their joint covariance, so that faces felt
/// from uncertain poses are compared with that uncertainty.
fn pairs<const D: usize>(problem: &Problem, solved: &Solved<D>) -> Vec<(usize, usize)> {
    let (dimension, state) = (problem.dimension, &solved.state);
    let covariance = solved.factor.faces();
    let mut centres = vec![(Point::zeros(), 0.0); state.faces.len()];
    for (i, label) in solved.labels.iter().enumerate() {
        if let Some(Owner::Face(face)) = label {
            centres[*face].0 += problem.placed(&state.poses, i).point;
            centres[*face].1 += 1.0;
        }
    }
    let mut found = Vec::new();
    for i in 0..state.faces.len() {
        for j in 0..i {
            let (a, b) = (&state.faces[i], &state.faces[j]);
            if a.normal.dot(&b.normal) < ALIKE {
                continue;
            }
            let middle = (centres[i].0 + centres[j].0) / (centres[i].1 + centres[j].1);
            let (s, t) = (a.tangents(dimension), b.tangents(dimension));
            let mut difference = DVector::zeros(dimension);
            let mut rows = DMatrix::zeros(dimension, 2 * dimension);
            for k in 0..dimension - 1 {
                difference[k] = s[k].dot(&b.normal);
                rows[(k, k)] = -1.0;
                for l in 0..dimension - 1 {
                    rows[(k, dimension + l)] = s[k].dot(&t[l]);
                }
            }
            difference[dimension - 1] = b.value(&middle) - a.value(&middle);
            for l in 0..dimension {
                rows[(dimension - 1, l)] = -offset_row(dimension, state, i, &middle)[l];
                rows[(dimension - 1, dimension + l)] = offset_row(dimension, state, j, &middle)[l];
            }
            let at = |k: usize| {
                if k < dimension { dimension * i + k } else { dimension * j + k - dimension }
            };
            let own =
                DMatrix::from_fn(2 * dimension, 2 * dimension, |r, c| covariance[(at(r), at(c))]);
            let spread = &rows * own * rows.transpose();
            let Some(factor) = spread.cholesky() else { continue };
            let chi = difference.dot(&factor.solve(&difference));
            let scale = dimension as f64 * std::f64::consts::TAU.ln() + factor.determinant().ln();
            let plausible = problem.vague() - 0.5 * (chi + scale);
            if plausible > -HOPELESS {
                found.push((plausible, (i, j)));
            }
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().map(|(_, pair)| pair).take(MOST_MERGES).collect()
}

/// Whether faces are those of a curved object in a log that is too long to move them.
pub(super) fn is_endless(state: &State) -> bool {
    state.poses.len() > LONG && state.faces.len() > MOST_FACES
}

/// Tries every kind of move once; whether one lowered the cost.
pub fn improve<const D: usize>(problem: &Problem, best: &mut Solved<D>) -> bool {
    let before = best.cost;
    // Merged faces make others comparable: as long as it goes.
    while merge(problem, best) {}
    if is_endless(&best.state) {
        return best.cost < before - 1e-6;
    }
    appear(problem, best);
    part(problem, best);
    go(problem, best);
    best.cost < before - 1e-6
}

/// Whether a proposal may cost less, from [`settle`] with rough solutions: most moves lose by far, which a
/// few iterations show, and the many that end a solution gain next to nothing. What may win is solved from
/// its start again, so that what comes of it is the same.
fn may_cost_less<const D: usize>(
    problem: &Problem,
    best: &Solved<D>,
    state: &State,
    labels: &Labels,
) -> bool {
    let (state, labels) = supported(problem, state.clone(), labels.clone());
    let Some(mut found) = rough::<D>(problem, state, labels) else { return true };
    for _ in 0..ROUNDS {
        if found.cost < best.cost + NEARLY {
            return true;
        }
        let (state, labels) =
            supported(problem, found.state.clone(), assigned(problem, &found.state));
        if labels == found.labels && state.faces.len() == found.state.faces.len() {
            return false;
        }
        match rough::<D>(problem, state, labels) {
            Some(next) if next.cost > found.cost + NEARLY => return false,
            Some(next) => found = next,
            None => return true,
        }
    }
    found.cost < best.cost + NEARLY
}

/// Keeps what is proposed if it costs less.
pub fn attempt<const D: usize>(
    problem: &Problem,
    best: &mut Solved<D>,
    state: State,
    labels: Labels,
) -> bool {
    // Too many faces are solved roughly anyhow.
    if !is_endless(&state) && !may_cost_less(problem, best, &state, &labels) {
        return false;
    }
    match settle::<D>(problem, state, labels) {
        Some(next) if next.cost < best.cost - 1e-6 => {
            *best = next;
            true
        }
        _ => false,
    }
}

/// Two faces become one.
fn merge<const D: usize>(problem: &Problem, best: &mut Solved<D>) -> bool {
    pairs(problem, best).into_iter().any(|(i, j)| {
        let mut labels = best.labels.clone();
        let count = |face| best.labels.iter().filter(|l| **l == Some(Owner::Face(face))).count();
        let (kept, gone) = if count(i) < count(j) { (j, i) } else { (i, j) };
        for label in &mut labels {
            *label = label.and_then(|l| renamed(l, |f| Some(if f == gone { kept } else { f })));
        }
        attempt(problem, best, best.state.clone(), labels)
    })
}

/// Contacts that nothing explains make faces among themselves.
fn appear<const D: usize>(problem: &Problem, best: &mut Solved<D>) -> bool {
    let Some(inverse) = best.factor.inverse() else { return false };
    let placed = |i: usize| {
        let contact = problem.placed(&best.state.poses, i);
        match problem.felt[i].grasp {
            0 => contact,
            k => doubt(contact, &six_by_six(&inverse.given_faces[k - 1])),
        }
    };
    let contacts: Vec<Option<Contact>> =
        (0..best.labels.len()).map(|i| best.labels[i].is_none().then(|| placed(i))).collect();
    let (faces, own) = fitted(problem.dimension, &contacts);
    let mut changed = false;
    for (number, face) in faces.into_iter().enumerate() {
        let number = Some(Owner::Face(number));
        if own.iter().filter(|l| **l == number).count() < 2 {
            continue;
        }
        let (mut state, mut labels) = (best.state.clone(), best.labels.clone());
        for (label, own) in labels.iter_mut().zip(&own) {
            if label.is_none() && *own == number {
                *label = Some(Owner::Face(state.faces.len()));
            }
        }
        state.faces.push(face);
        changed |= attempt(problem, best, state, labels);
    }
    changed
}

/// The contacts of one face make several.
fn part<const D: usize>(problem: &Problem, best: &mut Solved<D>) -> bool {
    let mut changed = false;
    for face in 0..best.state.faces.len() {
        if face >= best.state.faces.len() {
            break;
        }
        let contacts: Vec<Option<Contact>> = (0..best.labels.len())
            .map(|i| {
                (best.labels[i] == Some(Owner::Face(face)))
                    .then(|| problem.placed(&best.state.poses, i))
            })
            .collect();
        let (faces, own) = fitted(problem.dimension, &contacts);
        if faces.len() < 2 {
            continue;
        }
        let (mut state, mut labels) = (best.state.clone(), best.labels.clone());
        for (label, own) in labels.iter_mut().zip(&own) {
            if let Some(own) = own {
                *label = renamed(*own, |number| Some(state.faces.len() + number));
            }
        }
        state.faces.extend(faces);
        changed |= attempt(problem, best, state, labels);
    }
    changed
}

/// A face goes and its contacts are handed to others.
fn go<const D: usize>(problem: &Problem, best: &mut Solved<D>) -> bool {
    let mut changed = false;
    let mut face = 0;
    while face < best.state.faces.len() {
        let mut labels = best.labels.clone();
        let own = |label: &Option<Owner>| label.is_some_and(|l| l.faces().contains(&face));
        for (i, label) in labels.iter_mut().enumerate().filter(|(_, l)| own(l)) {
            let contact = problem.placed(&best.state.poses, i);
            *label = self::best(problem, &best.state.faces, &contact, Some(face));
        }
        if attempt(problem, best, best.state.clone(), labels) {
            changed = true;
        } else {
            face += 1;
        }
    }
    changed
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::{Options, simulate};
    use crate::slam::track;
    use crate::space::Pose;

    /// A rectangle at its true poses, solved.
    fn rectangle() -> (Problem, Solved<3>) {
        let log = simulate(&Options::new("rectangle:0.1x0.06".parse().unwrap())).unwrap().log;
        let problem = Problem::new(&log);
        let poses: Vec<Pose> = track::truth(&log).unwrap().iter().map(|step| step.pose).collect();
        let contacts: Vec<Option<Contact>> =
            (0..problem.felt.len()).map(|i| Some(problem.placed(&poses, i))).collect();
        let (faces, labels) = fitted(2, &contacts);
        let state = State { poses, faces, relations: Vec::new() };
        let mut best = settle::<3>(&problem, state, labels).unwrap();
        improve(&problem, &mut best);
        (problem, best)
    }

    #[test]
    fn only_what_loses_by_far_is_given_up_early() {
        let (problem, best) = rectangle();
        assert_eq!(best.state.faces.len(), 4);
        assert!(may_cost_less(&problem, &best, &best.state, &best.labels));
        for face in 0..4 {
            // Without one of its sides.
            let kept = |label: &Option<Owner>| label.filter(|owner| !owner.faces().contains(&face));
            let labels: Labels = best.labels.iter().map(kept).collect();
            let whole = settle::<3>(&problem, best.state.clone(), labels.clone()).unwrap();
            assert!(whole.cost > best.cost + 2.0 * NEARLY, "{face}: {}", whole.cost - best.cost);
            assert!(!may_cost_less(&problem, &best, &best.state, &labels));
        }
        // A side in two halves.
        let (mut state, mut labels) = (best.state.clone(), best.labels.clone());
        state.faces.push(state.faces[0]);
        let own = labels.iter_mut().filter(|label| **label == Some(Owner::Face(0)));
        own.step_by(2).for_each(|label| *label = Some(Owner::Face(4)));
        let parted = solve::<3>(&problem, state.clone(), labels.clone()).unwrap();
        assert!(parted.cost > best.cost);
        assert!(may_cost_less(&problem, &parted, &best.state, &best.labels));
    }
}
