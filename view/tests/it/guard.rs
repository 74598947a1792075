//! Who is let in, and who is not.

use crate::client::{Came, Page, connect};
use crate::stage::{SIZE, Server, keys};
use serde_json::json;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;
use tungstenite::Message;

/// The answer to a request, as text.
fn ask(server: &Server, request: &str) -> String {
    let mut stream = TcpStream::connect(server.address).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = vec![];
    stream.read_to_end(&mut answer).unwrap();
    String::from_utf8_lossy(&answer).into_owned()
}

#[test]
fn fixed_paths_are_there_and_nothing_else() {
    let server = Server::new(keys());
    let get = |path: &str| ask(&server, &format!("GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n"));
    for path in ["/", "/index.html?token=x", "/app.js", "/style.css", "/icon.svg"] {
        let answer = get(path);
        assert!(answer.starts_with("HTTP/1.1 200 "), "{path}: {answer}");
        assert!(answer.contains("frame-ancestors 'none'") && answer.contains("no-store"), "{answer}");
    }
    for path in ["/etc/passwd", "/../Cargo.toml", "/app.js/..", "/%2e%2e/Cargo.toml", "/x"] {
        assert!(get(path).starts_with("HTTP/1.1 404 Not Found\r\n"), "{path}");
    }
    assert!(get("/socket").starts_with("HTTP/1.1 426 "));
    let head = ask(&server, "HEAD /app.js HTTP/1.1\r\nHost: localhost\r\n\r\n");
    assert!(head.starts_with("HTTP/1.1 200 ") && head.ends_with("\r\n\r\n"));
    assert!(ask(&server, "POST / HTTP/1.1\r\nHost: localhost\r\n\r\n").starts_with("HTTP/1.1 405 "));
    let host = |host: &str| ask(&server, &format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n"));
    for good in ["127.0.0.1:1", "render.lan", "[::1]:80"] {
        assert!(host(good).starts_with("HTTP/1.1 200 "), "{good}");
    }
    for bad in ["evil.com", "localhost.evil.com:80"] {
        assert!(host(bad).starts_with("HTTP/1.1 421 "), "{bad}");
    }
}

#[test]
fn sockets_of_other_sites_and_names_are_refused() {
    let server = Server::new(keys());
    assert_eq!(connect(&server, &[("Origin", "http://evil.com")]).err(), Some(403));
    assert_eq!(connect(&server, &[("Origin", "null")]).err(), Some(403));
    assert_eq!(connect(&server, &[("Host", "evil.com")]).err(), Some(421));
    let ours = server.address.to_string();
    // Another port is another program of this machine.
    let other = format!("http://{}:{}", server.address.ip(), server.address.port() ^ 1);
    assert_eq!(connect(&server, &[("Origin", &other), ("Host", &ours)]).err(), Some(403));
    assert_eq!(connect(&server, &[("Origin", "http://localhost:9"), ("Host", &ours)]).err(), Some(403));
    assert!(connect(&server, &[("Origin", &format!("http://{ours}")), ("Host", &ours)]).is_ok());
    // As through a tunnel: both are what the page was asked by.
    assert!(connect(&server, &[("Origin", "http://localhost:9"), ("Host", "localhost:9")]).is_ok());
}

#[test]
fn who_does_not_know_the_token_hears_nothing() {
    let server = Server::new(keys());
    let wrong = "0".repeat(32);
    for (said, code) in [
        (json!({"type": "hello", "token": wrong, "size": SIZE}), 4401),
        (json!({"type": "hello", "token": "", "size": SIZE}), 4401),
        (json!({"type": "rest"}), 1008),
        (json!({"type": "hello", "token": server.token}), 1008),
    ] {
        let mut socket = connect(&server, &[]).unwrap();
        socket.send(Message::text(said.to_string())).unwrap();
        match socket.read().unwrap() {
            Message::Close(Some(close)) => assert_eq!(u16::from(close.code), code, "{said}"),
            other => panic!("{said}: {other:?}"),
        }
    }
}

#[test]
fn the_ninth_page_is_sent_away_until_there_is_room() {
    let server = Server::new(keys());
    let mut pages: Vec<Page> = (0..8).map(|_| Page::new(&server, SIZE)).collect();
    assert_eq!(pages[7].welcome["clients"], 8);
    assert_eq!(connect(&server, &[]).err(), Some(503));
    pages.truncate(7);
    let again = (0..200).find_map(|_| {
        std::thread::sleep(Duration::from_millis(10));
        connect(&server, &[]).ok()
    });
    assert!(again.is_some());
}

/// A hello that never comes takes a place for five seconds, and no longer.
#[test]
fn silence_is_not_waited_for() {
    let server = Server::new(keys());
    let mut socket = connect(&server, &[]).unwrap();
    socket.get_mut().set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let begin = std::time::Instant::now();
    assert!(matches!(socket.read(), Ok(Message::Close(_)) | Err(_)));
    assert!((3..10).contains(&begin.elapsed().as_secs()), "{:?}", begin.elapsed());
    let mut page = Page::new(&server, SIZE);
    assert!(!matches!(page.next(Duration::from_secs(5)), Came::Closed(_)));
}
