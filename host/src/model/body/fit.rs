//! Fitting a body to contacts: Levenberg–Marquardt over the parameters of all its parts.

use std::iter::successors;

use nalgebra::{DMatrix, DVector, Matrix3};

use super::block::Block;
use super::regular::Regular;
use super::turned::Turned;
use super::{Body, Change, Mode, Part, Plane, Quadric};
use crate::model::Faces;
use crate::model::places::places;
use crate::reference::{Contact, Prior};
use crate::shape::superquadric::{Form, Superquadric};
use crate::space::Point;

/// What no body fits exactly: deviations added to the contacts', of the point in multiples of the
/// object's radius and of the normal in radians.
pub(crate) const MISFIT: (f64, f64) = (0.02, 0.1);

/// Standard deviation of a body's parameters before any contact, in radii and inverse radii of the
/// ball about it; a plane's direction is anybody's guess.
pub(super) const SHAPE: f64 = 0.7;
const DIRECTION: f64 = 1.0;

/// Steps of one fit, and of one trial of a cut.
pub(super) const STEPS: usize = 20;
pub(super) const TRIAL: usize = 6;

/// Most planes that cut a quadric.
const CUTS: usize = 6;

/// Numbers measured per parameter from which a cut quadric is more than a guess; a quadric, which
/// leaves less open; and a superquadric, whose sizes and exponents are held to likely ones from the
/// start.
const DECIDED: f64 = 2.5;
const DECIDED_QUADRIC: f64 = 2.0;
const DECIDED_SUPERQUADRIC: f64 = 1.35;

/// Sides that are doubtful, per contact, up to which planes are: felt once or not at all.
const DOUBTFUL: f64 = 0.5;

/// Probability that contacts leave so large a part bare below which a side was missed there.
const EVEN: f64 = 0.4;

/// Corners of one body that are cut off at most.
const BLUNTED: usize = 3;

/// Difference of a parameter for its slope.
const NUDGE: f64 = 1e-5;

/// What a body is begun with.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Round {
    /// Centre and inverse radius.
    Ball,
    /// Centre and lower triangle of the root of A.
    Quadric,
    /// Between ends square to an axis.
    Turned(Turned),
    /// Sides square to each other.
    Block(Block),
    /// Equal sides about an axis.
    Regular(Regular),
    /// Planes alone.
    Nothing,
}

/// Parameters in radii about the ball's centre: of the round part, then normal and offset of each
/// plane.
#[derive(Clone)]
pub(super) struct Fit {
    round: Round,
    parameters: DVector<f64>,
    pub(super) cost: f64,
}

pub(super) struct Felt {
    pub(super) point: Point,
    pub(super) normal: Option<Point>,
    /// 1/deviation of the point and of the normal, with what no body fits and without.
    weights: (f64, f64),
    exact: (f64, f64),
}

/// Contacts in radii about the centre of the ball that fits them.
pub(super) struct Problem {
    dimension: usize,
    centre: Point,
    radius: f64,
    felt: Vec<Felt>,
    /// That were touched ([`places`]).
    places: usize,
}

impl Body {
    /// The ball of [`Prior::fitted`], taken as certain: a ball that few contacts on a long object
    /// are free to move grows far beyond it. `None` without contacts.
    pub fn ball(dimension: usize, contacts: &[Contact]) -> Option<Body> {
        Some(Body { modes: vec![], ..Body::doubtful_ball(dimension, contacts)? })
    }

    /// The same with centre and radius open: what may lie where nobody touched. `None` without
    /// contacts.
    pub fn doubtful_ball(dimension: usize, contacts: &[Contact]) -> Option<Body> {
        let problem = Problem::of(dimension, contacts)?;
        problem.body(&problem.start(Round::Ball))
    }

    /// The quadric that fits best: least squares of distances and normals, with a weak pull to the
    /// ball. `None` without contacts, or when fewer than two numbers were measured per parameter: few
    /// contacts fit any.
    pub fn quadric(dimension: usize, contacts: &[Contact]) -> Option<Body> {
        let problem = Problem::of(dimension, contacts)?;
        let fit = problem.climb(problem.start(Round::Quadric), STEPS);
        let parameters = fit.parameters.len() as f64;
        if (problem.measured() as f64) < DECIDED_QUADRIC * parameters {
            return None;
        }
        Some(problem.body(&fit)?.closed(dimension, contacts, &[]))
    }

    /// The quadric cut by those of the `faces` that pay for their parameters (by the Bayesian
    /// information criterion), all fitted together. `None` without contacts, when no cut pays, or
    /// when fewer than two and a half numbers were measured per parameter: where a cut quadric ends away from
    /// the contacts is then a guess.
    pub fn cut(dimension: usize, contacts: &[Contact], faces: &Faces) -> Option<Body> {
        let problem = Problem::of(dimension, contacts)?;
        let mut best = problem.climb(problem.start(Round::Quadric), STEPS);
        let price = dimension as f64 * ((contacts.len() * dimension) as f64).ln();
        let mut left = problem.planes(faces, 2);
        let whole = best.parameters.len();
        for _ in 0..CUTS {
            let tried = left.iter().map(|plane| problem.climb(best.cut(dimension, plane), TRIAL));
            let Some((index, fit)) = tried.enumerate().min_by(|a, b| a.1.cost.total_cmp(&b.1.cost))
            else {
                break;
            };
            if fit.cost + price >= best.cost {
                break;
            }
            left.remove(index);
            best = problem.climb(fit, STEPS);
        }
        if best.parameters.len() == whole {
            return None;
        }
        let measured = problem.measured() as f64;
        let decided = |body: &Body| measured >= DECIDED * (measured - body.degrees);
        problem.body(&best).filter(decided).map(|body| body.closed(dimension, contacts, &[]))
    }

    /// The superquadric that fits best. `None` where [`Superquadric::fit`] finds none, or when fewer
    /// than 1.35 numbers were measured per parameter: five contacts with normals measure more.
    pub fn superquadric(dimension: usize, contacts: &[Contact]) -> Option<Body> {
        let found = Superquadric::fit(dimension, contacts).ok()?;
        let parameters = found.neighbours().len() as f64;
        if found.misfit().degrees < (DECIDED_SUPERQUADRIC - 1.0) * parameters {
            return None;
        }
        let mode = |(more, less, scale): (Form, Form, f64)| {
            Mode::of(0, Part::Superquadric(more), Part::Superquadric(less), scale)
        };
        let misfit = found.misfit();
        let body = Body {
            parts: vec![Part::Superquadric(found.form())],
            modes: found.neighbours().into_iter().map(mode).collect(),
            oddity: misfit.oddity,
            chi_squared: misfit.chi_squared,
            degrees: misfit.degrees,
        };
        Some(body.closed(dimension, contacts, &found.undecided()))
    }

    /// The polytope of all `faces`, with ends where they leave it open, and the same with planes across the
    /// corners where a side was probably missed, one more in each. None without contacts or faces. Nor,
    /// where it has such ends, or fewer than two and a half numbers were measured per parameter, when more
    /// than one side for every two contacts is in doubt: felt by one that no other face confirms
    /// ([`Faces::unconfirmed`]), or not at all. Then there may as well be others: the share of what was
    /// seen once tells how likely the next is new (Good, Biometrika 40, 1953). Nor, there, where contacts
    /// would hardly have left so large a part of it bare. Where one is refused, none with more cuts is believed.
    pub fn polytopes(dimension: usize, contacts: &[Contact], faces: &Faces) -> Vec<Body> {
        let unconfirmed = faces.unconfirmed(contacts).len();
        let are_doubtful = |sides: usize| sides as f64 > DOUBTFUL * contacts.len() as f64;
        // As many sides take more than half of the numbers that were measured: they are not decided either.
        if are_doubtful(unconfirmed) {
            return vec![];
        }
        let Some((body, ends)) = Body::flat(dimension, contacts, faces) else { return vec![] };
        let Some(problem) = Problem::of(dimension, contacts) else { return vec![] };
        let measured = problem.measured() as f64;
        let is_decided = ends == 0 && measured >= DECIDED * (measured - body.degrees);
        let is_doubtful = |guessed: usize, body: &Body| {
            are_doubtful(guessed + unconfirmed) || body.evenness(dimension, contacts) < EVEN
        };
        let is_trusted = |guessed: usize, body: &Body| is_decided || !is_doubtful(guessed, body);
        successors(Some(body), |body| body.blunted(dimension, contacts))
            .take(1 + BLUNTED)
            .enumerate()
            .take_while(|(blunted, body)| is_trusted(ends + blunted, body))
            .map(|(_, body)| body)
            .collect()
    }

    /// The polytope of all `faces` however doubtful, and how many of its sides are ends that nobody felt.
    pub fn flat(dimension: usize, contacts: &[Contact], faces: &Faces) -> Option<(Body, usize)> {
        let problem = Problem::of(dimension, contacts)?;
        let planes = problem.planes(faces, 1);
        let start = problem.start(Round::Nothing);
        let body = problem.body(&planes.iter().fold(start, |fit, plane| fit.cut(dimension, plane)));
        let body = body?.closed(dimension, contacts, &[]);
        let guessed = body.parts.len() - planes.len();
        Some((body, guessed))
    }
}

impl Fit {
    pub(super) fn begun(round: Round, parameters: DVector<f64>) -> Fit {
        Fit { round, parameters, cost: f64::INFINITY }
    }

    pub(super) fn parameters(&self) -> &DVector<f64> {
        &self.parameters
    }

    /// How many of the parameters are the round part's.
    fn round_parameters(&self, dimension: usize) -> usize {
        match self.round {
            Round::Ball => dimension + 1,
            Round::Quadric => dimension * (dimension + 3) / 2,
            Round::Turned(turned) => turned.count(),
            Round::Block(block) => block.count(),
            Round::Regular(regular) => regular.count(),
            Round::Nothing => 0,
        }
    }

    fn cut(&self, dimension: usize, plane: &Plane) -> Fit {
        let normal = plane.normal.iter().take(dimension);
        let parameters = self.parameters.iter().chain(normal).chain([&plane.offset]);
        let parameters = DVector::from_vec(parameters.copied().collect());
        Fit { parameters, ..*self }
    }
}

impl Problem {
    pub(super) fn of(dimension: usize, contacts: &[Contact]) -> Option<Problem> {
        let Prior::Ball { centre, radius } = Prior::fitted(contacts)? else { return None };
        let weight = |deviation: f64, misfit: f64| deviation.hypot(misfit).recip();
        let felt = contacts.iter().map(|c| Felt {
            point: (c.point - centre) / radius,
            normal: c.normal,
            weights: (
                weight(c.point_deviation / radius, MISFIT.0),
                weight(c.normal_deviation, MISFIT.1),
            ),
            exact: (weight(c.point_deviation / radius, 0.0), weight(c.normal_deviation, 0.0)),
        });
        let places = places(contacts);
        Some(Problem { dimension, centre, radius, felt: felt.collect(), places })
    }

    pub(super) fn dimension(&self) -> usize {
        self.dimension
    }

    pub(super) fn felt(&self) -> &[Felt] {
        &self.felt
    }

    /// Contacts that say how large the surface is.
    pub(super) fn places(&self) -> usize {
        self.places
    }

    pub(super) fn radius(&self) -> f64 {
        self.radius
    }

    /// A plane, its offset in radii, in metres.
    pub(super) fn placed_plane(&self, normal: Point, offset: f64) -> Option<Plane> {
        match self.placed(&Part::Plane(Plane { normal, offset }))? {
            Part::Plane(plane) => Some(plane),
            _ => None,
        }
    }

    /// Numbers that the contacts measured: normals have one less than they have axes.
    pub(super) fn measured(&self) -> usize {
        self.felt.iter().map(|f| if f.normal.is_some() { self.dimension } else { 1 }).sum()
    }

    /// The same with the contacts' own deviations.
    fn exact(&self) -> Problem {
        let felt = self.felt.iter().map(|f| Felt { weights: f.exact, ..*f }).collect();
        Problem { felt, ..*self }
    }

    fn start(&self, round: Round) -> Fit {
        let d = self.dimension;
        let mut parameters = vec![0.0; d];
        match round {
            Round::Ball => parameters.push(1.0),
            Round::Quadric => {
                for row in 0..d {
                    parameters.extend((0..=row).map(|c| if row == c { 1.0 } else { 0.0 }));
                }
            }
            Round::Turned(turned) => parameters = turned.usual().as_slice().to_vec(),
            Round::Block(block) => parameters = block.usual().as_slice().to_vec(),
            Round::Regular(regular) => parameters = regular.usual().as_slice().to_vec(),
            Round::Nothing => parameters.clear(),
        }
        Fit::begun(round, DVector::from_vec(parameters))
    }

    /// The faces with at least so many contacts.
    fn planes(&self, faces: &Faces, least: usize) -> Vec<Plane> {
        let plane = |f: &crate::model::faces::Face| Plane {
            normal: f.normal,
            offset: (f.offset - f.normal.dot(&self.centre)) / self.radius,
        };
        faces.faces.iter().filter(|f| f.contacts >= least).map(plane).collect()
    }

    /// The parts that parameters stand for, in radii; `None` where they stand for nothing.
    fn parts(&self, fit: &Fit, parameters: &DVector<f64>) -> Option<Vec<Part>> {
        let d = self.dimension;
        let axes = |from: usize| {
            Point::from_fn(|axis, _| if axis < d { parameters[from + axis] } else { 0.0 })
        };
        let mut parts = Vec::new();
        match fit.round {
            Round::Ball if parameters[d] > 0.0 => {
                let radius = parameters[d].recip();
                parts.push(Part::Prior(Prior::Ball { centre: axes(0), radius }));
            }
            Round::Ball => return None,
            Round::Quadric => {
                let mut root = Matrix3::zeros();
                let mut at = d;
                for row in 0..d {
                    for column in 0..=row {
                        root[(row, column)] = parameters[at];
                        at += 1;
                    }
                }
                parts.push(Part::Quadric(Quadric::new(axes(0), root * root.transpose())?));
            }
            Round::Turned(turned) => parts = turned.parts(parameters)?,
            Round::Block(block) => parts = block.parts(parameters),
            Round::Regular(regular) => parts = regular.parts(parameters)?,
            Round::Nothing => {}
        }
        for at in (fit.round_parameters(d)..parameters.len()).step_by(d + 1) {
            let normal = axes(at).try_normalize(1e-9)?;
            parts.push(Part::Plane(Plane { normal, offset: parameters[at + d] }));
        }
        (!parts.is_empty()).then_some(parts)
    }

    /// The same part in metres.
    fn placed(&self, part: &Part) -> Option<Part> {
        let moved = |p: &Point| self.centre + p * self.radius;
        Some(match part {
            Part::Prior(Prior::Ball { centre, radius }) => {
                Part::Prior(Prior::Ball { centre: moved(centre), radius: radius * self.radius })
            }
            Part::Prior(_) | Part::Superquadric(_) => return None,
            Part::Quadric(q) => Part::Quadric(Quadric::tapered(
                moved(&q.centre),
                q.form / self.radius.powi(2),
                q.taper / self.radius,
            )?),
            Part::Plane(p) => Part::Plane(Plane {
                normal: p.normal,
                offset: p.offset * self.radius + p.normal.dot(&self.centre),
            }),
        })
    }

    pub(super) fn body(&self, fit: &Fit) -> Option<Body> {
        let placed = |parameters: &DVector<f64>| -> Option<Vec<Part>> {
            self.parts(fit, parameters)?.iter().map(|part| self.placed(part)).collect()
        };
        let round = fit.round_parameters(self.dimension);
        let mode = |j: usize| {
            let moved = |by: f64| {
                let mut parameters = fit.parameters.clone();
                parameters[j] += by;
                placed(&parameters)
            };
            let (more, less) = (moved(NUDGE)?, moved(-NUDGE)?);
            let change = |(part, (more, less))| Change { part, more, less };
            let changes = more.into_iter().zip(less).enumerate().map(change);
            let changes = changes.filter(|change| change.more != change.less).collect();
            let normal = j >= round && (j - round) % (self.dimension + 1) < self.dimension;
            let deviation = if normal { DIRECTION } else { SHAPE };
            Some(Mode { changes, scale: deviation / (2.0 * NUDGE), moved: 0.0 })
        };
        let modes = (0..fit.parameters.len()).map(mode).collect::<Option<_>>()?;
        let usual = self.start(fit.round).parameters;
        let pull = |parameters: &DVector<f64>| -> f64 {
            usual.iter().zip(parameters).map(|(u, p)| ((p - u) / SHAPE).powi(2)).sum()
        };
        let oddity = 0.5 * pull(&fit.parameters);
        // With the contacts' own weights.
        let exact = self.exact().climb(fit.clone(), TRIAL);
        let planes = (fit.parameters.len() - round) / (self.dimension + 1);
        let idle = if let Round::Turned(_) = fit.round { Turned::IDLE } else { 0 };
        let degrees = self.measured() as f64 - (round - idle + self.dimension * planes) as f64;
        let parts = placed(&fit.parameters)?;
        let chi_squared = exact.cost - pull(&exact.parameters);
        Some(Body { parts, modes, oddity, chi_squared, degrees })
    }

    /// Standardised residuals: per contact the body's value, and the normal's difference from the
    /// part that suits the contact best; then the pull to the ball.
    fn residuals(&self, fit: &Fit, parameters: &DVector<f64>) -> Option<DVector<f64>> {
        let parts = self.parts(fit, parameters)?;
        let mut residuals = Vec::with_capacity(self.felt.len() * (self.dimension + 1) + 9);
        for felt in &self.felt {
            let (value, turn) = felt.weights;
            let (mut most, mut own) = (f64::NEG_INFINITY, (f64::INFINITY, Point::zeros()));
            for (v, gradient) in parts.iter().map(|part| part.at(&felt.point)) {
                most = most.max(v);
                let Some(n) = felt.normal else { continue };
                let off = gradient - n;
                let cost = (v * value).powi(2) + off.norm_squared() * turn * turn;
                if cost < own.0 {
                    own = (cost, off);
                }
            }
            residuals.push(most * value);
            if felt.normal.is_some() {
                residuals.extend((0..self.dimension).map(|axis| own.1[axis] * turn));
            }
        }
        let usual = self.start(fit.round).parameters;
        residuals.extend(usual.iter().zip(parameters).map(|(u, p)| (p - u) / SHAPE));
        Some(DVector::from_vec(residuals))
    }

    pub(super) fn climb(&self, start: Fit, steps: usize) -> Fit {
        let mut fit = start;
        let Some(mut residuals) = self.residuals(&fit, &fit.parameters) else { return fit };
        fit.cost = residuals.norm_squared();
        let n = fit.parameters.len();
        let mut damping = 1e-3;
        for _ in 0..steps {
            let mut jacobian = DMatrix::zeros(residuals.len(), n);
            for j in 0..n {
                let mut moved = fit.parameters.clone();
                moved[j] += NUDGE;
                let Some(there) = self.residuals(&fit, &moved) else { return fit };
                jacobian.set_column(j, &((there - &residuals) / NUDGE));
            }
            let (square, slope) = (jacobian.tr_mul(&jacobian), jacobian.tr_mul(&residuals));
            let mut better = None;
            for _ in 0..6 {
                let mut damped = square.clone();
                for j in 0..n {
                    damped[(j, j)] += damping * (1.0 + square[(j, j)]);
                }
                let tried = damped.cholesky().and_then(|factor| {
                    let parameters = &fit.parameters - factor.solve(&slope);
                    Some((self.residuals(&fit, &parameters)?, parameters))
                });
                if let Some((there, parameters)) = tried
                    && there.norm_squared() < fit.cost
                {
                    damping = (0.1 * damping).max(1e-9);
                    better = Some((there, parameters));
                    break;
                }
                damping *= 10.0;
            }
            let Some((there, parameters)) = better else { break };
            let gained = fit.cost - there.norm_squared();
            (residuals, fit.parameters) = (there, parameters);
            fit.cost = residuals.norm_squared();
            if gained < 1e-3 {
                break;
            }
        }
        fit
    }
}
