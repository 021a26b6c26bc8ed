//! Real and simulated fingertip contacts on known objects, of a robot nobody here has.

use std::path::Path;
use std::time::Instant;

use serde::Serialize;

use super::Error;
use crate::experiment::Spread;
use crate::localize::contacts::{Fixed, read};
use crate::localize::{Localization, Settings, exhaustive, localize};
use crate::reference::Contact;
use crate::shape::Mesh;
use crate::shape::files::read_mesh;

/// Recordings of tacman's tactile-localization: contacts, model, and what is published or was found
/// elsewhere for them.
const RECORDINGS: [(&str, &str, &str); 6] = [
    (
        "measCylinder_exp",
        "cylinder",
        "memory unscented filter 8.85 mm in 4.9 s; scaling series 5.77 mm in 0.89 s; multi-start ICP 5.8 mm",
    ),
    ("measCleaner_exp", "cleaner", "multi-start ICP 7.1 mm"),
    ("measCleaner_sim", "cleaner", "–"),
    ("measBox100_sim", "box", "–"),
    ("measHelmet_sim", "helmet", "–"),
    ("measTetra30_sim", "tetrahedron", "–"),
];

/// Starts of the search that prunes nothing.
pub(super) const STARTS: usize = 20_000;

/// A run reaches the optimum when it costs no more than this above the best that is known, nats of
/// its own width.
const REACHED: f64 = 0.1;

/// One recording, localised with many seeds of the search.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Recorded {
    /// Of its file.
    pub name: String,
    /// How many.
    pub contacts: usize,
    /// Mean distance of the contacts from the surface, millimetres.
    pub mean_mm: Option<Spread>,
    /// From contacts and mesh to modes, seconds.
    pub seconds: Option<Spread>,
    /// Modes of the first seed.
    pub modes: usize,
    /// Directions that it cannot observe.
    pub unobservable: usize,
    /// Runs that reach the best optimum known, of how many.
    pub reached: (usize, usize),
    /// Mean distance at the best pose of a search without pruning, millimetres.
    pub exhaustive_mm: f64,
    /// What others report.
    pub reference: String,
}

/// All recordings in `data`/touch.
pub(super) fn run(
    data: Option<&Path>,
    seeds: u64,
    skipped: &mut Vec<String>,
) -> Result<Vec<Recorded>, Error> {
    let mut rows = Vec::new();
    for (name, model, reference) in RECORDINGS {
        let touch = data.map(|d| d.join("touch"));
        let files = touch.map(|t| {
            (t.join(format!("measurements/{name}.off")), t.join(format!("models/{model}.off")))
        });
        match files.filter(|(contacts, model)| contacts.is_file() && model.is_file()) {
            Some((contacts, model)) => {
                let (_, contacts) = read(&contacts, Fixed::Yes, None)?;
                let row = recorded(name, &read_mesh(&model)?, &contacts, seeds, reference)?;
                rows.push(row);
            }
            None => skipped.push(format!("{name}: not in $TACTILE_DATA/touch")),
        }
    }
    Ok(rows)
}

/// Runs one after the other, so that their times mean something.
fn recorded(
    name: &str,
    mesh: &Mesh,
    contacts: &[Contact],
    seeds: u64,
    reference: &str,
) -> Result<Recorded, Error> {
    let wrong = |source| Error::Localize { name: name.into(), source };
    let slow = exhaustive(mesh, contacts, STARTS).map_err(wrong)?;
    let mut runs = Vec::new();
    let mut seconds = Vec::new();
    for seed in 0..seeds.max(1) {
        // A fresh mesh: its search tree is part of the work.
        let mesh = Mesh::new(mesh.vertices().to_vec(), mesh.triangles().to_vec())?;
        let start = Instant::now();
        let settings = Settings { seed, ..Settings::default() };
        runs.push(localize(&mesh, contacts, &settings).map_err(wrong)?);
        seconds.push(start.elapsed().as_secs_f64());
    }
    let nats = |run: &Localization| run.modes.iter().map(|m| m.nats).fold(f64::INFINITY, f64::min);
    let best = runs.iter().map(nats).fold(slow.nats, f64::min);
    let reached = runs.iter().filter(|r| nats(r) <= best + REACHED * r.misfit).count();
    Ok(Recorded {
        name: name.into(),
        contacts: contacts.len(),
        mean_mm: Spread::of(runs.iter().filter_map(|r| r.modes.first()).map(|m| 1e3 * m.mean)),
        seconds: Spread::of(seconds),
        modes: runs.first().map_or(0, |r| r.modes.len()),
        unobservable: runs.first().map_or(0, |r| r.freedoms.len()),
        reached: (reached, runs.len()),
        exhaustive_mm: 1e3 * slow.mean,
        reference: reference.into(),
    })
}
