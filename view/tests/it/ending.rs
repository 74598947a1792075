//! What ends, and when: the server with its connections, a page that is silent, a screenshot that nobody wants.

use crate::client::{Came, Page, connect};
use crate::stage::{Play, SIZE, Server, view_threads};
use crate::stream::camera;
use serde_json::{Value, json};
use std::io::Write;
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// A head may take so long, and half of one delayed the end by it.
const HEAD_TIME: Duration = Duration::from_secs(5);

/// As many samples as are allowed: hours.
fn long_shot(id: u32) -> Value {
    json!({"type": "screenshot", "id": id, "format": "png", "size": [1024, 1024], "spp": 4096})
}

/// Half heads, sockets without a hello, pages that read nothing, a screenshot that takes hours: none of them is waited
/// for.
#[test]
fn the_server_ends_whatever_its_connections_do() {
    let server = Server::start(Play::default());
    let mut page = Page::new(&server, SIZE);
    let _stuck = Page::new(&server, SIZE);
    let _silent: Vec<_> = (0..3).map(|_| connect(&server, &[]).unwrap()).collect();
    let mut heads: Vec<_> = (0..8).map(|_| TcpStream::connect(server.address).unwrap()).collect();
    heads.iter_mut().for_each(|stream| stream.write_all(b"GET / HTTP/1.1\r\nHost: loc").unwrap());
    page.say(&long_shot(1));
    while page.text("stats")["progress"] != "screenshot" {}
    let begin = Instant::now();
    // A few of them come when it is about to end.
    heads.extend((0..4).map(|_| TcpStream::connect(server.address).unwrap()));
    server.end();
    assert!(begin.elapsed() < HEAD_TIME, "{:?}", begin.elapsed());
    assert_eq!(view_threads(), 0);
    assert!([0, 1001].contains(&page.closed()));
}

/// A page that neither read nor acknowledged kept its place for ever. One that reads keeps it, though it acknowledges
/// nothing, as a page that nobody sees.
#[test]
fn a_silent_page_loses_its_place() {
    let server = Server::start(Play { silence_max: Duration::from_millis(1500), ..Play::default() });
    let mut reads = Page::new(&server, SIZE);
    let mut stuck = Page::new(&server, SIZE);
    let mut most = 0;
    loop {
        match reads.next(Duration::from_secs(60)) {
            Came::Text(text) if text["type"] == "state" => match text["clients"].as_u64().unwrap() {
                1 if most == 2 => break,
                clients => most = most.max(clients),
            },
            Came::Closed(code) => panic!("closed: {code}"),
            Came::Nothing => panic!("it keeps its place"),
            _ => {}
        }
    }
    assert!([0, 1008].contains(&stuck.closed()));
}

/// A screenshot held up all pages for as long as it took, and its own page could not end it.
#[test]
fn a_screenshot_ends_when_its_page_cancels_it_or_goes() {
    let server = Server::start(Play::default());
    let mut page = Page::new(&server, SIZE);
    page.settle();
    page.say(&long_shot(1));
    page.say(&camera(7, 1.5));
    // Statistics come meanwhile, and a page that comes is welcome, sees the picture, and is told of to the others.
    (0..3).for_each(|_| while page.text("stats")["progress"] != "screenshot" {});
    let mut other = Page::new(&server, SIZE);
    assert_eq!(other.frame_until(|_| true).size, SIZE);
    while page.text("state")["clients"] != 2 {}
    other.say(&json!({"type": "cancel", "id": 1}));
    (0..2).for_each(|_| while other.text("stats")["progress"] != "screenshot" {});
    page.say(&json!({"type": "cancel", "id": 1}));
    let notice = page.text("notice");
    assert_eq!((&notice["code"], &notice["level"]), (&json!("screenshot"), &json!("info")));
    // The camera that waited is applied now.
    page.frame_until(|frame| frame.kind == 2 && frame.seq == 7);
    page.say(&long_shot(2));
    while other.text("stats")["progress"] != "screenshot" {}
    drop(page);
    while other.text("state")["clients"] != 1 {}
    other.say(&json!({"type": "drive"}));
    other.say(&camera(9, 1.25));
    other.frame_until(|frame| frame.kind == 2 && frame.seq == 9);
    assert_eq!(server.end().screenshots, 0);
}
