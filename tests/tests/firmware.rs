//! The firmware in QEMU: the same frames, the same bits.

use std::collections::BTreeMap;
use std::time::Duration;

use tactile_core::space::{Planar, Spatial};
use tactile_core::wire::{BoardKind, TrackerKind};
use tactile_host::link::firmware::{self, Machine};
use tactile_host::link::session::settings_for;
use tactile_host::link::{
    Faults, Faulty, Link, LogOutcome, Patience, Session, cycles, qemu, virtual_board,
};
use tactile_host::log::GraspLog;
use tactile_tests::{Sample, board, built, unless_missing};

const GRASPS: usize = 12;
/// Nothing but a lost greeting is said twice, however busy the machine is that emulates.
const PATIENT: Patience = Patience {
    greeting: Duration::from_secs(1),
    reply: Duration::from_secs(10),
    update: Duration::from_secs(60),
    attempts: 20,
};
const BOOTSTRAP: TrackerKind = TrackerKind::Bootstrap;

fn run<S: Sample>(link: impl Link, patience: Patience) -> LogOutcome<S> {
    follow(&S::log(GRASPS), link, patience)
}

fn follow<S: Sample>(log: &GraspLog, link: impl Link, patience: Patience) -> LogOutcome<S> {
    finish(Session::open(link, patience).unwrap(), log)
}

fn finish<S: Sample, L: Link>(session: Session<S, L>, log: &GraspLog) -> LogOutcome<S> {
    session.run(log, settings_for(log, 7), |_, _| ()).unwrap()
}

/// The estimates' bytes: what equality of `f32` would let pass, a zero's sign or a NaN, shows.
fn bits<S: Sample>(outcome: &LogOutcome<S>) -> Vec<Vec<u8>> {
    outcome
        .grasps
        .iter()
        .map(|g| {
            let mut buffer = [0; tactile_core::wire::MAX_FRAME];
            let frame = tactile_core::wire::Frame {
                sequence: 0,
                time: tactile_core::wire::Clock(0),
                message: tactile_core::wire::Report::Estimate(g.estimate),
            };
            tactile_core::wire::encode(&frame, &mut buffer).unwrap().to_vec()
        })
        .collect()
}

fn agrees_with_the_virtual_board<S: Sample>(
    machine: Machine,
    kind: BoardKind,
    tracker: TrackerKind,
) {
    let Some((elf, emulated)) = board::<S>(machine, tracker) else { return };
    let session = Session::<S, _>::open(emulated, PATIENT).unwrap();
    let greetings = session.repeated();
    let emulated = finish(session, &S::log(GRASPS));
    let here = run::<S>(virtual_board::start(S::DIMENSION, tracker).unwrap(), Patience::default());
    assert_eq!(bits(&emulated), bits(&here));
    assert!(emulated.grasps[1..].iter().all(|g| g.estimate.corrected()));
    assert_eq!((emulated.hello.board, here.hello.board), (kind, BoardKind::Virtual));
    assert_eq!(emulated.hello.map, here.hello.map);
    assert_eq!((emulated.hello.tracker, here.hello.tracker), (tracker, tracker));
    // The greeting may come before the board listens, or while it begins to: then it is cut, and sent
    // again. Nothing is damaged later.
    assert_eq!((emulated.repeated, emulated.received.damaged()), (greetings, 0));
    let [first, health] = [0, emulated.grasps.len() - 1].map(|grasp| emulated.grasps[grasp].health);
    assert!(first.received.damaged() <= emulated.repeated);
    assert_eq!(health.received.damaged(), first.received.damaged());
    assert_eq!((health.overruns, health.refused), (0, 0));
    assert!(health.peak_stack > 500 && health.peak_stack < health.stack / 2, "{health:?}");
    // Nothing static has a start value, so that RAM costs no flash.
    let footprint = firmware::footprint(&elf).unwrap();
    assert!(footprint.initialised < 64, "{footprint:?}");
    assert!(footprint.flash < 256 << 10 && footprint.ram < 96 << 10, "{footprint:?}");
    eprintln!("{kind:?}: {footprint:?}, deepest stack {} of {} B", health.peak_stack, health.stack);
}

#[test]
fn an_emulated_stm32f405_tracks_bit_for_bit_in_the_plane() {
    agrees_with_the_virtual_board::<Planar>(Machine::Stm32f405, BoardKind::Stm32f405, BOOTSTRAP);
}

#[test]
fn an_emulated_stm32f405_tracks_bit_for_bit_in_space() {
    agrees_with_the_virtual_board::<Spatial>(Machine::Stm32f405, BoardKind::Stm32f405, BOOTSTRAP);
}

/// A map whose flat sides have taken the contacts off its places.
fn faces_agree_with_the_virtual_board<S: Sample>() {
    let Some((_, emulated)) = board::<S>(Machine::Stm32f405, BOOTSTRAP) else { return };
    let log = S::flat(2 * GRASPS);
    let here = virtual_board::start(S::DIMENSION, BOOTSTRAP).unwrap();
    let [emulated, here] =
        [follow::<S>(&log, emulated, PATIENT), follow::<S>(&log, here, Patience::default())];
    assert_eq!(bits(&emulated), bits(&here));
    let contacts: usize = log.grasps.iter().map(|g| g.contacts.len()).sum();
    assert!(contacts > 2 * usize::from(here.hello.map));
    // Its places alone would have had to let more contacts go.
    let dropped: usize = here.grasps.iter().map(|g| usize::from(g.estimate.dropped)).sum();
    eprintln!("{}D, flat: dropped {dropped} of {contacts}, map {}", S::DIMENSION, here.hello.map);
    assert!(dropped < (contacts - usize::from(here.hello.map)) / 2);
    let health = emulated.grasps.last().unwrap().health;
    assert!(health.peak_stack < health.stack / 2, "{health:?}");
    eprintln!("{}D, flat: deepest stack {} B", S::DIMENSION, health.peak_stack);
}

#[test]
fn flat_sides_track_bit_for_bit_in_the_plane() {
    faces_agree_with_the_virtual_board::<Planar>();
}

#[test]
fn flat_sides_track_bit_for_bit_in_space() {
    faces_agree_with_the_virtual_board::<Spatial>();
}

#[test]
fn hypotheses_track_bit_for_bit_in_the_plane() {
    let kind = BoardKind::Stm32f405;
    agrees_with_the_virtual_board::<Planar>(Machine::Stm32f405, kind, TrackerKind::Hypotheses);
}

#[test]
fn hypotheses_track_bit_for_bit_in_space() {
    let kind = BoardKind::Stm32f405;
    agrees_with_the_virtual_board::<Spatial>(Machine::Stm32f405, kind, TrackerKind::Hypotheses);
}

#[test]
fn particles_with_faces_track_bit_for_bit_in_the_plane() {
    let kind = BoardKind::Stm32f405;
    agrees_with_the_virtual_board::<Planar>(Machine::Stm32f405, kind, TrackerKind::RaoBlackwell);
}

#[test]
fn particles_with_faces_track_bit_for_bit_in_space() {
    let kind = BoardKind::Stm32f405;
    agrees_with_the_virtual_board::<Spatial>(Machine::Stm32f405, kind, TrackerKind::RaoBlackwell);
}

#[test]
fn curved_objects_track_bit_for_bit_in_the_plane() {
    let kind = BoardKind::Stm32f405;
    agrees_with_the_virtual_board::<Planar>(Machine::Stm32f405, kind, TrackerKind::Curved);
}

#[test]
fn curved_objects_track_bit_for_bit_in_space() {
    let kind = BoardKind::Stm32f405;
    agrees_with_the_virtual_board::<Spatial>(Machine::Stm32f405, kind, TrackerKind::Curved);
}

#[test]
fn any_object_tracks_bit_for_bit_in_the_plane() {
    let kind = BoardKind::Stm32f405;
    agrees_with_the_virtual_board::<Planar>(Machine::Stm32f405, kind, TrackerKind::Automatic);
}

#[test]
fn any_object_tracks_bit_for_bit_in_space() {
    let kind = BoardKind::Stm32f405;
    agrees_with_the_virtual_board::<Spatial>(Machine::Stm32f405, kind, TrackerKind::Automatic);
}

#[test]
fn the_second_board_tracks_bit_for_bit() {
    agrees_with_the_virtual_board::<Planar>(Machine::Mps2An386, BoardKind::Mps2An386, BOOTSTRAP);
}

#[test]
fn firmware_survives_a_bad_line() {
    let Some((_, emulated)) = board::<Planar>(Machine::Stm32f405, BOOTSTRAP) else { return };
    let faults = Faults { drop: 0.03, corrupt: 0.03, double: 0.03, reorder: 0.03 };
    let mut link = Faulty::new(emulated, faults, 5);
    // Noise before the first frame, as a line that is plugged in makes.
    link.send(&[0x55, 0xff, 0x13, 0x00, 0x80]).unwrap();
    const SOON: Duration = Duration::from_millis(60);
    let patience =
        Patience { greeting: SOON, reply: SOON, update: Duration::from_secs(2), attempts: 30 };
    let faulty = run::<Planar>(&mut link, patience);
    assert!(link.injected() > 5 && faulty.repeated > 0);
    let clean = run::<Planar>(virtual_board::start(2, BOOTSTRAP).unwrap(), patience);
    assert_eq!(bits(&faulty), bits(&clean));
    let health = faulty.grasps.last().unwrap().health;
    assert!(health.received.damaged() > 0 || faulty.received.damaged() > 0);
    assert_eq!(health.grasps, GRASPS as u32);
}

#[test]
fn instructions_are_counted() {
    let machine = Machine::Mps2An386;
    let Some(elf) = built("bench", machine) else { return };
    let limit = Duration::from_secs(120);
    let Some(printed) = unless_missing(qemu::run(&elf, machine, true, limit)) else { return };
    eprintln!("{printed}");
    let mut counts = BTreeMap::new();
    let mut part = "";
    for line in printed.lines() {
        match line.rsplit_once(' ').and_then(|(name, n)| Some((name, n.parse::<u64>().ok()?))) {
            Some((name, n)) => drop(counts.insert((part, name.trim()), n)),
            None => part = line.split(',').next().unwrap_or(""),
        }
    }
    // Counts are exact, so that a loop of known length gives the scale; these bounds are wide.
    let mean = counts[&("thin plate", "mean at a point")];
    assert!((2_000..10_000).contains(&mean), "{mean}");
    let updates: Vec<u64> = counts
        .iter()
        .filter(|((_, name), _)| name.contains("grasp update"))
        .map(|(_, &n)| n)
        .collect();
    assert!(updates.len() >= 2 && updates.iter().all(|n| (100_000..100_000_000).contains(n)));
    // Ten grasps are compared within a tenth of a second of 168 MHz, a cycle taken for an instruction.
    let choices: Vec<u64> = counts
        .iter()
        .filter(|((_, name), _)| name.contains("best of 10"))
        .map(|(_, &n)| n)
        .collect();
    assert_eq!(choices.len(), 8);
    assert!(choices.iter().all(|n| (10_000..16_800_000).contains(n)), "{choices:?}");
    let again = unless_missing(qemu::run(&elf, machine, true, limit));
    assert_eq!(again.as_deref(), Some(printed.as_str()));
}

#[test]
fn sensors_keep_within_their_cycles() {
    let machine = Machine::Mps2An386;
    let Some(elf) = built("bench-sensing", machine) else { return };
    let limit = Duration::from_secs(120);
    let Some(printed) = unless_missing(cycles::run(&elf, machine, limit)) else { return };
    eprintln!("{printed}");
    let cycles = |name: &str| -> Vec<u64> {
        let of = |line: &str| line.rsplit_once(' ').and_then(|(_, cycles)| cycles.parse().ok());
        printed.lines().filter(|line| line.trim().starts_with(name)).filter_map(of).collect()
    };
    let wrench = cycles("wrench");
    assert!(wrench.len() == 3 && wrench.iter().all(|c| *c <= 3_400), "{wrench:?}");
    let electrodes = cycles("electrodes");
    assert!(electrodes.len() == 2 && electrodes.iter().all(|c| *c <= 2_500), "{electrodes:?}");
    // Five fingers at 1 kHz in 15 % of 168 MHz.
    let [finger] = cycles("one reading, begun and fetched")[..] else { panic!("{printed}") };
    assert!(5 * 1000 * finger <= 168_000_000 * 15 / 100, "{finger}");
}

/// The map's cycles beside the least that its arithmetic takes: within what they were when this was
/// written, and not below what nothing can be below.
#[test]
fn a_map_keeps_near_the_floor_of_its_arithmetic() {
    let machine = Machine::Mps2An386;
    let Some(elf) = built("bench-map", machine) else { return };
    let limit = Duration::from_secs(120);
    let Some(printed) = unless_missing(cycles::run(&elf, machine, limit)) else { return };
    eprintln!("{printed}");
    let most = [("append", 1.65), ("mean at", 1.6), ("mean and", 4.0)];
    let mut seen = 0;
    for (name, most) in most {
        for line in printed.lines().filter(|line| line.trim().starts_with(name)) {
            let numbers: Vec<f64> =
                line.split_whitespace().filter_map(|word| word.parse().ok()).collect();
            let [floor, instructions, cycles] = numbers[..] else { panic!("{line}") };
            assert!(floor < cycles && instructions < cycles, "{line}");
            assert!(cycles < most * floor, "{line}");
            seen += 1;
        }
    }
    assert_eq!(seen, 9);
}
