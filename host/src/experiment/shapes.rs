//! Every model of a shape on every object: the automatic choice beside its parts, the thesis' two
//! kernels (2.2) and the representations that the thesis reviews (2.1).

use std::fmt;
use std::path::Path;
use std::time::Instant;

use rayon::prelude::*;
use serde::Serialize;

use crate::experiment::Spread;
use crate::experiment::model::Model;
use crate::experiment::proportion::Proportion;
use crate::quantity::Deviation;
use crate::reference::Contact;
use crate::shape::cloud::Cloud;
use crate::shape::{Geometry, align, metrics};
use crate::sim::{ObjectSpec, Options, SimError, Touch, simulate};
use crate::slam::choose::Choice;
use crate::slam::{reconstruct, track};

/// Objects that need no file.
const OBJECTS: [&str; 12] = [
    "rectangle:0.12x0.06",
    "ellipse:0.12x0.06",
    "hexagon:0.045",
    "triangle:0.06",
    "lshape:0.09x0.09x0.035",
    "tshape:0.09x0.09x0.03",
    "box:0.12x0.06x0.06",
    "cylinder:0.06x0.1",
    "sphere:0.08",
    "ellipsoid:0.12x0.08x0.06",
    "lshape:0.09x0.09x0.035x0.05",
    "tshape:0.09x0.09x0.03x0.05",
];

/// Contacts of a planar and of a spatial object.
const PLANAR_CONTACTS: [usize; 6] = [5, 10, 15, 20, 40, 60];
const SPATIAL_CONTACTS: [usize; 7] = [5, 10, 15, 20, 40, 80, 200];

/// In the table's order.
const MODELS: [Model; 9] = [
    Model::Auto,
    Model::Gp,
    Model::Faces,
    Model::SquaredExponential,
    Model::ThinPlate,
    Model::Superquadric,
    Model::Nagata,
    Model::Occupancy,
    Model::Cloud,
];

/// The thesis' own.
const THESIS: [Model; 2] = [Model::SquaredExponential, Model::ThinPlate];

/// Which part of the comparison to run.
#[derive(Clone, Debug, PartialEq)]
pub struct Selection {
    /// Only objects whose name holds one of these; one that matches none is an object of its own.
    /// All where empty.
    pub objects: Vec<String>,
    /// Only these numbers of contacts; the usual ones where empty.
    pub contacts: Vec<usize>,
    /// Only these models, and [`Model::Auto`], in the table's order; all where empty.
    pub models: Vec<Model>,
    /// Of contact points and normals.
    pub noise: Deviation,
    /// Which part of the contacts is wild, 0 to 1.
    pub outliers: f64,
    /// Runs of each case.
    pub seeds: u64,
    /// The first of the seeds.
    pub first_seed: u64,
}

impl Selection {
    fn models(&self) -> Vec<Model> {
        let is_wanted =
            |m: &Model| self.models.is_empty() || *m == Model::Auto || self.models.contains(m);
        MODELS.into_iter().filter(is_wanted).collect()
    }
}

/// No model of the comparison has that name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected {}", MODELS.map(option).join(", "))]
pub struct UnknownModel;

/// The model that the command line calls so.
///
/// # Errors
/// When there is none.
pub fn model(text: &str) -> Result<Model, UnknownModel> {
    MODELS.into_iter().find(|m| option(*m) == text).ok_or(UnknownModel)
}

/// A model's name in lower case without spaces.
fn option(model: Model) -> String {
    model.name().to_ascii_lowercase().replace(' ', "-")
}

/// One model's distances from the truth on one row.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Cell {
    /// Its name.
    pub model: &'static str,
    /// Runs that gave a shape, of how many.
    pub runs: (usize, usize),
    /// After the best rigid alignment, millimetres (thesis C.1).
    pub hausdorff_mm: Option<Spread>,
    /// Mean distance between the surfaces both ways, at that alignment, millimetres.
    pub mean_mm: Option<Spread>,
    /// Root mean square distance likewise.
    pub rms_mm: Option<Spread>,
    /// Of the runs in which both gave a shape, those in which `auto` has the smaller Hausdorff distance:
    /// where half of them is within the interval, neither is known to be better.
    pub auto_closer: Proportion,
}

/// One object with one number of contacts.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// As the simulator has it; `ycb/` and a name for a file.
    pub object: String,
    /// How many.
    pub contacts: usize,
    /// One for each model.
    pub cells: Vec<Cell>,
    /// Of the runs of `auto` that gave a shape, the fraction that were not the Gaussian process
    /// alone.
    pub chosen: Option<f64>,
    /// The whole row took so long, seconds.
    pub seconds: f64,
}

/// The table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Noise and seeds.
    pub title: String,
    /// One per case.
    pub rows: Vec<Row>,
    /// Over these rows, spreads of their medians; `None` of a single one.
    pub overall: Option<Row>,
    /// What was left out and why.
    pub skipped: Vec<String>,
}

/// An object and what to call it.
struct Case {
    name: String,
    spec: ObjectSpec,
}

/// Compares the models on what is selected; meshes come from `data`/ycb. `done` is told each row as
/// soon as there is one.
///
/// # Errors
/// When an object does not exist or cannot be simulated.
pub fn run(
    data: Option<&Path>,
    selection: &Selection,
    mut done: impl FnMut(&Row),
) -> Result<Comparison, SimError> {
    let (cases, skipped) = cases(data, &selection.objects)?;
    let mut rows = Vec::new();
    for case in &cases {
        let truth = case.spec.geometry()?;
        let usual: &[usize] =
            if truth.dimension() == 2 { &PLANAR_CONTACTS } else { &SPATIAL_CONTACTS };
        let counts = if selection.contacts.is_empty() { usual } else { &selection.contacts };
        for contacts in counts {
            let row = compare(case, &truth, *contacts, selection)?;
            done(&row);
            rows.push(row);
        }
    }
    let Selection { noise, outliers, seeds, first_seed, .. } = selection;
    let wild = match outliers {
        0.0 => String::new(),
        part => format!(", {:.0} % wild", 100.0 * part),
    };
    let title = format!(
        "Shapes at known poses, uniform contacts, noise {noise}{wild}, seeds {first_seed} to {}",
        first_seed.saturating_add(*seeds).saturating_sub(1)
    );
    let overall = (rows.len() > 1).then(|| overall(&rows, &selection.models()));
    Ok(Comparison { title, rows, overall, skipped })
}

fn cases(data: Option<&Path>, wanted: &[String]) -> Result<(Vec<Case>, Vec<String>), SimError> {
    let mut cases = Vec::new();
    for object in OBJECTS {
        cases.push(Case { name: object.into(), spec: object.parse()? });
    }
    let folder = data.map(|d| d.join("ycb"));
    let listed = folder.and_then(|f| std::fs::read_dir(f).ok()).into_iter().flatten().flatten();
    let mut meshes: Vec<_> = listed.map(|entry| entry.path()).collect();
    meshes.retain(|path| path.extension().is_some_and(|e| e == "ply"));
    meshes.sort();
    let mut skipped = Vec::new();
    if meshes.is_empty() && (wanted.is_empty() || wanted.iter().any(|w| w.starts_with("ycb"))) {
        skipped.push("YCB meshes: none in $TACTILE_DATA/ycb".into());
    }
    for path in meshes {
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        cases.push(Case { name: format!("ycb/{name}"), spec: ObjectSpec::Mesh(path) });
    }
    if wanted.is_empty() {
        return Ok((cases, skipped));
    }
    let mut others = Vec::new();
    for text in wanted.iter().filter(|w| !w.starts_with("ycb")) {
        if !cases.iter().any(|c| c.name.contains(text.as_str())) {
            others.push(Case { name: text.clone(), spec: text.parse()? });
        }
    }
    cases.retain(|c| wanted.iter().any(|w| c.name.contains(w.as_str())));
    cases.extend(others);
    Ok((cases, skipped))
}

/// What one seed gave: distances of each model, and whether `auto` took more than the Gaussian
/// process.
struct Run {
    distances: Vec<Option<metrics::Distances>>,
    chosen: Option<bool>,
}

fn compare(
    case: &Case,
    truth: &Geometry,
    contacts: usize,
    selection: &Selection,
) -> Result<Row, SimError> {
    let start = Instant::now();
    let options = Options {
        grasps: Some(1),
        contacts,
        touch: Touch::Uniform,
        contact_noise: selection.noise,
        outliers: selection.outliers,
        ..Options::new(case.spec.clone())
    };
    let seeds = selection.first_seed..selection.first_seed.saturating_add(selection.seeds);
    let models = selection.models();
    let runs: Vec<Run> = seeds
        .into_par_iter()
        .map(|seed| one(truth, &models, &Options { seed, ..options.clone() }))
        .collect::<Result<_, _>>()?;
    let auto = models.iter().position(|m| *m == Model::Auto);
    let cells = models.iter().enumerate().map(|(i, model)| {
        let closer = |r: &Run| Some(r.distances[auto?]?.hausdorff < r.distances[i]?.hausdorff);
        let got: Vec<_> = runs.iter().filter_map(|r| r.distances[i]).collect();
        let spread = |f: fn(&metrics::Distances) -> f64| Spread::of(got.iter().map(|d| 1e3 * f(d)));
        Cell {
            model: model.name(),
            runs: (got.len(), runs.len()),
            hausdorff_mm: spread(|d| d.hausdorff),
            mean_mm: spread(|d| d.mean),
            rms_mm: spread(|d| d.rms),
            auto_closer: Proportion::of(runs.iter().filter_map(closer)),
        }
    });
    let chosen: Vec<bool> = runs.iter().filter_map(|r| r.chosen).collect();
    let more = chosen.iter().filter(|c| **c).count() as f64;
    Ok(Row {
        object: case.name.clone(),
        contacts,
        cells: cells.collect(),
        chosen: (!chosen.is_empty()).then(|| more / chosen.len() as f64),
        seconds: start.elapsed().as_secs_f64(),
    })
}

/// What the rows have in common: how each model does on objects of all kinds.
fn overall(rows: &[Row], models: &[Model]) -> Row {
    let cells = models.iter().map(|model| {
        let cells = || rows.iter().filter_map(|row| row.cell(model.name()));
        let medians = |spread: fn(&Cell) -> Option<Spread>| {
            Spread::of(cells().filter_map(spread).map(|s| s.median))
        };
        Cell {
            model: model.name(),
            runs: cells().fold((0, 0), |sum, c| (sum.0 + c.runs.0, sum.1 + c.runs.1)),
            hausdorff_mm: medians(|c| c.hausdorff_mm),
            mean_mm: medians(|c| c.mean_mm),
            rms_mm: medians(|c| c.rms_mm),
            auto_closer: cells().map(|c| c.auto_closer).sum(),
        }
    });
    let chosen: Vec<f64> = rows.iter().filter_map(|r| r.chosen).collect();
    Row {
        object: format!("all {} rows", rows.len()),
        contacts: rows.iter().map(|r| r.contacts).sum(),
        cells: cells.collect(),
        chosen: (!chosen.is_empty()).then(|| chosen.iter().sum::<f64>() / chosen.len() as f64),
        seconds: rows.iter().map(|r| r.seconds).sum(),
    }
}

/// One simulation, and the models on the same contacts.
fn one(truth: &Geometry, models: &[Model], options: &Options) -> Result<Run, SimError> {
    let simulation = simulate(options)?;
    let dimension = simulation.log.dimension;
    let steps = track::truth(&simulation.log).unwrap_or_default();
    let placed = crate::slam::place::place(&simulation.log, &steps);
    let contacts: Vec<Contact> = placed.iter().map(|p| p.contact).collect();
    let judge = |shape: Option<Geometry>| {
        let shape = shape?;
        metrics::compare_at(&shape, &align::align(&shape, truth), truth)
    };
    let auto = reconstruct::shape(
        dimension,
        &contacts,
        &[],
        reconstruct::Poses::Known,
        Choice::Auto,
        &|_, _| {},
    )
    .ok();
    let chosen = auto.as_ref().map(|auto| auto.model.name() != Model::Gp.name());
    let auto = judge(auto.map(|auto| auto.geometry));
    let distances = models.iter().map(|model| match model {
        Model::Auto => auto,
        // The same surface again.
        Model::Gp if chosen == Some(false) => auto,
        Model::Cloud => Cloud::new(contacts.iter().map(|c| c.point)).compare(truth),
        model => judge(model.reconstruct(dimension, &contacts).map(|s| s.geometry)),
    });
    Ok(Run { distances: distances.collect(), chosen })
}

impl Row {
    fn cell(&self, name: &str) -> Option<&Cell> {
        self.cells.iter().find(|c| c.model == name)
    }

    fn auto(&self) -> Option<f64> {
        Some(self.cell(Model::Auto.name())?.hausdorff_mm?.median)
    }

    /// The other model with the least median Hausdorff distance, millimetres, among those with
    /// `names` that gave as many shapes as `auto`: fewer would be the easier ones.
    fn best(&self, names: impl Fn(&str) -> bool) -> Option<(&Cell, f64)> {
        let runs = self.cell(Model::Auto.name())?.runs.0;
        let rivals = self.cells.iter().filter(|c| c.model != Model::Auto.name() && names(c.model));
        rivals
            .filter(|c| c.runs.0 >= runs)
            .filter_map(|c| Some((c, c.hausdorff_mm?.median)))
            .min_by(|a, b| a.1.total_cmp(&b.1))
    }
}

/// Medians closer than this are equal, millimetres: the hundredth that is printed.
const EQUAL: f64 = 0.01;

impl Comparison {
    /// Of each model, the mean of the rows' medians: what rows cost on which a model fails.
    fn means(&self) -> String {
        let mean = |model: &Model| {
            let medians = self.rows.iter().filter_map(|r| r.cell(model.name())?.hausdorff_mm);
            let (sum, count) =
                medians.fold((0.0, 0.0), |(sum, count), m| (sum + m.median, count + 1.0));
            if count > 0.0 { format!("{:.1}", sum / count) } else { "–".into() }
        };
        let compared =
            MODELS.iter().filter(|m| self.rows.iter().any(|r| r.cell(m.name()).is_some()));
        compared.map(|m| format!("{:<25}", mean(m))).collect()
    }

    /// Rows on which another of the models with `names` has a smaller median than `auto`, in words, and on
    /// how many of their seeds `auto` is the closer one.
    fn beaten(&self, names: impl Fn(&str) -> bool + Copy) -> Vec<String> {
        let beaten = self.rows.iter().filter_map(|row| {
            let (rival, best) = row.best(names)?;
            let auto = row.auto().unwrap_or(f64::INFINITY);
            (auto > best + EQUAL).then(|| {
                let Row { object, contacts, .. } = row;
                let Cell { model, auto_closer, .. } = rival;
                format!(
                    "{object} with {contacts}: {auto:.2} mm, {model} {best:.2} mm; auto closer in \
                     {auto_closer} of the runs"
                )
            })
        });
        beaten.collect()
    }
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // An object's corners need not be read out.
        let object: String = self.object.chars().take(27).collect();
        write!(f, "  {object:<28}{:>4}  ", self.contacts)?;
        for cell in &self.cells {
            let (got, of) = cell.runs;
            let runs = if got == of { String::new() } else { format!(" {got}/{of}") };
            let text = cell.hausdorff_mm.map_or("–".to_owned(), |s| {
                format!("{:.1} [{:.1}, {:.1}]", s.median, s.low, s.high)
            });
            write!(f, "{:<25}", text + &runs)?;
        }
        let chosen = self.chosen.map_or("–".to_owned(), |c| format!("{:.0} %", 100.0 * c));
        write!(f, "{chosen:>6} {:>6.0} s", self.seconds)
    }
}

/// The line above the rows of these models.
pub fn heading(selection: &Selection) -> String {
    heading_of(selection.models().iter().map(Model::name))
}

fn heading_of<'a>(models: impl Iterator<Item = &'a str>) -> String {
    let names: String = models.map(|m| format!("{m:<25}")).collect();
    format!("  {:<28}{:>4}  {names}{:>6} {:>8}", "object", "n", "not gp", "time")
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let models = self.rows.first().map_or(&[][..], |r| &r.cells).iter().map(|c| c.model);
        writeln!(f, "{}\n{}", self.title, heading_of(models))?;
        for row in &self.rows {
            writeln!(f, "{row}")?;
        }
        if let Some(overall) = &self.overall {
            writeln!(f, "{overall}\n  {:<34}{}", "their mean", self.means())?;
        }
        writeln!(
            f,
            "  Hausdorff distance after the best rigid alignment, mm: median [quartiles], runs that \
             gave a shape of all\n  where some did not; not gp: auto took more than the Gaussian \
             process; the cloud is not aligned"
        )?;
        for skipped in &self.skipped {
            writeln!(f, "  skipped: {skipped}")?;
        }
        let any = |_: &str| true;
        let thesis = |name: &str| THESIS.iter().any(|m| m.name() == name);
        for (question, beaten) in [
            ("auto is not the best", self.beaten(any)),
            ("auto is worse than the better of the thesis' kernels", self.beaten(thesis)),
        ] {
            write!(f, "  {question} on {} of {} rows", beaten.len(), self.rows.len())?;
            for row in &beaten {
                write!(f, "\n    {row}")?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
