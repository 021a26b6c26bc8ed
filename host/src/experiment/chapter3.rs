//! The thesis' figures of chapter 3 as pictures and numbers: its filter as printed, ours beside it.
//!
//! Pictures of shapes show seed 0; the numbers are over all seeds.

use clap::ValueEnum;
use nalgebra::Point3;
use serde::Serialize;
use tactile_core::space::Planar;
use tactile_core::surface::cholesky::packed;
use tactile_core::surface::{Ball, Gpis, Matern32, Prior, Training};
use tactile_core::track::Bootstrap;

use super::Spread;
use super::figure::{Drawn, FigureError};
use super::proportion::Proportion;
use super::tracking::judge::{Judgement, Truth, gauge};
use super::tracking::{Contender, full_noise, runs};
use crate::baseline::{Baseline, literal};
use crate::log::GraspLog;
use crate::quantity::Deviation;
use crate::sim::{ObjectSpec, Options, SimError, simulate};
use crate::slam::choose::Choice;
use crate::slam::reconstruct::reconstruct;
use crate::slam::track::{Step, follow, settings};
use crate::slam::trackers::{KERNEL, Kind};
use crate::view::curves::{self, Curve, Mark, Plot, Scale};
use crate::view::drawing::Drawing;
use crate::view::sheet::{self, Panel, Sheet};

/// What a figure shows.
#[derive(Clone, Copy, Debug)]
pub struct Figure {
    /// As the command line names it.
    pub name: &'static str,
    title: &'static str,
    objects: &'static [&'static str],
    view: View,
    /// What the thesis says.
    thesis: &'static str,
}

#[derive(Clone, Copy, Debug)]
enum View {
    /// Reconstructions after these numbers of grasps.
    Progress(&'static [usize]),
    /// Error against the noise of the object's motion, percent.
    Noise(&'static [f64]),
    /// Success against the number of particles.
    Particles,
}

/// All of them, in the thesis' order. Figure 3.10 is a photograph of a simulator; those about pose
/// graphs are in [`super::graphs`].
pub const FIGURES: &[Figure] = &[
    Figure {
        name: "figure-3.11",
        title: "Figure 3.11: three planar objects, grasp by grasp",
        objects: &["rectangle:0.10x0.06", "hexagon:0.045", "ellipse:0.10x0.06"],
        view: View::Progress(&[1, 4, 8, 16]),
        thesis: "pictures only; 16 grasps each",
    },
    Figure {
        name: "figure-3.12",
        title: "Figure 3.12: error against the noise of the object's motion, 16 grasps",
        objects: &["rectangle:0.10x0.06", "hexagon:0.045"],
        view: View::Noise(&[12.5, 25.0, 50.0, 75.0, 100.0]),
        thesis: "mean below 3 mm at known poses, always below 9 mm at 100 % with 20 000 particles",
    },
    Figure {
        name: "figure-3.13",
        title: "Figure 3.13: three spatial objects, grasp by grasp",
        objects: &["box:0.12x0.06x0.06", "cylinder:0.06x0.1", "lshape:0.09x0.09x0.035x0.05"],
        view: View::Progress(&[1, 5, 10, 20]),
        thesis: "“correctly reconstructed even with high noise”",
    },
    Figure {
        name: "figure-3.14",
        title: "Figure 3.14: success against the number of particles, 16 grasps at 100 % noise",
        objects: &["rectangle:0.10x0.06", "hexagon:0.045"],
        view: View::Particles,
        thesis: "“at least 10 000 particles to avoid the failure of the tracking”",
    },
];

/// The figure of that name.
pub fn figure(name: &str) -> Option<&'static Figure> {
    FIGURES.iter().find(|f| f.name == name)
}

/// One line of a figure's numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Line {
    /// What was tracked.
    pub object: String,
    /// By whom.
    pub tracker: String,
    /// Grasps, percent of noise, or particles; `None` for a tracker whose size is its own.
    pub at: Option<f64>,
    /// Runs with the right shape and last pose, see [`Judgement::is_success`].
    pub success: Proportion,
    /// After the best rigid alignment, millimetres.
    pub hausdorff_mm: Option<Spread>,
    /// Mean distance from the touched part of the true surface to the estimate, millimetres.
    pub touched_mm: Option<Spread>,
    /// Error of the last pose, millimetres.
    pub last_mm: Option<Spread>,
    /// The same in degrees, up to the object's symmetry.
    pub last_deg: Option<Spread>,
}

/// The numbers of a figure.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Numbers {
    /// What varies along a curve or a row of pictures.
    pub along: &'static str,
    /// Whose reconstructions the picture shows, where it shows any.
    pub pictured: Option<&'static str>,
    /// Row by row.
    pub lines: Vec<Line>,
}

/// An object and its simulation at the thesis' 100 %.
struct Subject {
    truth: Truth,
    options: Options,
}

impl Subject {
    fn new(object: &str) -> Result<Subject, SimError> {
        let spec: ObjectSpec = object.parse()?;
        let motion_noise = full_noise(spec.dimension());
        let truth = Truth::new(spec.geometry()?);
        Ok(Subject { truth, options: Options { motion_noise, ..Options::new(spec) } })
    }

    fn with_grasps(&self, grasps: usize) -> Options {
        Options { grasps: Some(grasps), ..self.options.clone() }
    }

    fn with_noise(&self, percent: f64) -> Options {
        let Deviation { length, angle } = self.options.motion_noise;
        let part = percent / 100.0;
        let motion_noise = Deviation { length: part * length, angle: part * angle };
        Options { motion_noise, ..self.options.clone() }
    }
}

/// A way to follow the object through a log.
type Follow<'a> = &'a (dyn Fn(&GraspLog, u64) -> Vec<Step> + Sync);

/// The trackers on offer, behind what true poses give.
fn ours() -> impl Iterator<Item = Contender> {
    let trackers = Kind::value_variants().iter().map(|kind| Contender::Tracker(*kind));
    [Contender::Oracle].into_iter().chain(trackers)
}

impl Figure {
    /// Makes the figure with seeds from 0 on.
    ///
    /// # Errors
    /// When an object cannot be simulated or the picture cannot be drawn.
    pub fn draw(&self, seeds: u64) -> Result<Drawn<Numbers>, FigureError> {
        let mut drawn = Drawn {
            title: self.title,
            thesis: self.thesis,
            numbers: Numbers::default(),
            picture: Drawing::default(),
        };
        match self.view {
            View::Progress(grasps) => self.progress(grasps, seeds, &mut drawn)?,
            View::Noise(percents) => self.noise(percents, seeds, &mut drawn)?,
            View::Particles => self.particles(seeds, &mut drawn)?,
        }
        Ok(drawn)
    }

    fn progress(
        &self,
        grasps: &[usize],
        seeds: u64,
        drawn: &mut Drawn<Numbers>,
    ) -> Result<(), FigureError> {
        drawn.numbers.along = "grasps";
        for object in self.objects {
            let subject = Subject::new(object)?;
            for contender in ours() {
                let follow = |log: &GraspLog, seed| contender.follow(log, seed);
                for count in grasps {
                    let options = subject.with_grasps(*count);
                    let at = Some(*count as f64);
                    let line = line(&subject, &options, contender.name(), at, seeds, &follow)?;
                    drawn.numbers.lines.push(line);
                }
            }
        }
        let last = grasps.iter().copied().max().unwrap_or(0) as f64;
        let best = best(&drawn.numbers.lines, last);
        let mut panels = Vec::new();
        for object in self.objects {
            let subject = Subject::new(object)?;
            for count in grasps {
                panels.extend(panel(&subject, *count, best)?);
            }
        }
        drawn.numbers.pictured = Some(best.name());
        let title = format!("{}, tracker {}", self.title, best.name());
        drawn.picture = sheet::render(&Sheet { title, columns: grasps.len(), panels })?;
        Ok(())
    }

    fn noise(
        &self,
        percents: &[f64],
        seeds: u64,
        drawn: &mut Drawn<Numbers>,
    ) -> Result<(), FigureError> {
        drawn.numbers.along = "noise %";
        let mut plots = Vec::new();
        for object in self.objects {
            let subject = Subject::new(object)?;
            let mut curves = Vec::new();
            let others = [Contender::Odometry, Contender::Baseline(Baseline::Literal)];
            for contender in ours().chain(others) {
                let follow = |log: &GraspLog, seed| contender.follow(log, seed);
                let mut marks = Vec::new();
                for percent in percents {
                    let options = subject.with_noise(*percent);
                    let at = Some(*percent);
                    let line = line(&subject, &options, contender.name(), at, seeds, &follow)?;
                    marks.extend(line.hausdorff_mm.map(|s| Mark {
                        x: *percent,
                        low: s.low,
                        median: s.median,
                        high: s.high,
                    }));
                    drawn.numbers.lines.push(line);
                }
                curves.push(Curve { name: contender.name().into(), marks });
            }
            plots.push(Plot {
                title: (*object).into(),
                across: "motion noise, % of 10 mm and 20°".into(),
                up: "Hausdorff distance, mm: median and quartiles".into(),
                scales: [Scale::Linear, Scale::Logarithmic],
                curves,
            });
        }
        drawn.picture = curves::render(&plots)?;
        Ok(())
    }

    fn particles(&self, seeds: u64, drawn: &mut Drawn<Numbers>) -> Result<(), FigureError> {
        drawn.numbers.along = "particles";
        let mut plots = Vec::new();
        for object in self.objects {
            let subject = Subject::new(object)?;
            let mut curves = Vec::new();
            for name in ["literal", "bootstrap"] {
                let mut marks = Vec::new();
                for (count, bootstrap) in SIZES {
                    let printed = |log: &GraspLog, seed| literal(log, count, seed);
                    let follow: Follow = if name == "literal" { &printed } else { &bootstrap };
                    let at = Some(count as f64);
                    let line = line(&subject, &subject.options, name, at, seeds, follow)?;
                    marks.push(share(count, &line.success));
                    drawn.numbers.lines.push(line);
                }
                curves.push(Curve { name: name.into(), marks });
            }
            // The others have a size of their own: level lines.
            for kind in Kind::value_variants().iter().filter(|k| **k != Kind::Bootstrap) {
                let follow = |log: &GraspLog, seed| kind.follow(log, seed);
                let line = line(&subject, &subject.options, kind.name(), None, seeds, &follow)?;
                let ends = [SIZES[0].0, SIZES[SIZES.len() - 1].0];
                let marks = ends.map(|count| share(count, &line.success)).into();
                curves.push(Curve { name: kind.name().into(), marks });
                drawn.numbers.lines.push(line);
            }
            plots.push(Plot {
                title: (*object).into(),
                across: "particles".into(),
                up: "success, %, with Wilson's 95 % interval".into(),
                scales: [Scale::Logarithmic, Scale::Linear],
                curves,
            });
        }
        drawn.picture = curves::render(&plots)?;
        Ok(())
    }
}

/// Contacts that the core's map keeps in figure 3.14, as on the host.
const CONTACTS: usize = 128;

type Map =
    Gpis<Planar, Matern32, Ball<Planar>, CONTACTS, { 3 * CONTACTS }, { packed(3 * CONTACTS) }>;

/// The core's bootstrap filter with so many particles, planar.
fn bootstrap<const PARTICLES: usize>(log: &GraspLog, seed: u64) -> Vec<Step> {
    let mut tracker = Box::new(Bootstrap::<Planar, Map, PARTICLES>::new(Map::new()));
    tracker.map_mut().configure(KERNEL, Ball::UNSET, Training::Normals);
    tracker.configure(settings(log, seed));
    follow(&mut *tracker, log)
}

/// The core's bootstrap filter of one size.
type Filter = fn(&GraspLog, u64) -> Vec<Step>;

/// Numbers of particles, and the filter of that size.
const SIZES: [(usize, Filter); 6] = [
    (250, bootstrap::<250>),
    (500, bootstrap::<500>),
    (1000, bootstrap::<1000>),
    (2500, bootstrap::<2500>),
    (5000, bootstrap::<5000>),
    (10_000, bootstrap::<10_000>),
];

fn line(
    subject: &Subject,
    options: &Options,
    tracker: &str,
    at: Option<f64>,
    seeds: u64,
    follow: Follow<'_>,
) -> Result<Line, SimError> {
    let runs = runs(options, &subject.truth, 0..seeds, follow)?;
    let judged: Vec<Judgement> = runs.iter().filter_map(|r| r.judgement).collect();
    let spread = |f: fn(&Judgement) -> Option<f64>| Spread::of(judged.iter().filter_map(f));
    let success = Proportion::of(runs.iter().map(|r| r.judgement.is_some_and(|j| j.is_success())));
    Ok(Line {
        object: options.object.to_string(),
        tracker: tracker.into(),
        at,
        success,
        hausdorff_mm: spread(|j| Some(1e3 * j.hausdorff?)),
        touched_mm: spread(|j| Some(1e3 * j.touched?.mean)),
        last_mm: spread(|j| Some(1e3 * j.last.translation)),
        last_deg: spread(|j| Some(j.last.rotation.to_degrees())),
    })
}

/// The tracker whose shapes are nearest in the end, the sum of medians over the objects deciding.
fn best(lines: &[Line], at: f64) -> Contender {
    let total = |contender: &Contender| -> f64 {
        let of = |l: &&Line| l.tracker == contender.name() && l.at == Some(at);
        let median = |l: &Line| l.hausdorff_mm.map_or(f64::INFINITY, |s| s.median);
        lines.iter().filter(of).map(median).sum()
    };
    let trackers = ours().filter(|c| c.is_tracker());
    trackers.min_by(|a, b| total(a).total_cmp(&total(b))).unwrap_or(Contender::Oracle)
}

/// Seed 0 after so many grasps, in the true frame; none where there is nothing to show.
fn panel(
    subject: &Subject,
    grasps: usize,
    contender: Contender,
) -> Result<Option<Panel>, FigureError> {
    let Subject { truth, .. } = subject;
    let log = simulate(&subject.with_grasps(grasps))?.log;
    let steps = super::with_room(|| contender.follow(&log, 0));
    let Some(frame) = gauge(&log, &steps, &truth.geometry) else { return Ok(None) };
    let judged = super::tracking::judge::judge(&log, &steps, truth);
    let shape = reconstruct(&log, &steps, Choice::Auto, &|_, _| {}).ok();
    let placed = shape.as_ref().map(|s| &s.contacts[..]).unwrap_or_default();
    let contacts = placed.iter().map(|p| {
        let at = (frame * Point3::from(p.contact.point)).coords;
        (at, p.contact.normal.map(|n| frame.rotation * n))
    });
    let note = match judged {
        Some(Judgement { hausdorff: Some(h), last, .. }) => format!(
            "Hausdorff {:.1} mm, pose {:.1} mm, {:.1}°",
            1e3 * h,
            1e3 * last.translation,
            last.rotation.to_degrees()
        ),
        _ => "no surface".into(),
    };
    let plural = if grasps == 1 { "" } else { "s" };
    Ok(Some(Panel {
        title: format!("{}, {grasps} grasp{plural}", subject.options.object),
        note,
        truth: truth.geometry.clone(),
        contacts: contacts.collect(),
        deviations: shape.as_ref().map(|s| s.deviations.clone()).unwrap_or_default(),
        estimate: shape.map(|s| s.geometry.transformed(&frame)),
        groups: Vec::new(),
        links: Vec::new(),
    }))
}

/// A share in percent with its interval.
fn share(particles: usize, success: &Proportion) -> Mark {
    let (low, high) = success.interval();
    let median = 100.0 * success.successes as f64 / success.of.max(1) as f64;
    Mark { x: particles as f64, low: 100.0 * low, median, high: 100.0 * high }
}

impl std::fmt::Display for Numbers {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(
            f,
            "  {:<30}{:<14}{:>9}  {:<20}{:<24}{:<22}{:<24}last °",
            "object", "tracker", self.along, "success", "Hausdorff mm", "touched mm", "last mm"
        )?;
        let show = |s: &Option<Spread>| s.map_or("–".to_owned(), |s| s.to_string());
        for line in &self.lines {
            writeln!(
                f,
                "  {:<30}{:<14}{:>9}  {:<20}{:<24}{:<22}{:<24}{}",
                line.object,
                line.tracker,
                line.at.map_or("–".to_owned(), |at| at.to_string()),
                line.success.to_string(),
                show(&line.hausdorff_mm),
                show(&line.touched_mm),
                show(&line.last_mm),
                show(&line.last_deg),
            )?;
        }
        write!(
            f,
            "  success: Hausdorff < 9 mm and last pose within 5 mm and 5° up to symmetry, with \
             Wilson's 95 % interval;\n  others: median [quartiles]; Hausdorff after the best rigid \
             alignment; touched: mean from the true surface near contacts"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::with_room;

    #[test]
    fn names_are_the_thesis_own() {
        for number in 11..=14 {
            assert!(figure(&format!("figure-3.{number}")).is_some());
        }
        assert!(figure("figure-3.10").is_none());
    }

    #[test]
    fn shapes_grow_grasp_by_grasp() {
        let subject = Subject::new("rectangle:0.10x0.06").unwrap();
        let oracle = |log: &GraspLog, seed| Contender::Oracle.follow(log, seed);
        let after = |grasps: usize| {
            let options = subject.with_grasps(grasps);
            line(&subject, &options, "oracle", Some(grasps as f64), 3, &oracle).unwrap()
        };
        let (first, last) = (after(1), after(16));
        assert_eq!(last.success, Proportion { successes: 3, of: 3 });
        let (first, last) = (first.hausdorff_mm.unwrap(), last.hausdorff_mm.unwrap());
        assert!(first.median > 2.0 * last.median && last.median < 3.0, "{first:?} {last:?}");
        let shown = panel(&subject, 4, Contender::Oracle).unwrap().unwrap();
        assert_eq!(
            (shown.title.as_str(), shown.contacts.len()),
            ("rectangle:0.1x0.06, 4 grasps", 20)
        );
        for (point, _) in &shown.contacts {
            assert!(shown.truth.distance(point) < 6e-3);
        }
    }

    #[test]
    fn the_best_has_the_least_error_in_the_end() {
        let line = |tracker: &str, at: f64, median: f64| Line {
            object: "box".into(),
            tracker: tracker.into(),
            at: Some(at),
            success: Proportion { successes: 0, of: 0 },
            hausdorff_mm: Some(Spread { low: 0.0, median, high: 9.0, count: 1 }),
            touched_mm: None,
            last_mm: None,
            last_deg: None,
        };
        let mut lines: Vec<Line> = Kind::value_variants()
            .iter()
            .map(|kind| line(kind.name(), 16.0, if *kind == Kind::Bootstrap { 2.0 } else { 3.0 }))
            .collect();
        lines.extend([line("oracle", 16.0, 0.1), line("bootstrap", 1.0, 50.0)]);
        assert_eq!(best(&lines, 16.0), Contender::Tracker(Kind::Bootstrap));
    }

    #[test]
    fn sizes_are_what_they_say() {
        let subject = Subject::new("triangle:0.06").unwrap();
        let log = simulate(&subject.with_grasps(3)).unwrap().log;
        let steps = with_room(|| SIZES[0].1(&log, 1));
        assert!((steps[0].effective_particles / SIZES[0].0 as f64 - 1.0).abs() < 1e-4);
        assert!(SIZES.windows(2).all(|pair| pair[0].0 < pair[1].0));
        let mark = share(250, &Proportion { successes: 5, of: 10 });
        assert!(mark.low < 50.0 && mark.median == 50.0 && mark.high > 50.0);
    }
}
