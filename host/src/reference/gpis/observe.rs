//! What contacts and readings teach a field: the rows of its covariance matrix.

use nalgebra::DMatrix;

use super::Error;
use crate::dense::Sites;
use crate::reference::{Contact, Mean, Normalisation, Spheres};
use crate::space::Point;

/// What each contact teaches the field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Training {
    /// Value 0 with variance σ_p² and, where there is a normal, the gradient equal to the normal
    /// with variance σ_θ² per axis.
    Derivative,
    /// Thesis 2.2.2: value 0 and, where there is a normal n, the values ±`distance` at
    /// p ± `distance`·n, all with variance σ_p².
    OffSurface {
        /// Metres.
        distance: f64,
    },
    /// Thesis 2.2.4: contacts between an enclosing sphere and one within, normalised: the kernel's
    /// lengths and amplitude are multiples of the contacts' [extent](Normalisation::extent).
    Spheres(Spheres),
}

/// The field's value at a point, known to a variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Where, metres.
    pub point: Point,
    /// f there, metres.
    pub value: f64,
    /// m².
    pub variance: f64,
}

impl Reading {
    /// What is wrong with it, if anything.
    fn check(&self) -> Result<(), &'static str> {
        if !self.point.iter().chain([&self.value]).all(|x| x.is_finite()) {
            return Err("a reading's point and value must be finite");
        }
        if !(self.variance > 0.0 && self.variance.is_finite()) {
            return Err("a reading's variance must be finite and positive");
        }
        Ok(())
    }
}

/// What of the field is observed or asked for.
#[derive(Clone, Copy, Debug)]
pub(in crate::reference) enum Part {
    Value,
    /// Derivative along this axis.
    Slope(usize),
}

/// One row of the covariance matrix.
#[derive(Clone, Copy, Debug)]
pub(in crate::reference) struct Observation {
    /// The contact it belongs to, counted from 0; readings and points of spheres count on.
    pub contact: usize,
    pub point: Point,
    pub part: Part,
    /// What was observed less the prior's.
    pub target: f64,
    pub variance: f64,
}

/// Rows being gathered: per contact its value, then its derivatives or off-surface values.
pub(super) struct Rows<'a> {
    dimension: usize,
    prior: &'a dyn Mean,
    pub observations: Vec<Observation>,
    /// The prior's modes at each row, row after row.
    felt: Vec<f64>,
}

impl<'a> Rows<'a> {
    /// What `contacts` and then `readings` teach.
    ///
    /// # Errors
    /// When a number is unusable.
    pub fn of(
        dimension: usize,
        prior: &'a dyn Mean,
        training: Training,
        contacts: &[Contact],
        readings: &[Reading],
    ) -> Result<Self, Error> {
        let offset = training.offset(contacts)?;
        let mut rows = Rows { dimension, prior, observations: Vec::new(), felt: Vec::new() };
        for (index, contact) in contacts.iter().enumerate() {
            contact.check(dimension).map_err(|what| Error::Contact { index, what })?;
            rows.touch(index, contact, training == Training::Derivative);
            let Some(n) = contact.normal.map(|n| n.normalize()) else { continue };
            for d in offset.into_iter().flat_map(|d| [d, -d]) {
                rows.value(index, contact.point + n * d, d, contact.point_deviation.powi(2));
            }
        }
        rows.spheres(training, contacts);
        for (index, reading) in readings.iter().enumerate() {
            let index = contacts.len() + index;
            reading.check().map_err(|what| Error::Contact { index, what })?;
            rows.value(index, reading.point, reading.value, reading.variance);
        }
        Ok(rows)
    }

    /// The field's value at the contact itself, and with `sloped` its derivatives.
    fn touch(&mut self, index: usize, contact: &Contact, sloped: bool) {
        let point = contact.point;
        let row =
            |part, target, variance| Observation { contact: index, point, part, target, variance };
        let modes = self.prior.felt_modes(contact);
        let variance = contact.point_deviation.powi(2);
        self.observations.push(row(Part::Value, -self.prior.value(&point), variance));
        self.felt.extend(modes.iter().map(|mode| mode.0));
        if let Some(n) = contact.normal.filter(|_| sloped) {
            let target = n.normalize() - self.prior.felt(contact);
            let variance = contact.normal_deviation.powi(2);
            for axis in 0..self.dimension {
                self.observations.push(row(Part::Slope(axis), target[axis], variance));
                self.felt.extend(modes.iter().map(|mode| mode.1[axis]));
            }
        }
    }

    /// The field's value at any point.
    fn value(&mut self, contact: usize, point: Point, value: f64, variance: f64) {
        let target = value - self.prior.value(&point);
        self.observations.push(Observation { contact, point, part: Part::Value, target, variance });
        self.felt.extend(self.prior.modes(&point).iter().map(|mode| mode.0));
    }

    /// The points of [`Training::Spheres`].
    fn spheres(&mut self, training: Training, contacts: &[Contact]) {
        let Training::Spheres(spheres) = training else { return };
        let Some(normalisation) = Normalisation::of(contacts) else { return };
        let variance = normalisation.deviation.powi(2);
        for (point, value) in spheres.points(self.dimension, &normalisation) {
            self.value(contacts.len(), point, value, variance);
        }
    }

    /// The prior's modes at the rows, one a column.
    pub fn modes(&self) -> DMatrix<f64> {
        // As many at every point, also where there is no row.
        let count = self.prior.modes(&Point::zeros()).len();
        DMatrix::from_row_slice(self.observations.len(), count, &self.felt)
    }

    /// Where the rows are and what of the field they are.
    pub fn sites(&self) -> Sites {
        let mut sites = Sites::default();
        for o in &self.observations {
            let axis = match o.part {
                Part::Value => None,
                Part::Slope(axis) => Some(axis),
            };
            sites.push(o.point, axis);
        }
        sites
    }

    /// Largest distance between two training points, metres.
    pub fn diameter(&self) -> f64 {
        let mut largest: f64 = 0.0;
        for (i, a) in self.observations.iter().enumerate() {
            for b in &self.observations[..i] {
                largest = largest.max((a.point - b.point).norm_squared());
            }
        }
        largest.sqrt()
    }
}

impl Training {
    /// How far off the contacts the field is told its value, metres; `None` if it is not.
    ///
    /// # Errors
    /// When a number is unusable.
    fn offset(&self, contacts: &[Contact]) -> Result<Option<f64>, Error> {
        match *self {
            Training::Derivative => Ok(None),
            Training::OffSurface { distance } if distance > 0.0 && distance.is_finite() => {
                Ok(Some(distance))
            }
            Training::OffSurface { distance } => {
                Err(Error::Parameter { name: "off-surface distance", value: distance })
            }
            Training::Spheres(spheres) => {
                spheres.check()?;
                let extent = Normalisation::of(contacts).map(|normalisation| normalisation.extent);
                Ok(spheres.offset.zip(extent).map(|(share, extent)| share * extent))
            }
        }
    }
}

impl Contact {
    /// What is wrong with it, if anything.
    pub(crate) fn check(&self, dimension: usize) -> Result<(), &'static str> {
        let flat = |v: &Point| dimension == 3 || v.z == 0.0;
        if !(self.point.iter().all(|x| x.is_finite()) && flat(&self.point)) {
            return Err("the point must be finite, and z zero in the plane");
        }
        if let Some(n) = &self.normal
            && !((n.norm() - 1.0).abs() <= 1e-3 && flat(n))
        {
            return Err("the normal must have length 1 within 0.001, and z zero in the plane");
        }
        for deviation in [self.point_deviation, self.normal_deviation] {
            if !(deviation > 0.0 && deviation.is_finite()) {
                return Err("standard deviations must be finite and positive");
            }
        }
        Ok(())
    }
}
