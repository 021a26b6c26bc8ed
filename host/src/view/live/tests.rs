use std::io::{Read, Write};

use serde_json::Value;
use tungstenite::client::IntoClientRequest;
use tungstenite::stream::MaybeTlsStream;

use super::*;
use crate::view::scene::Packed;

type Client = WebSocket<MaybeTlsStream<TcpStream>>;

fn view() -> LiveView {
    LiveView::open("127.0.0.1", 0).unwrap()
}

fn connect(view: &LiveView) -> Client {
    tungstenite::connect(format!("ws://{}/live", view.address())).unwrap().0
}

/// The next message; `None` when the server closes.
fn hear(client: &mut Client) -> Option<Value> {
    loop {
        match client.read() {
            Ok(Message::Text(text)) => return Some(serde_json::from_str(&text).unwrap()),
            Ok(Message::Close(_)) | Err(_) => return None,
            Ok(_) => {}
        }
    }
}

/// Everything until the scene ends.
fn scene(client: &mut Client) -> Vec<Value> {
    let mut messages = Vec::new();
    while let Some(message) = hear(client) {
        let ended = message["type"] == "end";
        messages.push(message);
        if ended {
            break;
        }
    }
    messages
}

/// What raw bytes are answered with.
fn say(view: &LiveView, request: &[u8]) -> String {
    let mut stream = TcpStream::connect(view.address()).unwrap();
    // The server may hang up before it has read all.
    let _ = stream.write_all(request);
    let _ = stream.shutdown(std::net::Shutdown::Write);
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8(answer).unwrap()
}

fn grasp(number: u64, contacts: usize) -> Grasp {
    let one = [number as f32, 0.5, 0.25, 1.0, 0.0, 0.0];
    Grasp {
        grasp: number,
        merged: 1,
        touched: contacts as u64,
        contacts: Packed(one.repeat(contacts)),
        fingers: Packed(vec![0; contacts]),
        ..Grasp::default()
    }
}

fn sum(messages: &[Value], field: &str) -> u64 {
    messages.iter().filter_map(|m| m[field].as_u64()).sum()
}

#[test]
fn the_page_is_served_and_says_where_the_scene_is() {
    let view = view();
    let answer = say(&view, format!("GET / HTTP/1.1\r\nHost: {}\r\n\r\n", view.address()).as_bytes());
    let (head, page) = answer.split_once("\r\n\r\n").unwrap();
    assert!(head.starts_with("HTTP/1.1 200 OK") && head.contains("text/html"), "{head}");
    assert!(head.contains(&format!("Content-Length: {}", page.len())));
    assert!(page.starts_with("<!doctype html>") && page.contains("content=\"/live\""));
    assert_eq!(view.url(), format!("http://{}/", view.address()));
}

#[test]
fn viewers_hear_what_was_and_what_comes_and_may_come_back() {
    let view = view();
    let mut early = connect(&view);
    view.begin(&Meta::new(2, "three touches"));
    view.grasp(grasp(0, 2));
    assert_eq!(hear(&mut early).unwrap()["title"], "three touches");
    assert_eq!(hear(&mut early).unwrap()["grasp"], 0);
    let mut late = connect(&view);
    assert_eq!(hear(&mut late).unwrap()["type"], "meta");
    assert_eq!(hear(&mut late).unwrap()["grasp"], 0);
    assert_eq!(view.viewers(), 2);
    view.grasp(grasp(1, 2));
    for client in [&mut early, &mut late] {
        assert_eq!(hear(client).unwrap()["grasp"], 1);
    }
    early.close(None).unwrap();
    while hear(&mut early).is_some() {}
    view.surface(&Surface { after: 1, ..Surface::default() });
    view.end();
    let rest: Vec<Value> = scene(&mut late);
    assert_eq!(rest.iter().map(|m| &m["type"]).collect::<Vec<_>>(), ["surface", "end"]);
    let again = scene(&mut connect(&view));
    assert_eq!((again.len(), sum(&again, "touched")), (5, 4));
    // Who stays is told when the view closes.
    drop(view);
    assert!(hear(&mut late).is_none());
}

#[test]
fn other_sites_and_other_names_stay_outside() {
    let view = view();
    view.begin(&Meta::new(2, "secret"));
    let address = view.address();
    let request = |host: &str, origin: &str| {
        let mut request = format!("ws://{address}/live").into_client_request().unwrap();
        request.headers_mut().insert("Host", host.parse().unwrap());
        request.headers_mut().insert("Origin", origin.parse().unwrap());
        tungstenite::connect(request)
    };
    let own = address.to_string();
    let port = address.port();
    assert!(request(&own, &format!("http://{own}")).is_ok());
    assert!(request(&format!("localhost:{port}"), &format!("http://localhost:{port}")).is_ok());
    for (host, origin) in [
        (own.as_str(), "http://evil.example"),
        (own.as_str(), "null"),
        ("evil.example", "http://evil.example"),
    ] {
        match request(host, origin) {
            Err(Error::Http(answer)) => assert_eq!(answer.status(), 403, "{host} {origin}"),
            other => panic!("{host} {origin}: {other:?}"),
        }
    }
    let page = say(&view, b"GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n");
    assert!(page.starts_with("HTTP/1.1 403 ") && !page.contains("<html"), "{page}");
}

#[test]
fn nonsense_is_refused_and_harms_nobody() {
    let view = view();
    view.begin(&Meta::new(2, "test"));
    let host = format!("Host: {}\r\n", view.address());
    let long = format!("GET / HTTP/1.1\r\nX: {}\r\n\r\n", "x".repeat(20_000));
    let many = format!("GET / HTTP/1.1\r\n{}\r\n", "A: b\r\n".repeat(200));
    let cases: [(Vec<u8>, &str); 12] = [
        (b"".to_vec(), "400"),
        (b"\r\n\r\n\r\n".to_vec(), "400"),
        (vec![0xff; 300], "400"),
        ((0..=255).collect(), "400"),
        (b"GET / HTTP/1.1\r\nHost".to_vec(), "400"),
        (b"GET  HTTP/9.9\r\n\r\n".to_vec(), "400"),
        (long.into_bytes(), "4"),
        (many.into_bytes(), "400"),
        (format!("POST / HTTP/1.1\r\n{host}\r\n").into_bytes(), "405"),
        (format!("GET /../etc/passwd HTTP/1.1\r\n{host}\r\n").into_bytes(), "404"),
        (format!("GET /live HTTP/1.1\r\n{host}\r\n").into_bytes(), "426"),
        (format!("GET /live HTTP/1.1\r\n{host}Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: short\r\n\r\n").into_bytes(), "426"),
    ];
    for (request, status) in cases {
        let answer = say(&view, &request);
        let start = format!("HTTP/1.1 {status}");
        assert!(answer.starts_with(&start), "{:?}: {answer:?}", String::from_utf8_lossy(&request));
    }
    // A viewer that sends garbage after the handshake is let go; others go on.
    let mut good = connect(&view);
    let mut rude = connect(&view);
    if let MaybeTlsStream::Plain(stream) = rude.get_mut() {
        stream.write_all(&[0xff; 64]).unwrap();
    }
    while hear(&mut rude).is_some() {}
    view.grasp(grasp(0, 1));
    assert_eq!(hear(&mut good).unwrap()["type"], "meta");
    assert_eq!(hear(&mut good).unwrap()["grasp"], 0);
}

#[test]
fn a_viewer_that_does_not_read_holds_up_nobody_and_loses_no_contact() {
    let view = view();
    view.begin(&Meta::new(2, "long"));
    let mut slow = connect(&view);
    let mut fast = connect(&view);
    assert_eq!(hear(&mut fast).unwrap()["type"], "meta");
    // Some 30 MB: more than two sockets hold.
    let count = 1_500;
    let listener = std::thread::spawn(move || scene(&mut fast));
    for number in 0..count {
        view.grasp(grasp(number, 600));
        view.surface(&Surface { after: number, ..Surface::default() });
    }
    view.end();
    let heard = listener.join().unwrap();
    assert_eq!(heard.last().unwrap()["type"], "end");
    let late = scene(&mut slow);
    for messages in [heard, late] {
        // After the last beginning everything is there, as it came or thinned.
        let start = messages.iter().rposition(|m| m["type"] == "meta").map_or(0, |at| at + 1);
        let scene = &messages[start..];
        let first = scene.iter().find_map(|m| m["grasp"].as_u64()).unwrap();
        let before = if start == 0 { first } else { 0 };
        assert_eq!(before + sum(scene, "merged"), count);
        assert_eq!(before * 600 + sum(scene, "touched"), 600 * count);
        let surfaces = messages.iter().filter(|m| m["type"] == "surface").count();
        assert!((1..=messages.len() / 2).contains(&surfaces));
        let newest = messages.iter().rev().find(|m| m["type"] == "surface").unwrap();
        assert_eq!(newest["after"], count - 1);
    }
}

#[test]
fn a_taken_address_is_an_error() {
    let view = view();
    let error = LiveView::open("127.0.0.1", view.address().port()).err().unwrap();
    assert_eq!(error.kind(), io::ErrorKind::AddrInUse);
    assert!(LiveView::open("192.0.2.1", 0).is_err(), "not an address of this machine");
}
