//! Conversations with boards and lines that behave badly.

use std::cell::Cell;
use std::collections::VecDeque;

use tactile_core::space::Planar;
use tactile_core::wire::TrackerKind;

use super::*;
use crate::link::virtual_board;
use crate::space::{Bridge, Point};

fn board() -> Box<dyn Link> {
    virtual_board::start(2, TrackerKind::Bootstrap).unwrap()
}

fn patience(milliseconds: u64, attempts: u32) -> Patience {
    let time = Duration::from_millis(milliseconds);
    Patience { greeting: time, reply: time, update: time, attempts }
}

fn touch(x: f64, y: f64) -> Contact<Planar> {
    Contact {
        point: Planar::vector(&Point::new(x, y, 0.0)),
        normal: None,
        point_deviation: Settings::DEFAULT.point,
        normal_deviation: Settings::DEFAULT.normal,
        finger: 0,
    }
}

/// Longer than any conversation here takes, so that one without end fails.
const LONG: Duration = Duration::from_secs(20);

fn too_long(start: Instant) -> io::Result<()> {
    if start.elapsed() < LONG { Ok(()) } else { Err(io::Error::other("nobody stops listening")) }
}

/// A line on which text comes without end.
struct Chatter(Instant);

impl Link for Chatter {
    fn send(&mut self, _: &[u8]) -> io::Result<()> {
        Ok(())
    }

    fn receive(&mut self, bytes: &mut [u8], _: Duration) -> io::Result<usize> {
        too_long(self.0)?;
        bytes.fill(b'a');
        Ok(bytes.len())
    }
}

#[test]
fn a_line_that_never_falls_silent_is_given_up() {
    let start = Instant::now();
    let error = Session::<Planar, _>::open(Chatter(start), patience(20, 3)).err().unwrap();
    assert!(matches!(error, SessionError::Silent { command: "hello", attempts: 3, .. }), "{error}");
    assert!(start.elapsed() >= Duration::from_millis(60), "{:?}", start.elapsed());
}

/// A board that streams contacts as fast as they are taken while `on` is set.
struct Streaming<'a> {
    board: Box<dyn Link>,
    on: &'a Cell<bool>,
    sent: &'a Cell<u32>,
    queue: VecDeque<u8>,
    start: Instant,
}

impl Link for Streaming<'_> {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.board.send(bytes)
    }

    fn receive(&mut self, bytes: &mut [u8], timeout: Duration) -> io::Result<usize> {
        too_long(self.start)?;
        if self.on.get() && self.queue.is_empty() {
            let number = self.sent.get();
            self.sent.set(number + 1);
            let contact = ContactFrame::new(&touch(0.03, 0.0), Settings::DEFAULT.normal);
            let message = Report::Contact(contact);
            // Beyond the numbers of the board's own frames.
            let sequence = (number as u8).wrapping_add(64);
            let frame = Frame { sequence, time: Clock(number), message };
            let mut buffer = [0; MAX_FRAME];
            self.queue.extend(encode(&frame, &mut buffer).unwrap());
        }
        match (self.queue.pop_front(), bytes.first_mut()) {
            (Some(byte), Some(place)) => {
                *place = byte;
                Ok(1)
            }
            _ => self.board.receive(bytes, timeout),
        }
    }
}

#[test]
fn listening_ends_when_its_time_is_over_and_loses_no_contact() {
    let (on, sent) = (Cell::new(false), Cell::new(0));
    let start = Instant::now();
    let link = Streaming { board: board(), on: &on, sent: &sent, queue: VecDeque::new(), start };
    let mut session = Session::<Planar, _>::open(link, Patience::default()).unwrap();
    on.set(true);
    let mut heard = Vec::new();
    for _ in 0..5 {
        session.listen(Duration::from_millis(7)).unwrap();
        heard.extend(session.contacts());
    }
    assert!(heard.len() > 10);
    on.set(false);
    // The rest of the frame that was half heard comes before the answer.
    session.ping().unwrap();
    heard.extend(session.contacts());
    let times: Vec<u32> = heard.iter().map(|felt| felt.time).collect();
    assert_eq!(times, (0..sent.get()).collect::<Vec<_>>());
}

#[test]
fn an_answer_that_is_there_is_heard_without_patience() {
    let mut session = Session::<Planar, _>::open(board(), patience(0, 1)).unwrap();
    let outcome = session.grasp(None, &[touch(0.03, 0.0)], &[]).unwrap();
    assert_eq!((outcome.estimate.grasp, session.repeated()), (0, 0));
}

#[test]
fn contacts_and_free_points_that_do_not_fit_are_counted_each() {
    let mut session = Session::<Planar, _>::open(board(), patience(500, 1)).unwrap();
    let room = usize::from(session.hello().unwrap().contacts);
    let contacts = vec![touch(0.03, 0.0); room + 2];
    let free = vec![FreePoint { point: contacts[0].point, finger: 1 }; room + 5];
    let outcome = session.grasp(None, &contacts, &free).unwrap();
    assert_eq!((outcome.not_sent, outcome.free_not_sent), (2, 5));
    assert_eq!(outcome.health.overfull, 0);
    let outcome = session.grasp(None, &contacts[..room], &free[..room]).unwrap();
    assert_eq!((outcome.not_sent, outcome.free_not_sent), (0, 0));
}

/// A board that hears so many more frames.
struct Deaf<'a>(Box<dyn Link>, &'a Cell<u32>);

impl Link for Deaf<'_> {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        match self.1.get().checked_sub(1) {
            None => Ok(()),
            Some(left) => {
                self.1.set(left);
                self.0.send(bytes)
            }
        }
    }

    fn receive(&mut self, bytes: &mut [u8], timeout: Duration) -> io::Result<usize> {
        self.0.receive(bytes, timeout)
    }
}

#[test]
fn a_grasp_that_broke_off_stays_with_the_board_until_it_is_reset() {
    let hears = Cell::new(u32::MAX);
    let link = Deaf(board(), &hears);
    let mut session = Session::<Planar, _>::open(link, patience(0, 2)).unwrap();
    let contacts = [touch(0.03, 0.0), touch(0.0, 0.02)];
    let motion = Planar::pose(&crate::space::planar(0.01, 0.0, 0.0));
    session.grasp(None, &contacts, &[]).unwrap();

    // The motion and one contact.
    hears.set(2);
    let error = session.grasp(Some(&motion), &contacts, &[]).unwrap_err();
    assert!(matches!(error, SessionError::Silent { command: "contact", .. }), "{error}");
    hears.set(u32::MAX);
    let error = session.grasp(Some(&motion), &contacts, &[]).unwrap_err();
    let refusal = Refusal::MotionTwice;
    assert!(matches!(error, SessionError::Refused { refusal: r, .. } if r == refusal), "{error}");

    session.reset().unwrap();
    let outcome = session.grasp(Some(&motion), &contacts, &[]).unwrap();
    assert_eq!(outcome.estimate.grasp, 0);
}
