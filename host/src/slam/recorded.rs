//! Recordings of a link as scenes that play and as MCAP files: read as they go, in bounded memory, so that
//! hours are no trouble.

use std::cell::{Cell, RefCell};
use std::io::{self, BufRead, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{channel, sync_channel};
use std::thread;

use nalgebra::{Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

use crate::log::Noise;
use crate::log::recording::{Header, Piece, Pieces, RecordingError};
use crate::log::replayed::{Heard, Rest, listen};
use crate::reference::Contact;
use crate::slam::choose::Choice;
use crate::slam::free::Free;
use crate::slam::place::{Placed, doubt};
use crate::slam::reconstruct::{Poses, Reconstruction, shape};
use crate::slam::track::Step;
use crate::slam::{Progress, usual_deviations};
use crate::space::{Point, Pose};
use crate::thin::evenly;
use crate::view::growth::{Grown, grow};
use crate::view::mcap;
use crate::view::scene::{Grasp, Meta, Scene, Surface};
use crate::view::timeline::{Timeline, is_lost};

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
    title: String,
    header: Header,
    /// Grasps that one of `grasps` stands for.
    stride: u64,
    rest: Rest,
    grasps: Vec<Grasp>,
    /// Name of the surface's model.
    model: Option<String>,
    /// Positions are those of `grasps`.
    surfaces: Vec<Grown>,
}

/// Why there is no film.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    /// The recording cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// There is nothing to see.
    #[error("{}: expected at least one whole grasp, found none", file.display())]
    Empty {
        /// The recording.
        file: PathBuf,
    },
    /// The film cannot be written.
    #[error("cannot write: {0}")]
    Film(#[from] io::Error),
}

/// Takes what is heard, and how much of the file was read by then, as a share; an error ends the reading.
type Witness<'a> = &'a mut dyn FnMut(&Heard, f64) -> io::Result<()>;

impl Recorded {
    /// Reads a file to its end and tells `progress` in megabytes. What is torn, damaged or missing is said.
    ///
    /// # Errors
    /// When the file cannot be read or does not start with a whole header.
    pub fn read(path: &Path, progress: Progress<'_>) -> Result<Recorded, RecordingError> {
        let mut pieces = Pieces::open(path)?;
        // Nobody is told, so that nothing fails.
        let (recorded, _) = Recorded::hear(path, &mut pieces, progress, &mut |_, _| Ok(()));
        Ok(recorded)
    }

    /// Reads a file like [`Recorded::read`] and writes it as MCAP ([`mcap`]) meanwhile: every grasp, also those
    /// of objects before the last, and in the end the surfaces of the last as it grew.
    ///
    /// # Errors
    /// When the file cannot be read, does not start with a whole header or holds no grasp: nothing is written
    /// then; when `out` fails.
    pub fn film(
        path: &Path,
        out: impl Write,
        progress: Progress<'_>,
    ) -> Result<Recorded, FilmError> {
        let mut pieces = Pieces::open(path)?;
        let title = title(path, &pieces.header);
        let fingers = pieces.header.fingers.clone();
        let heading = mcap::Heading { title: &title, fingers: &fingers, grasps: 0 };
        let mut out = Some(out);
        let mut film = None;
        let mut grasps = 0;
        let mut witness = |heard: &Heard, share: f64| match heard {
            Heard::Forgotten => film.as_mut().map_or(Ok(()), mcap::Recording::begin_anew),
            Heard::Grasp(grasp, estimate) => {
                if let Some(out) = out.take() {
                    film = Some(mcap::Recording::new(out, &heading)?);
                }
                let Some(film) = &mut film else { return Ok(()) };
                grasps += 1;
                film.expect((f64::from(grasps) / share.clamp(1e-6, 1.0)).round() as usize);
                film.grasp(grasp, estimate.as_ref().map(Step::from).as_ref())
            }
        };
        let (recorded, heard) = Recorded::hear(path, &mut pieces, progress, &mut witness);
        heard?;
        let Some(mut film) = film else { return Err(FilmError::Empty { file: path.into() }) };
        for grown in &recorded.surfaces {
            let seconds = recorded.grasps.get(grown.grasp).and_then(|g| g.time);
            let seconds = seconds.unwrap_or(f64::INFINITY);
            film.earlier_surface(seconds, &grown.geometry, &grown.deviations)?;
        }
        film.finish()?;
        Ok(recorded)
    }

    /// What the pieces tell, and whether the witness failed.
    fn hear(
        path: &Path,
        pieces: &mut Pieces<impl BufRead + Send>,
        progress: Progress<'_>,
        witness: Witness<'_>,
    ) -> (Recorded, io::Result<()>) {
        let header = pieces.header.clone();
        let dimension = header.dimension;
        let all = pieces.bytes.1.unwrap_or(0).max(1) as f64;
        let read = Cell::new(pieces.bytes.0 as f64);
        let failed: RefCell<Option<io::Error>> = RefCell::new(None);
        let mut timeline = Timeline::default();
        let mut count = 0;
        let mut hear = |heard: Heard| {
            if failed.borrow().is_some() {
                return;
            }
            *failed.borrow_mut() = witness(&heard, read.get() / all).err();
            match heard {
                Heard::Forgotten => {
                    timeline = Timeline::default();
                    count = 0;
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
            }
        };
        let mut broken = None;
        let listened = |ear: &mut dyn FnMut(&Piece)| {
            broken = ahead(pieces, progress, &mut |piece| {
                read.set(read.get() + (piece.bytes.len() + SEALED) as f64);
                ear(piece);
                failed.borrow().is_none()
            });
        };
        let rest = listen(&header, listened, &mut hear);
        if let Some(error) = failed.into_inner() {
            let recorded = Recorded::made(path, header, count, Vec::new(), timeline, rest);
            return (recorded, Err(error));
        }
        let mut missing = Vec::new();
        if let Some(error) = broken {
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
        if let Some(at) = pieces.another {
            missing.push(format!("Another recording begins at byte {at}: it is left out."));
        }
        (Recorded::made(path, header, count, missing, timeline, rest), Ok(()))
    }

    /// `missing` says what the file lacks; what the link lost and the board did not say is added.
    fn made(
        path: &Path,
        header: Header,
        count: u64,
        mut missing: Vec<String>,
        timeline: Timeline,
        rest: Rest,
    ) -> Recorded {
        let bad = rest.from_board.damaged() + rest.to_board.damaged();
        if bad > 0 {
            missing.push(format!("{bad} frames of the link were damaged and are left out."));
        }
        missing.extend(rest.left_out.sentences());
        if count == 0 {
            missing.push("There is no whole grasp in the recording.".into());
        }
        let stride = timeline.stride();
        let grasps = timeline.into_grasps();
        if count > 0 && grasps.iter().all(|g| g.pose.is_none()) {
            missing.push("The board answered no grasp: there are no poses.".into());
        }
        let (model, surfaces) = surfaces(header.dimension, &grasps, &rest.noise);
        let title = title(path, &header);
        Recorded { count, missing, title, header, stride, rest, grasps, model, surfaces }
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
            ..Meta::new(self.header.dimension, self.title)
        };
        Scene { meta, grasps: self.grasps, surfaces, choices: Vec::new() }
    }

    /// The number of the last grasp that a surface is made of.
    fn last_grasp(&self, grown: &Grown) -> u64 {
        self.grasps.get(grown.grasp).map_or(0, |g| g.grasp)
    }
}

/// What a recording is: its description, or its file's name.
fn title(path: &Path, header: &Header) -> String {
    match header.description.as_str() {
        "" => path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned()),
        described => described.to_owned(),
    }
}

/// Bytes of a piece in the file beside those that passed: kind, time, checksum, stuffing, delimiter.
const SEALED: usize = 15;

/// Pieces that are handed over together, and how many such hands may wait.
const BATCH: usize = 1_024;
const WAITING: usize = 8;

/// Tells `ear` of one piece after the other until it has enough, while another thread reads and checks the
/// next ones; says why they ended too early, where they did. `progress` is told in megabytes.
fn ahead<R: BufRead + Send>(
    pieces: &mut Pieces<R>,
    progress: Progress<'_>,
    ear: &mut dyn FnMut(&Piece) -> bool,
) -> Option<io::Error> {
    const MEGABYTE: u64 = 1 << 20;
    thread::scope(|scope| {
        let (send, receive) = sync_channel::<Vec<Piece>>(WAITING);
        // Batches that were heard serve again: a long recording has millions of pieces.
        let (give_back, heard) = channel::<Vec<Piece>>();
        let reader = scope.spawn(move || {
            loop {
                let mut batch = heard.try_recv().unwrap_or_default();
                let (count, failed) = fill(pieces, &mut batch);
                batch.truncate(count);
                if let (done, Some(all)) = pieces.bytes {
                    progress((done / MEGABYTE) as usize, all.div_ceil(MEGABYTE) as usize);
                }
                // Nobody takes it where `ear` has heard enough.
                if send.send(batch).is_err() || count < BATCH {
                    return failed;
                }
            }
        });
        for batch in receive {
            if !batch.iter().all(&mut *ear) {
                break;
            }
            let _ = give_back.send(batch);
        }
        reader
            .join()
            .unwrap_or_else(|_| Some(io::Error::other("the thread that reads it broke off")))
    })
}

/// Reads pieces in the places of those in `batch`; how many came, and what went wrong.
fn fill<R: BufRead>(pieces: &mut Pieces<R>, batch: &mut Vec<Piece>) -> (usize, Option<io::Error>) {
    batch.resize_with(BATCH, || Piece::EMPTY);
    for (count, place) in batch.iter_mut().enumerate() {
        match pieces.read(place) {
            Ok(true) => {}
            Ok(false) => return (count, None),
            Err(error) => return (count, Some(error)),
        }
    }
    (BATCH, None)
}

/// Surfaces of the contacts that the timeline holds, at its poses, and the name of their model; none
/// where nothing fits them.
fn surfaces(dimension: usize, grasps: &[Grasp], noise: &Noise) -> (Option<String>, Vec<Grown>) {
    let mut placed: Vec<Placed> = Vec::new();
    for (at, grasp) in grasps.iter().enumerate() {
        placed_contacts(&mut placed, at, grasp, noise);
    }
    let most = CONTACTS[usize::from(dimension == 3)];
    let contacts = evenly(&placed, most);
    let touching = contacts.iter().map(|p| p.grasp).collect::<std::collections::BTreeSet<_>>();
    if touching.len() < LEAST_GRASPS {
        return (None, Vec::new());
    }
    let all: Vec<Contact> = contacts.iter().map(|p| p.contact).collect();
    let none: Vec<Free> = Vec::new();
    let Ok(shape) = shape(dimension, &all, &none, Poses::Estimated, Choice::Auto, &|_, _| ())
    else {
        return (None, Vec::new());
    };
    let name = shape.model.name().to_owned();
    let reconstruction = Reconstruction::new(shape, contacts);
    (Some(name), grow(dimension, &reconstruction, &|_| Vec::new()))
}

/// Appends the grasp's contacts in the object frame, the doubt about the pose in their deviations.
fn placed_contacts(placed: &mut Vec<Placed>, at: usize, grasp: &Grasp, noise: &Noise) {
    let (point_deviation, normal_deviation) = usual_deviations(noise);
    let Some([x, y, z, qx, qy, qz, qw]) = grasp.pose else { return };
    // A lost grasp says nothing about the shape.
    if is_lost(grasp) {
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
