//! Pictures of the sensing experiments.

use super::electrodes::{ALONG, AROUND, Place};
use super::{drift, electrodes, wrench};
use crate::sim::sensors::{FluidFinger, Skin};
use crate::view::curves::{self, Curve, Mark, Plot, Scale};
use crate::view::drawing::{Drawing, PictureError};
use crate::view::field::{self, Field, Fields};

impl wrench::Table {
    /// Error of point and normal against force, and whether the covariance is honest.
    ///
    /// # Errors
    /// When the picture cannot be made.
    pub fn picture(&self) -> Result<Drawing, PictureError> {
        let plot = |title: &str, up: &str, scale: Scale, value: fn(&wrench::Row) -> f64| {
            let mut curves: Vec<Curve> = Vec::new();
            for row in &self.rows {
                let readings = if row.window == 1 { "1 reading" } else { "8 readings" };
                let name = format!("{}, {readings}", row.skin);
                let v = value(row);
                let mark = Mark { x: row.newtons, low: v, median: v, high: v };
                match curves.iter_mut().find(|c| c.name == name) {
                    Some(curve) => curve.marks.push(mark),
                    None => curves.push(Curve { name, marks: vec![mark] }),
                }
            }
            Plot {
                title: title.into(),
                across: "normal force, N".into(),
                up: up.into(),
                scales: [Scale::Logarithmic, scale],
                curves,
            }
        };
        let error = "root mean square error";
        let logarithmic = Scale::Logarithmic;
        let mut plots = [
            plot("Contact point from a Nano17", &format!("{error}, mm"), logarithmic, |r| {
                r.point_mm
            }),
            plot("Its normal", &format!("{error}, °"), logarithmic, |r| r.normal_deg),
            plot("Its covariance", "mean normalised squared error", Scale::Linear, |r| r.squared),
        ];
        // Where the mean of as many squares of an honest covariance lies, 95 times in 100.
        let first = self.rows.first().map(|r| r.skin);
        let band = self.rows.iter().filter(|r| Some(r.skin) == first && r.window == 1);
        let band =
            band.map(|r| Mark { x: r.newtons, low: 2.0 - r.band, median: 2.0, high: 2.0 + r.band });
        let marks = band.collect();
        plots[2].curves.push(Curve { name: "two, and its 95 % band".into(), marks });
        curves::render(&plots)
    }
}

impl drift::Table {
    /// Errors, missed pushes and contacts out of nothing over the hour.
    ///
    /// # Errors
    /// When the picture cannot be made.
    pub fn picture(&self) -> Result<Drawing, PictureError> {
        let plot = |title: &str, up: &str, value: fn(&drift::Row) -> Option<f64>| {
            let mut curves: Vec<Curve> = Vec::new();
            for row in &self.rows {
                let Some(v) = value(row) else { continue };
                let followed = if row.followed { "followed" } else { "not followed" };
                let name = format!("{}, {followed}", row.case);
                let mark = Mark { x: row.minutes, low: v, median: v, high: v };
                match curves.iter_mut().find(|c| c.name == name) {
                    Some(curve) => curve.marks.push(mark),
                    None => curves.push(Curve { name, marks: vec![mark] }),
                }
            }
            Plot {
                title: title.into(),
                across: "minutes since the tare".into(),
                up: up.into(),
                scales: [Scale::Linear; 2],
                curves,
            }
        };
        curves::render(&[
            plot("Contacts of 1 N while the fingertip drifts", "root mean square error, mm", |r| {
                r.point_mm
            }),
            plot("Pushes that were not reported", "%", |r| Some(100.0 * r.missed)),
            plot("Readings of a free finger taken for a contact", "%", |r| Some(100.0 * r.felt)),
        ])
    }
}

impl electrodes::Table {
    /// Error over the unrolled skin, of both centroids and of the estimator.
    ///
    /// # Errors
    /// When the picture cannot be made.
    pub fn picture(&self) -> Result<Drawing, PictureError> {
        let row = self.rows.iter().find(|r| r.newtons == electrodes::MAPPED);
        let map = |title: &str, all: Option<f64>, value: fn(&Place) -> f64| Field {
            title: title.into(),
            note: all.map_or(String::new(), |v| format!("root mean square {v:.2} mm")),
            values: self.places.iter().map(|p| value(p) / 1e3).collect(),
        };
        let marks = FluidFinger::above().map(|point| {
            let (along, around) = Skin::BIOTAC.place(&point);
            [around.to_degrees(), 1e3 * along]
        });
        let fields = Fields {
            title: "Error of a contact of 1 N over the skin of a BioTac; rings: electrodes".into(),
            across: (
                "around the finger, °".into(),
                AROUND.0.to_degrees(),
                AROUND.1.to_degrees(),
                AROUND.2,
            ),
            down: ("along the skin from the tip, mm".into(), 1e3 * ALONG.0, 1e3 * ALONG.1, ALONG.2),
            marks: marks.into(),
            maps: vec![
                map("Centroid, thesis 2.24", row.map(|r| r.centroid_mm), |p| p.centroid_mm),
                map("Centroid of what rises", row.map(|r| r.rising_mm), |p| p.rising_mm),
                map("Corrected", row.map(|r| r.point_mm), |p| p.point_mm),
            ],
        };
        field::render(&fields)
    }
}
