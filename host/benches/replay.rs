//! Half an hour of a hand that closes 200 times a second, five contacts each time, as a page and as
//! MCAP: `cargo bench -p tactile-host --bench replay`. Says how large the files are.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use divan::Bencher;
use tactile_core::contact::Contact;
use tactile_core::matrix::{Matrix, Vector};
use tactile_core::space::{Spatial, SpatialPose};
use tactile_core::track::{Estimate, Modes, Observability, Status};
use tactile_core::wire::{
    Command, ContactFrame, EstimateFrame, Frame, MAX_FRAME, Reply, Report, encode,
};
use tactile_host::log::recording::{Direction, Header, RecordingWriter};
use tactile_host::slam::recorded::Recorded;
use tactile_host::view::html;

const GRASPS: u32 = 30 * 60 * 200;
const FINGERS: u32 = 5;

/// Contacts all over a ball of 4 cm that turns and wanders.
fn recording() -> Vec<u8> {
    let mut bytes = Vec::new();
    let fingers = ["th", "ff", "mf", "rf", "lf"].map(String::from).to_vec();
    let header = Header::new(3, fingers, "half an hour".into());
    let mut writer = RecordingWriter::new(&mut bytes, &header).unwrap();
    let mut buffer = [0; MAX_FRAME];
    let (mut to_board, mut from_board) = (0u8, 0u8);
    for grasp in 0..GRASPS {
        let turn = grasp as f32 * 1e-4;
        let at = Vector([0.05 * turn.cos(), 0.05 * turn.sin(), 0.0]);
        let pose = SpatialPose::new(at, [0.0, 0.0, (0.5 * turn).sin(), (0.5 * turn).cos()]);
        let time = Duration::from_millis(5 * u64::from(grasp));
        let contacts = (0..FINGERS).map(|finger| {
            let k = (grasp * FINGERS + finger) as f32 * 2.399_963;
            let height = 2.0 * (k * 0.618_034).fract() - 1.0;
            let wide = (1.0 - height * height).sqrt();
            let normal = Vector([wide * k.cos(), wide * k.sin(), height]);
            let point: Vector<3> = Vector(std::array::from_fn(|i| at[i] + 0.04 * normal[i]));
            Command::<Spatial>::Contact(ContactFrame::new(
                &Contact {
                    point,
                    normal: Some(normal),
                    point_deviation: 1e-3,
                    normal_deviation: 0.09,
                    finger: finger as u8,
                },
                0.09,
            ))
        });
        let estimate = Estimate::<Spatial> {
            grasp,
            pose,
            covariance: Matrix([[0.0; 6]; 6]),
            status: Status::Tracking,
            modes: Modes::NONE,
            effective_particles: 4.0,
            observability: Observability::NONE,
            contacts: FINGERS as u16,
            rejected: 0,
            dropped: 0,
            corrected: true,
            resampled: false,
        };
        for command in contacts.chain([Command::Commit]) {
            let frame = Frame { sequence: to_board, time: Default::default(), message: command };
            let sent = encode(&frame, &mut buffer).unwrap();
            writer.append(time, Direction::ToBoard, sent).unwrap();
            let reply = Report::<Spatial>::Reply(Reply { to: to_board, refusal: None });
            let answer = Report::Estimate(EstimateFrame::new(&estimate));
            let answers =
                if command == Command::Commit { vec![answer, reply] } else { vec![reply] };
            for message in answers {
                let frame = Frame { sequence: from_board, time: Default::default(), message };
                let came = encode(&frame, &mut buffer).unwrap();
                writer.append(time, Direction::FromBoard, came).unwrap();
                from_board = from_board.wrapping_add(1);
            }
            to_board = to_board.wrapping_add(1);
        }
    }
    bytes
}

/// A folder with the recording in it.
fn recorded() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("long.tac");
    fs::write(&path, recording()).unwrap();
    (folder, path)
}

fn tell(what: &str, path: &Path) {
    println!("{what}: {} kB", fs::metadata(path).map_or(0, |m| m.len() / 1000));
}

#[divan::bench(sample_count = 3, sample_size = 1)]
fn half_an_hour_as_a_page(bencher: Bencher) {
    let (folder, from) = recorded();
    let to = folder.path().join("long.html");
    bencher.bench_local(|| {
        let scene = Recorded::read(&from, &|_, _| ()).unwrap().scene();
        html::write(&scene, &mut fs::File::create(&to).map(std::io::BufWriter::new).unwrap())
    });
    tell("recording", &from);
    tell("page", &to);
}

#[divan::bench(sample_count = 3, sample_size = 1)]
fn half_an_hour_as_mcap(bencher: Bencher) {
    let (folder, from) = recorded();
    let to = folder.path().join("long.mcap");
    bencher.bench_local(|| {
        let mut out = fs::File::create(&to).map(std::io::BufWriter::new).unwrap();
        Recorded::film(&from, &mut out, &|_, _| ()).unwrap();
    });
    tell("MCAP", &to);
}

fn main() {
    divan::main();
}
