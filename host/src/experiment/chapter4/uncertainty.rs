//! Figure 4.1: the variance of the surface, its entropy and the IGEF over a cube.

use std::f64::consts::{E, PI};
use std::fmt;

use rayon::prelude::*;
use serde::Serialize;

use super::{FigureError, touched};
use crate::experiment::Spread;
use crate::explore::Belief;
use crate::explore::criterion::igef_at;
use crate::explore::geodesic::Paths;
use crate::shape::Geometry;
use crate::sim::{Options, Touch};
use crate::space::Point;
use crate::view::drawing::Drawing;
use crate::view::sheet::{self, Panel, Sheet};

const CUBE: &str = "box:0.06x0.06x0.06";

/// Points of the estimated surface at which measures are compared.
const SAMPLES: usize = 600;

/// Paths over the surface shorter than the first are near a contact, longer than the second far from
/// all of them, metres.
const NEAR_AND_FAR: (f64, f64) = (0.015, 0.04);

const NAMES: [&str; 3] = ["standard deviation (4.7)", "entropy (4.10)", "IGEF (4.15)"];

/// How one measure ranks the points of the surface.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Measure {
    /// Which.
    pub measure: &'static str,
    /// Runs that made a surface, of how many.
    pub runs: (usize, usize),
    /// Spearman's correlation with the standard deviation.
    pub with_deviation: Option<Spread>,
    /// With the way over the surface to the nearest contact.
    pub with_way: Option<Spread>,
    /// With the true error of the surface.
    pub with_error: Option<Spread>,
    /// Mean rank, 0 to 1, of points within 15 mm of a contact over the surface.
    pub near: Option<Spread>,
    /// The same of points further than 40 mm.
    pub far: Option<Spread>,
}

fn options(seed: u64) -> Result<Options, FigureError> {
    let object = CUBE.parse().map_err(crate::sim::SimError::from)?;
    let usual = Options::new(object);
    Ok(Options { grasps: Some(1), contacts: 5, touch: Touch::Uniform, seed, ..usual })
}

/// The three measures at points of the estimated surface, in the order of [`NAMES`], and the way from
/// each to the nearest contact, metres.
fn measures(belief: &Belief, points: &[(Point, Point)]) -> ([Vec<f64>; 3], Vec<f64>) {
    let felt: Vec<Point> = belief.contacts.iter().map(|c| c.point).collect();
    let paths = Paths::new(&belief.geometry, &felt);
    let places: Vec<Point> = points.iter().map(|p| p.0).collect();
    let variances = belief.surface.variances(&places);
    let deviations = variances.iter().map(|v| v.sqrt()).collect();
    let entropies = variances.iter().map(|v| 0.5 * (2.0 * PI * E * v.max(1e-12)).ln()).collect();
    let gains = points.iter().map(|(p, n)| igef_at(belief, &paths, p, n)).collect();
    let ways = places.iter().map(|p| paths.to(p).map_or(f64::NAN, |to| to.1)).collect();
    ([deviations, entropies, gains], ways)
}

/// One row for each measure.
pub(super) fn measure(seeds: u64) -> Result<Vec<Measure>, FigureError> {
    options(0)?;
    let one = |seed| {
        let (belief, truth) = touched(&options(seed).ok()?).ok()?;
        let points = belief.geometry.samples(SAMPLES);
        let errors: Vec<f64> = points.iter().map(|(p, _)| truth.distance(p)).collect();
        let (values, ways) = measures(&belief, &points);
        let ranked = values.each_ref().map(|v| ranks(v));
        let [by_way, by_error] = [&ways, &errors].map(|v| ranks(v));
        let mean = |ranked: &[f64], part: &dyn Fn(f64) -> bool| {
            let of: Vec<f64> =
                ranked.iter().zip(&ways).filter(|(_, w)| part(**w)).map(|(r, _)| *r).collect();
            of.iter().sum::<f64>() / of.len() as f64 / ranked.len().max(1) as f64
        };
        let (near, far) = NEAR_AND_FAR;
        Some(ranked.each_ref().map(|r| {
            [
                correlation(r, &ranked[0]),
                correlation(r, &by_way),
                correlation(r, &by_error),
                mean(r, &|w| w < near),
                mean(r, &|w| w > far),
            ]
        }))
    };
    let runs: Vec<Option<[[f64; 5]; 3]>> = (0..seeds).into_par_iter().map(one).collect();
    let line = |m: usize| {
        let spread = |k: usize| Spread::of(runs.iter().flatten().map(|run| run[m][k]));
        Measure {
            measure: NAMES[m],
            runs: (runs.iter().flatten().count(), runs.len()),
            with_deviation: spread(0),
            with_way: spread(1),
            with_error: spread(2),
            near: spread(3),
            far: spread(4),
        }
    };
    Ok((0..3).map(line).collect())
}

/// The rank of each value from 0 on, equal ones sharing theirs.
fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let mut ranks = vec![0.0; values.len()];
    let mut start = 0;
    for group in order.chunk_by(|a, b| values[*a] == values[*b]) {
        let shared = start as f64 + (group.len() - 1) as f64 / 2.0;
        group.iter().for_each(|i| ranks[*i] = shared);
        start += group.len();
    }
    ranks
}

/// Pearson's correlation; not a number where one does not vary.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (x, y) = (mean(a), mean(b));
    let product = |u: &[f64], p: f64, v: &[f64], q: f64| -> f64 {
        u.iter().zip(v).map(|(s, t)| (s - p) * (t - q)).sum()
    };
    product(a, x, b, y) / (product(a, x, a, x) * product(b, y, b, y)).sqrt()
}

/// Seed 0 in the colours of each measure.
pub(super) fn picture(title: &str) -> Result<Drawing, FigureError> {
    let (belief, truth) = touched(&options(0)?)?;
    let vertices = match &belief.geometry {
        Geometry::Mesh(mesh) => mesh.vertices(),
        Geometry::Outline(_) => &[],
    };
    let slopes = belief.surface.gradients(vertices);
    let normal = |g: &Point| g.try_normalize(1e-9).unwrap_or_else(Point::z);
    let points: Vec<_> = vertices.iter().zip(&slopes).map(|(p, g)| (*p, normal(g))).collect();
    let (values, _) = measures(&belief, &points);
    let panels = values.into_iter().zip(NAMES).map(|(values, name)| {
        let low = values.iter().copied().fold(f64::INFINITY, f64::min);
        let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let note = match name {
            n if n == NAMES[0] => format!("{:.1} to {:.1} mm", 1e3 * low, 1e3 * high),
            n if n == NAMES[1] => format!("{low:.1} to {high:.1} nats"),
            _ => format!("{low:.2} to {high:.2}"),
        };
        Panel {
            title: name.into(),
            note,
            truth: truth.clone(),
            estimate: Some(belief.geometry.clone()),
            deviations: values.iter().map(|v| (v - low) / (high - low).max(1e-12)).collect(),
            contacts: belief.contacts.iter().map(|c| (c.point, c.normal)).collect(),
            groups: Vec::new(),
            links: Vec::new(),
        }
    });
    let sheet = Sheet { title: title.into(), columns: 3, panels: panels.collect() };
    Ok(sheet::render_shares(&sheet, "from least to greatest of each")?)
}

pub(super) fn show(f: &mut fmt::Formatter<'_>, lines: &[Measure]) -> fmt::Result {
    writeln!(
        f,
        "  {:<26}{:>7}  {:<22}{:<22}{:<22}{:<22}{:<22}",
        "measure",
        "runs",
        "with deviation",
        "with way to contact",
        "with true error",
        "rank near",
        "rank far"
    )?;
    let show = |s: &Option<Spread>| s.map_or("–".to_owned(), |s| s.to_string());
    for line in lines {
        writeln!(
            f,
            "  {:<26}{:>7}  {:<22}{:<22}{:<22}{:<22}{:<22}",
            line.measure,
            format!("{}/{}", line.runs.0, line.runs.1),
            show(&line.with_deviation),
            show(&line.with_way),
            show(&line.with_error),
            show(&line.near),
            show(&line.far)
        )?;
    }
    write!(
        f,
        "  median [quartiles] over seeds of Spearman's correlation over the surface, and of mean ranks \
         (0 to 1) within 15 mm of a contact and beyond 40 mm"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entropy_ranks_as_the_variance_does_and_igef_does_not() {
        let lines = measure(2).unwrap();
        assert_eq!(lines[0].runs, (2, 2));
        assert!((lines[1].with_deviation.unwrap().median - 1.0).abs() < 1e-9);
        assert!(lines[0].with_way.unwrap().median > 0.6);
        assert!(lines[2].with_way.unwrap().median < 0.5);
        assert!(lines[0].far.unwrap().median > lines[0].near.unwrap().median);
    }

    #[test]
    fn equal_values_share_their_rank() {
        assert_eq!(ranks(&[3.0, 1.0, 3.0, 2.0]), [2.5, 0.0, 2.5, 1.0]);
        let line = |k: f64| ranks(&[0.0, k, 2.0 * k]);
        assert_eq!(correlation(&line(1.0), &line(-1.0)), -1.0);
        assert!(correlation(&ranks(&[1.0, 1.0]), &ranks(&[1.0, 2.0])).is_nan());
    }
}
