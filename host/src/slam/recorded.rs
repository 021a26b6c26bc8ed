//! Recordings of a link as scenes that play and as MCAP files: read as they go, in bounded memory, so that
//! hours are no trouble.

use std::cell::RefCell;
use std::io::{self, BufRead, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::sync_channel;
use std::thread;

use nalgebra::{Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

use crate::log::recording::{Header, Piece, Pieces, RecordingError};
use crate::log::replayed::{Heard, Rest, listen};
use crate::log::{LoggedGrasp, Noise};
use crate::reference::Contact;
use crate::slam::choose::Choice;
use crate::slam::free::Free;
use crate::slam::reconstruct::{Placed, Reconstruction, doubt, shape};
use crate::slam::track::Step;
use crate::slam::{Progress, usual_deviations};
use crate::space::{Point, Pose};
use crate::view::growth::{Grown, grow};
use crate::view::mcap;
use crate::view::scene::{Grasp, Meta, Scene, Surface};
use crate::view::timeline::Timeline;

/// Contacts that the surface of a recording is fitted to at most, in the plane and in space.
const CONTACTS: [usize; 2] = [300, 200];

/// Grasps with contacts from which a recording shows a surface.
const LEAST_GRASPS: usize = 2;

/// What a recording tells of its last object: what was sent, what the board made of it, and the surface
/// that its poses make of the contacts. Of a long one, grasps that follow one another closely are one.
///
/// ```
/// use tactile_host::log::recording::{Header, RecordingWriter};
/// use tactile_host::slam::recorded::Recorded;
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("session.tac");
/// RecordingWriter::new(std::fs::File::create(&path)?, &Header::new(2, vec![], "nothing".into()))?;
/// let recorded = Recorded::read(&path, &|_, _| ())?;
/// assert_eq!(recorded.missing, ["There is no whole grasp in the recording."]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Recorded {
    /// Grasps that the board accepted.
    pub count: u64,
    /// What the file lacks, one sentence each.
    pub missing: Vec<String>,
    path: PathBuf,
    header: Header,
    /// How often the board was told to begin anew.
    begun: usize,
    /// Grasps that one of `grasps` stands for.
    stride: u64,
    rest: Rest,
    grasps: Vec<Grasp>,
    /// Name of the surface's model.
    model: Option<String>,
    /// Positions are those of `grasps`.
    surfaces: Vec<Grown>,
}

impl Recorded {
    /// Reads a file to its end and tells `progress` in megabytes. What is torn, damaged or missing is said.
    ///
    /// # Errors
    /// When the file cannot be read or does not start with a whole header.
    pub fn read(path: &Path, progress: Progress<'_>) -> Result<Recorded, RecordingError> {
        let mut pieces = Pieces::open(path)?;
        let header = pieces.header.clone();
        let dimension = header.dimension;
        let mut timeline = Timeline::default();
        let (mut count, mut begun) = (0, 0);
        let mut hear = |heard| match heard {
            Heard::Forgotten => {
                timeline = Timeline::default();
                (count, begun) = (0, begun + 1);
            }
            Heard::Grasp(grasp, estimate) => {
                count += 1;
                timeline.push(match estimate {
                    // Of the covariance only the diagonal is recorded: the entropy is not known.
                    Some(estimate) => Grasp {
                        entropy: None,
                        ..Grasp::estimated(&grasp, &Step::from(&estimate), dimension)
                    },
                    None => Grasp::felt(&grasp),
                });
            }
        };
        let (rest, failed) =
            ahead(&mut pieces, progress, |pieces| listen(&header, pieces, &mut hear));
        let mut missing = Vec::new();
        if let Some(error) = failed {
            missing.push(format!("The recording could not be read to its end: {error}."));
        }
        if pieces.torn > 0 {
            missing.push(format!(
                "The recording ends within a piece: its last {} bytes are left out.",
                pieces.torn
            ));
        }
        if pieces.damaged > 0 {
            missing.push(format!("{} damaged pieces are left out.", pieces.damaged));
        }
        let bad = rest.from_board.damaged() + rest.to_board.damaged();
        if bad > 0 {
            missing.push(format!("{bad} frames of the link were damaged and are left out."));
        }
        if count == 0 {
            missing.push("There is no whole grasp in the recording.".into());
        }
        let stride = timeline.stride();
        let grasps = timeline.into_grasps();
        if count > 0 && grasps.iter().all(|g| g.pose.is_none()) {
            missing.push("The board answered no grasp: there are no poses.".into());
        }
        let (model, surfaces) = surfaces(dimension, &grasps, &rest.noise);
        let path = path.to_owned();
        Ok(Recorded { count, missing, path, header, begun, rest, stride, grasps, model, surfaces })
    }

    /// What it is: its description, or its file's name.
    fn title(&self) -> String {
        match self.header.description.as_str() {
            "" => {
                self.path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned())
            }
            described => described.to_owned(),
        }
    }

    /// A scene that plays. What is left out for its length is said, too.
    pub fn scene(self) -> Scene {
        let mut missing = self.missing.clone();
        if self.stride > 1 {
            missing.push(format!(
                "{} grasps are shown {} at a time, with a part of their contacts.",
                self.count, self.stride
            ));
        }
        let surface = |grown: &Grown| {
            Surface::new(&grown.geometry, &grown.deviations, self.last_grasp(grown))
        };
        let surfaces = self.surfaces.iter().map(surface).collect();
        let contacts = self.grasps.iter().map(|g| g.touched).sum::<u64>();
        let meta = Meta {
            tracker: self
                .rest
                .hello
                .map(|h| format!("{:?} on the board", h.tracker).to_lowercase()),
            model: self.model.clone(),
            fingers: self.header.fingers.clone(),
            grasps: Some(self.count),
            figures: vec![
                ("grasps".into(), self.count.to_string()),
                ("contacts".into(), contacts.to_string()),
            ],
            missing,
            ..Meta::new(self.header.dimension, self.title())
        };
        Scene { meta, grasps: self.grasps, surfaces, choices: Vec::new() }
    }

    /// The number of the last grasp that a surface is made of.
    fn last_grasp(&self, grown: &Grown) -> u64 {
        self.grasps.get(grown.grasp).map_or(0, |g| g.grasp)
    }

    /// Writes it as MCAP ([`mcap`]): every grasp, and the surface as it grew. Reads the file once more, and
    /// tells `progress` how far it is, in megabytes.
    ///
    /// # Errors
    /// When the file can no longer be read, or `out` cannot be written.
    pub fn film(&self, out: impl Write, progress: Progress<'_>) -> io::Result<()> {
        let mut pieces = Pieces::open(&self.path).map_err(io::Error::other)?;
        let title = self.title();
        let grasps = usize::try_from(self.count).unwrap_or(usize::MAX);
        let heading = mcap::Heading { title: &title, fingers: &self.header.fingers, grasps };
        let mut film = mcap::Recording::new(out, &heading)?;
        let mut surfaces = self.surfaces.iter().peekable();
        let mut put = |grasp: &LoggedGrasp, estimate: Option<&Step>| {
            film.grasp(grasp, estimate)?;
            while let Some(grown) = surfaces.next_if(|s| self.last_grasp(s) <= grasp.index) {
                film.surface(&grown.geometry, &grown.deviations)?;
            }
            Ok(())
        };
        let mut before = self.begun;
        let failed: RefCell<Option<io::Error>> = RefCell::new(None);
        let mut hear = |heard| match heard {
            Heard::Forgotten => before = before.saturating_sub(1),
            Heard::Grasp(grasp, estimate) if before == 0 && failed.borrow().is_none() => {
                let estimate = estimate.as_ref().map(Step::from);
                *failed.borrow_mut() = put(&grasp, estimate.as_ref()).err();
            }
            Heard::Grasp(..) => {}
        };
        ahead(&mut pieces, progress, |pieces| {
            // After an error nothing more is listened to.
            let mut pieces = pieces.take_while(|_| failed.borrow().is_none());
            listen(&self.header, &mut pieces, &mut hear)
        });
        if let Some(error) = failed.into_inner() {
            return Err(error);
        }
        film.finish()
    }
}

/// Pieces that are handed over together, and how many such hands may wait.
const BATCH: usize = 1_024;
const WAITING: usize = 8;

/// What `work` makes of the pieces, which are read and checked on another thread before it needs them, and
/// why they ended too early, where they did. `progress` is told in megabytes.
fn ahead<R: BufRead + Send, T>(
    pieces: &mut Pieces<R>,
    progress: Progress<'_>,
    work: impl FnOnce(&mut dyn Iterator<Item = Piece>) -> T,
) -> (T, Option<io::Error>) {
    const MEGABYTE: u64 = 1 << 20;
    thread::scope(|scope| {
        let (send, receive) = sync_channel::<Vec<Piece>>(WAITING);
        let reader = scope.spawn(move || {
            let mut failed = None;
            loop {
                let sound = pieces.by_ref().map_while(|p| p.map_err(|e| failed = Some(e)).ok());
                let batch: Vec<Piece> = sound.take(BATCH).collect();
                if let (done, Some(all)) = pieces.bytes {
                    progress((done / MEGABYTE) as usize, all.div_ceil(MEGABYTE) as usize);
                }
                let last = batch.len() < BATCH;
                // Nobody takes it where `work` has seen enough.
                if send.send(batch).is_err() || last {
                    return failed;
                }
            }
        });
        let made = work(&mut receive.into_iter().flatten());
        let failed = reader
            .join()
            .unwrap_or_else(|_| Some(io::Error::other("the thread that reads it broke off")));
        (made, failed)
    })
}

/// Surfaces of the contacts that the timeline holds, at its poses, and the name of their model; none
/// where nothing fits them.
fn surfaces(dimension: usize, grasps: &[Grasp], noise: &Noise) -> (Option<String>, Vec<Grown>) {
    let mut placed: Vec<Placed> = Vec::new();
    for (at, grasp) in grasps.iter().enumerate() {
        placed_contacts(&mut placed, at, grasp, noise);
    }
    let most = CONTACTS[usize::from(dimension == 3)];
    let stride = placed.len().div_ceil(most).max(1);
    let contacts: Vec<Placed> = placed.into_iter().step_by(stride).collect();
    let touching = contacts.iter().map(|p| p.grasp).collect::<std::collections::BTreeSet<_>>();
    if touching.len() < LEAST_GRASPS {
        return (None, Vec::new());
    }
    let all: Vec<Contact> = contacts.iter().map(|p| p.contact).collect();
    let none: Vec<Free> = Vec::new();
    let Ok((model, geometry, deviations)) = shape(dimension, &all, &none, Choice::Auto, &|_, _| ())
    else {
        return (None, Vec::new());
    };
    let name = model.name().to_owned();
    let reconstruction = Reconstruction { geometry, deviations, contacts, model };
    (Some(name), grow(dimension, &reconstruction, &|_| Vec::new()))
}

/// Appends the grasp's contacts in the object frame, the doubt about the pose in their deviations.
fn placed_contacts(placed: &mut Vec<Placed>, at: usize, grasp: &Grasp, noise: &Noise) {
    let (point_deviation, normal_deviation) = usual_deviations(noise);
    let Some([x, y, z, qx, qy, qz, qw]) = grasp.pose else { return };
    // A lost grasp says nothing about the shape.
    if grasp.status == Some("lost") {
        return;
    }
    let turn = UnitQuaternion::new_normalize(Quaternion::new(qw, qx, qy, qz));
    let to_object = Pose::from_parts(Translation3::new(x, y, z), turn).inverse();
    let deviations = grasp.deviations.unwrap_or_default();
    let covariance =
        nalgebra::Matrix6::from_fn(|i, j| if i == j { deviations[i].powi(2) } else { 0.0 });
    for numbers in grasp.contacts.0.chunks_exact(6) {
        let [x, y, z, nx, ny, nz] = [0, 1, 2, 3, 4, 5].map(|i| f64::from(numbers[i]));
        let point: Point = (to_object * Point3::new(x, y, z)).coords;
        let normal = (to_object.rotation * Vector3::new(nx, ny, nz)).try_normalize(0.5);
        let contact = Contact { point, normal, point_deviation, normal_deviation };
        placed.push(Placed { contact: doubt(contact, &covariance), grasp: at });
    }
}

#[cfg(test)]
#[path = "recorded_tests.rs"]
mod tests;
