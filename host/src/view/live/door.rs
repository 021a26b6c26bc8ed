//! Who comes in: reads a request, whatever it is, and says what to do with it.
//!
//! A page of another site must not look in: a browser says which site a request comes from (`Origin`),
//! and which name it believes to speak to (`Host`). Both have to be ours, also where a name that
//! somebody else owns was made to point here.

use std::io::{self, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::time::{Duration, Instant};

use tungstenite::handshake::machine::TryParse;
use tungstenite::handshake::server::{Request, create_response, write_response};
use tungstenite::http::{Method, header};

/// Where viewers connect to.
pub(super) const PATH: &str = "/live";

/// How long a request may take, and how long it may be.
const PATIENCE: Duration = Duration::from_secs(3);
const LONGEST: usize = 8 * 1024;

/// What somebody wants.
pub(super) enum Visitor {
    /// The page.
    Reader,
    /// The scene as it comes: shook hands already. What it sent behind the request comes along.
    Viewer(Vec<u8>),
}

/// A request that is not served, as status and reason.
#[derive(Debug, PartialEq)]
pub(super) struct Refused(pub u16, pub &'static str);

const MALFORMED: Refused = Refused(400, "Bad Request");
const FOREIGN: Refused = Refused(403, "Forbidden");

/// Reads a request and shakes hands with a viewer. `name` is what this address was asked for as.
///
/// # Errors
/// What to answer instead, or an error of the connection.
pub(super) fn greet(stream: &mut TcpStream, name: &str) -> io::Result<Result<Visitor, Refused>> {
    let deadline = Instant::now() + PATIENCE;
    let mut heard = Vec::new();
    let (length, request) = loop {
        match Request::try_parse(&heard) {
            Ok(Some(parsed)) => break parsed,
            Ok(None) if heard.len() < LONGEST => {}
            Ok(None) => return Ok(Err(Refused(431, "Request Header Fields Too Large"))),
            Err(_) => return Ok(Err(MALFORMED)),
        }
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Ok(Err(Refused(408, "Request Timeout")));
        }
        stream.set_read_timeout(Some(left))?;
        let mut bytes = [0; 1024];
        match stream.read(&mut bytes) {
            Ok(0) => return Ok(Err(MALFORMED)),
            Ok(count) => heard.extend_from_slice(&bytes[..count]),
            Err(e) if matches!(e.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {}
            Err(e) => return Err(e),
        }
    };
    let local = stream.local_addr()?;
    if let Err(refused) = check(&request, local, name) {
        return Ok(Err(refused));
    }
    match request.uri().path() {
        "/" => Ok(Ok(Visitor::Reader)),
        PATH => match create_response(&request) {
            Ok(response) => {
                write_response(&mut *stream, &response).map_err(io::Error::other)?;
                Ok(Ok(Visitor::Viewer(heard.split_off(length))))
            }
            Err(_) => Ok(Err(Refused(426, "Upgrade Required"))),
        },
        _ => Ok(Err(Refused(404, "Not Found"))),
    }
}

/// Whether a request is ours to answer.
fn check(request: &Request, local: SocketAddr, name: &str) -> Result<(), Refused> {
    if request.method() != Method::GET {
        return Err(Refused(405, "Method Not Allowed"));
    }
    let one = |header| {
        let mut values = request.headers().get_all(header).iter();
        match (values.next(), values.next()) {
            (None, _) => Ok(None),
            (Some(value), None) => value.to_str().map(Some).map_err(|_| MALFORMED),
            (Some(_), Some(_)) => Err(MALFORMED),
        }
    };
    let host = one(header::HOST)?.ok_or(MALFORMED)?;
    if !is_ours(host, local, name) {
        return Err(FOREIGN);
    }
    match one(header::ORIGIN)? {
        // A browser always says; other programs need not.
        None => Ok(()),
        Some(origin) if origin.eq_ignore_ascii_case(&format!("http://{host}")) => Ok(()),
        Some(_) => Err(FOREIGN),
    }
}

/// Whether `host` (a name and a port) names this end of the connection.
fn is_ours(host: &str, local: SocketAddr, name: &str) -> bool {
    let port = local.port();
    let mut names = vec![local.to_string(), format!("{name}:{port}")];
    if local.ip().is_loopback() {
        names.push(format!("localhost:{port}"));
    }
    let port = format!(":{port}");
    names.iter().any(|ours| {
        let short = ours.strip_suffix(&port).filter(|_| port == ":80");
        host.eq_ignore_ascii_case(ours) || short.is_some_and(|s| host.eq_ignore_ascii_case(s))
    })
}

/// Answers with a page of HTML, or with the reason why not, and hangs up.
///
/// # Errors
/// When the connection breaks.
pub(super) fn answer(mut stream: TcpStream, page: Result<&str, Refused>) -> io::Result<()> {
    let (status, reason, kind, body) = match &page {
        Ok(page) => (200, "OK", "text/html; charset=utf-8", (*page).to_owned()),
        Err(Refused(status, reason)) => (*status, *reason, "text/plain", format!("{reason}\n")),
    };
    // The page needs nothing from anywhere else, and nobody may frame it.
    let head = format!(
        "HTTP/1.1 {status} {reason}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\n\
         Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\n\
         Content-Security-Policy: frame-ancestors 'none'\r\nConnection: close\r\n\r\n",
        body.len()
    );
    stream.set_write_timeout(Some(PATIENCE))?;
    stream.write_all(head.as_bytes())?;
    stream.write_all(body.as_bytes())?;
    stream.shutdown(Shutdown::Write)?;
    // Closed with something unread, a connection takes back what was answered.
    stream.set_read_timeout(Some(Duration::from_millis(200)))?;
    let mut rest = [0; 4096];
    for _ in 0..16 {
        match stream.read(&mut rest) {
            Ok(0) | Err(_) => break,
            Ok(_) => {}
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(text: &str) -> Result<(), Refused> {
        let (_, request) = Request::try_parse(text.as_bytes()).unwrap().unwrap();
        check(&request, "127.0.0.1:7000".parse().unwrap(), "lab.local")
    }

    #[test]
    fn only_our_own_names_are_answered() {
        for host in ["127.0.0.1:7000", "localhost:7000", "LocalHost:7000", "lab.local:7000"] {
            assert_eq!(verdict(&format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n")), Ok(()), "{host}");
        }
        for host in ["evil.example:7000", "127.0.0.1", "127.0.0.1:7001", "127.0.0.1:7000.evil", ""] {
            let verdict = verdict(&format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n"));
            assert_eq!(verdict, Err(FOREIGN), "{host}");
        }
        assert_eq!(verdict("GET / HTTP/1.1\r\n\r\n"), Err(MALFORMED));
        let two = "GET / HTTP/1.1\r\nHost: 127.0.0.1:7000\r\nHost: evil.example\r\n\r\n";
        assert_eq!(verdict(two), Err(MALFORMED));
        // Elsewhere `localhost` is not this machine.
        let public = "192.0.2.7:80".parse().unwrap();
        assert!(is_ours("192.0.2.7", public, "lab.local") && is_ours("lab.local", public, "lab.local"));
        assert!(!is_ours("localhost:80", public, "lab.local"));
        let six = "[::1]:7000".parse().unwrap();
        assert!(is_ours("[::1]:7000", six, "::1") && is_ours("localhost:7000", six, "::1"));
    }

    #[test]
    fn pages_of_other_sites_are_not() {
        let from = |origin: &str| {
            verdict(&format!("GET /live HTTP/1.1\r\nHost: localhost:7000\r\nOrigin: {origin}\r\n\r\n"))
        };
        assert_eq!(from("http://localhost:7000"), Ok(()));
        for origin in ["http://evil.example", "null", "https://localhost:7000", "http://localhost"] {
            assert_eq!(from(origin), Err(FOREIGN), "{origin}");
        }
        assert_eq!(verdict("POST / HTTP/1.1\r\nHost: localhost:7000\r\n\r\n").unwrap_err().0, 405);
    }
}
