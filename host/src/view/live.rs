//! A live view: the scene of a running session in a browser, over HTTP and a WebSocket.
//!
//! `GET /` is the page ([`super::html::live`]), `/live` the WebSocket that sends the messages of
//! [`super::scene`], one a frame of text: to each viewer the scene so far, then what comes, as it
//! comes. Whoever tells never waits for a viewer (`history` says how). Threads of the standard
//! library: one that opens the door, one for each viewer.

mod door;
mod history;

use std::io;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Error, Message, Utf8Bytes, WebSocket};

use self::door::{Refused, Visitor};
use self::history::{History, Next, Place};
use super::html;
use super::scene::{Choice, Grasp, Meta, Surface};

/// Connections at most: beyond, a visitor is asked to come back.
const MOST: usize = 32;

/// How often the door is looked at, and how long a viewer without news waits before it listens.
const DOOR: Duration = Duration::from_millis(20);
const QUIET: Duration = Duration::from_millis(100);

/// A viewer that takes nothing for so long is let go; it may connect again.
const STALLED: Duration = Duration::from_secs(10);

/// How long the last messages have when the view closes.
const FAREWELL: Duration = Duration::from_secs(1);

/// Frames a viewer may send in one turn; nothing in them matters.
const HEARD: usize = 32;

/// A server of one scene, until it is dropped.
///
/// ```
/// use tactile_host::view::{live::LiveView, scene::{Grasp, Meta}};
///
/// let view = LiveView::open("127.0.0.1", 0)?;
/// println!("watch at {}", view.url());
/// view.begin(&Meta::new(2, "three touches"));
/// for grasp in 0..3 {
///     view.grasp(Grasp { grasp, merged: 1, ..Grasp::default() });
/// }
/// view.end();
/// # Ok::<(), std::io::Error>(())
/// ```
pub struct LiveView {
    address: SocketAddr,
    shared: Arc<Shared>,
    door: Option<JoinHandle<()>>,
}

/// What the threads share.
struct Shared {
    history: Mutex<History>,
    /// Something was told, or somebody left.
    news: Condvar,
    /// What the address was asked for as.
    name: String,
    page: String,
    connections: AtomicUsize,
    viewers: AtomicUsize,
    closing: AtomicBool,
}

impl Shared {
    fn history(&self) -> MutexGuard<'_, History> {
        self.history.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn tell(&self, change: impl FnOnce(&mut History)) {
        change(&mut self.history());
        self.news.notify_all();
    }

    /// What the viewer at `place` is told next, at latest after [`QUIET`].
    fn next(&self, place: &mut Place) -> Next {
        let mut history = self.history();
        let next = history.next(place);
        if !matches!(next, Next::Nothing) || self.closing.load(Ordering::Relaxed) {
            return next;
        }
        let waited = self.news.wait_timeout(history, QUIET);
        history = waited.unwrap_or_else(PoisonError::into_inner).0;
        history.next(place)
    }
}

impl LiveView {
    /// Opens the view at `host` (a name or an address of this machine) and `port`; 0 takes any free
    /// one.
    ///
    /// # Errors
    /// When there is no such address here, or it is taken.
    pub fn open(host: &str, port: u16) -> io::Result<Self> {
        let listener = TcpListener::bind((host, port))?;
        let address = listener.local_addr()?;
        // The door closes without a knock.
        listener.set_nonblocking(true)?;
        let shared = Arc::new(Shared {
            history: Mutex::default(),
            news: Condvar::new(),
            name: host.to_owned(),
            page: html::live(door::PATH),
            connections: AtomicUsize::new(0),
            viewers: AtomicUsize::new(0),
            closing: AtomicBool::new(false),
        });
        let inside = Arc::clone(&shared);
        let door = thread::Builder::new()
            .name("live view".into())
            .spawn(move || open_door(&listener, &inside))?;
        Ok(LiveView { address, shared, door: Some(door) })
    }

    /// Where it is.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What to type into a browser.
    pub fn url(&self) -> String {
        let (name, port) = (&self.shared.name, self.address.port());
        if name.contains(':') {
            format!("http://[{name}]:{port}/")
        } else {
            format!("http://{name}:{port}/")
        }
    }

    /// Viewers that are connected.
    pub fn viewers(&self) -> usize {
        self.shared.viewers.load(Ordering::Relaxed)
    }

    /// A scene begins; the one before is gone.
    pub fn begin(&self, meta: &Meta) {
        self.shared.tell(|history| history.begin(meta));
    }

    /// The hand closed once more.
    pub fn grasp(&self, grasp: Grasp) {
        self.shared.tell(|history| history.grasp(grasp));
    }

    /// The surface as it is known now.
    pub fn surface(&self, surface: &Surface) {
        self.shared.tell(|history| history.surface(surface));
    }

    /// What an exploration knows now, and among what it chose the next grasp.
    pub fn choice(&self, choice: &Choice) {
        self.shared.tell(|history| history.choice(choice));
    }

    /// Nothing more will come; who connects later still gets the scene.
    pub fn end(&self) {
        self.shared.tell(History::end);
    }
}

impl Drop for LiveView {
    /// Viewers get what was told before, as far as they take it soon.
    fn drop(&mut self) {
        let shared = &self.shared;
        shared.closing.store(true, Ordering::Relaxed);
        shared.news.notify_all();
        if let Some(door) = self.door.take() {
            let _ = door.join();
        }
        let deadline = Instant::now() + FAREWELL;
        let mut history = shared.history();
        while shared.viewers.load(Ordering::Relaxed) > 0 {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                break;
            }
            let waited = shared.news.wait_timeout(history, left);
            history = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

/// Lets visitors in until the view closes.
fn open_door(listener: &TcpListener, shared: &Arc<Shared>) {
    while !shared.closing.load(Ordering::Relaxed) {
        // Nobody there, somebody who left again, or no more files: later.
        let Ok((stream, _)) = listener.accept() else {
            thread::sleep(DOOR);
            continue;
        };
        let inside = Arc::clone(shared);
        let connections = shared.connections.fetch_add(1, Ordering::Relaxed);
        let visit = move || {
            // A connection that breaks concerns nobody else.
            let _ = receive(stream, &inside, connections < MOST);
            inside.connections.fetch_sub(1, Ordering::Relaxed);
        };
        // Refusing takes a thread too, for a moment; floods are cut off before.
        let spawned = connections < 2 * MOST
            && thread::Builder::new().name("live viewer".into()).spawn(visit).is_ok();
        if !spawned {
            shared.connections.fetch_sub(1, Ordering::Relaxed);
        }
    }
}

fn receive(mut stream: TcpStream, shared: &Shared, room: bool) -> io::Result<()> {
    // Some systems hand the listener's mode on.
    stream.set_nonblocking(false)?;
    if !room {
        return door::answer(stream, Err(Refused(503, "Service Unavailable")));
    }
    match door::greet(&mut stream, &shared.name)? {
        Ok(Visitor::Reader) => door::answer(stream, Ok(&shared.page)),
        Ok(Visitor::Viewer(heard)) => {
            shared.viewers.fetch_add(1, Ordering::Relaxed);
            let _ = attend(stream, heard, shared);
            // Under the lock, so that who waits for the last viewer does not miss it.
            let history = shared.history();
            shared.viewers.fetch_sub(1, Ordering::Relaxed);
            drop(history);
            shared.news.notify_all();
            Ok(())
        }
        Err(refused) => door::answer(stream, Err(refused)),
    }
}

/// Tells a viewer the scene until one of both leaves.
fn attend(stream: TcpStream, heard: Vec<u8>, shared: &Shared) -> Result<(), Error> {
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(Duration::from_millis(1)))?;
    stream.set_write_timeout(Some(STALLED))?;
    let config = WebSocketConfig::default()
        .read_buffer_size(4 * 1024)
        .max_message_size(Some(64 * 1024))
        .max_frame_size(Some(64 * 1024));
    let mut socket = WebSocket::from_partially_read(stream, heard, Role::Server, Some(config));
    let mut place = Place::default();
    loop {
        let closing = shared.closing.load(Ordering::Relaxed);
        match shared.next(&mut place) {
            Next::Lines(lines) => write(&mut socket, lines)?,
            Next::All(scene) => write(&mut socket, scene.into_lines())?,
            Next::Nothing if closing => {
                socket.close(None)?;
                return socket.flush();
            }
            Next::Nothing => {}
        }
        for _ in 0..HEARD {
            match socket.read() {
                // Pings are answered by the library; nothing else is expected.
                Ok(_) => {}
                Err(Error::Io(e))
                    if matches!(e.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) =>
                {
                    break;
                }
                Err(gone) => return Err(gone),
            }
        }
    }
}

fn write(
    socket: &mut WebSocket<TcpStream>,
    lines: impl IntoIterator<Item = Utf8Bytes>,
) -> Result<(), Error> {
    lines.into_iter().try_for_each(|line| socket.write(Message::Text(line)))?;
    socket.flush()
}

#[cfg(test)]
mod tests;
