//! Bytes of any kind on the wire: nothing breaks, and nobody else notices.

use crate::client::Page;
use crate::stage::{SIZE, Server, keys};
use crate::stream::camera;
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::{Rng, SeedableRng};
use std::io::Write;
use std::net::TcpStream;
use tungstenite::Message;

#[test]
fn what_is_too_long_or_no_text_ends_the_connection() {
    let server = Server::new(keys());
    for message in [
        Message::text("x".repeat((64 << 10) + 1)),
        Message::binary(vec![1, 2, 3]),
        Message::text(format!(r#"{{"type":"hello","token":"{}","size":[1,1]}}"#, server.token)),
    ] {
        let mut page = Page::new(&server, SIZE);
        page.throw(message);
        let code = page.closed();
        assert!([0, 1008].contains(&code), "{code}");
    }
    Page::new(&server, SIZE).settle();
}

#[test]
fn nonsense_is_told_a_few_times_and_then_ends_the_connection() {
    let server = Server::new(keys());
    let mut page = Page::new(&server, SIZE);
    page.throw(Message::text("{\"type\":\"fly\"}"));
    let notice = page.text("notice");
    assert_eq!(notice["code"], "message");
    for _ in 0..20 {
        page.throw(Message::text("[]"));
    }
    assert_eq!(page.closed(), 1008);
}

/// Bytes into connections, before and after they are sockets; a page beside them sees its picture.
#[test]
fn bytes_of_any_kind_are_survived() {
    let server = Server::new(keys());
    let mut page = Page::new(&server, SIZE);
    let mut random = Pcg64Mcg::seed_from_u64(11);
    let upgrade = "GET /socket HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\n\
                   Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n";
    for turn in 0..200 {
        let mut bytes = if turn % 2 == 0 { upgrade.as_bytes().to_vec() } else { vec![] };
        bytes.extend((0..random.next_u32() % 400).map(|_| random.next_u32() as u8));
        if turn % 3 == 0 {
            let at = random.next_u32() as usize % bytes.len().max(1);
            bytes.insert(at, random.next_u32() as u8);
        }
        let mut stream = TcpStream::connect(server.address).unwrap();
        // It may be closed before all is written.
        let _ = stream.write_all(&bytes);
    }
    page.say(&camera(3, 1.25));
    assert_eq!(page.frame_until(|frame| frame.kind == 2 && frame.seq == 3).size, SIZE);
}
