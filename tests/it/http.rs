//! Page files behind HTTP: the same answers as from a disk, and a clear error or the right picture whatever the server
//! does.

#[allow(dead_code, reason = "what stalls is tested where bounds are short, beside the client")]
mod server;
mod tls;

use crate::command::{document_in, folder, hash_of, ran, run_in, trex_in};
use crate::fixtures::built_in;
use server::{Manners, Server, Wire};
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

const MODEL: &str = "gen:pipes:60k --voxels 64";
/// A place behind most pages of the model, and before its tables.
const PAGES_END: usize = 100_000;
const PICTURE: &str = "--overwrite --resolution 64x48 --spp 2 --exposure 1 --light scene";

/// The hash of the picture that `render` makes of `file`, under this limit.
fn picture(inside: &Path, file: &str, limit: &str) -> u64 {
    let line = format!("render {file} -o picture.png {PICTURE} --memory-limit {limit}");
    document_in(inside, &line);
    hash_of(&inside.join("picture.png"))
}

#[test]
fn a_file_behind_http_is_the_same_as_on_a_disk() {
    let inside = folder();
    built_in(inside.path(), MODEL, "model.trex");
    let path = inside.path().join("model.trex");
    let server = Server::of(&path, |_| Manners::Good);
    let url = &server.url;
    let known = picture(inside.path(), "model.trex", "256MiB");
    for limit in ["256MiB", "64MiB"] {
        assert_eq!(picture(inside.path(), url, limit), known, "{limit}");
    }
    // The description differs in what it says of the place, and in the memory of connections.
    let info = |file: &str| {
        let mut document = document_in(inside.path(), &format!("info {file}"));
        let document = document.as_object_mut().unwrap();
        for key in ["command", "scene", "smallest_limit_bytes", "smallest_limit_view_bytes", "shares"] {
            document.remove(key);
        }
        serde_json::to_string(document).unwrap()
    };
    assert_eq!(info(url), info("model.trex"));
    for depth in ["", "--quick", "--deep"] {
        let verdict = document_in(inside.path(), &format!("verify {url} {depth}"));
        assert_eq!(verdict["verdict"], "clean", "{verdict:#}");
    }
    for file in [url, "model.trex"] {
        let name = if file == url { "far.ply" } else { "near.ply" };
        document_in(inside.path(), &format!("export {file} -o {name}"));
    }
    // The comment of a PLY names the file that it came from.
    let faces = |name: &str| {
        let bytes = std::fs::read(inside.path().join(name)).unwrap();
        let head = bytes.windows(11).position(|part| part == b"end_header\n").unwrap();
        bytes[head..].to_vec()
    };
    assert!(faces("far.ply") == faces("near.ply"), "exports differ");
    let scene = format!("model = \"{url}\"\n[render]\nexposure = 1.0\nlight = \"scene\"\n");
    std::fs::write(inside.path().join("far.toml"), scene).unwrap();
    assert_eq!(picture(inside.path(), "far.toml", "256MiB"), known, "by a scene");
}

/// `info` reads the tables alone: the end of the file, then what is in no 64 KiB of it.
#[test]
fn opening_asks_for_the_tables_alone() {
    let inside = folder();
    built_in(inside.path(), MODEL, "model.trex");
    let path = inside.path().join("model.trex");
    let server = Server::of(&path, |_| Manners::Good);
    document_in(inside.path(), &format!("info {}", server.url));
    let bytes = path.metadata().unwrap().len() as usize;
    assert!(server.requests() <= 8, "{} requests", server.requests());
    assert!(server.sent_bytes() < bytes / 2, "{} of {bytes} bytes", server.sent_bytes());
}

/// The first request for each range fails, in five ways, and nothing is seen of it.
#[test]
fn failures_that_pass_are_not_seen() {
    let inside = folder();
    built_in(inside.path(), MODEL, "model.trex");
    let known = picture(inside.path(), "model.trex", "256MiB");
    for bad in [Manners::Unavailable, Manners::Closed, Manners::Short, Manners::Long, Manners::OtherRange] {
        let asked = Arc::new(Mutex::new(BTreeSet::new()));
        let seen = Arc::clone(&asked);
        let server = Server::of(&inside.path().join("model.trex"), move |first| {
            if seen.lock().unwrap().insert(first) { bad } else { Manners::Good }
        });
        assert_eq!(picture(inside.path(), &server.url, "256MiB"), known, "{bad:?}");
        let ranges = asked.lock().unwrap().len();
        assert!(ranges > 2 && server.requests() > ranges, "{bad:?}: {} of {ranges}", server.requests());
    }
    // A server that is away for a second: pages were damaged after a third of one.
    let until = Arc::new(Mutex::new(None));
    let server = Server::of(&inside.path().join("model.trex"), move |first| {
        let begin = || Instant::now() + Duration::from_millis(700);
        let is_away = first < PAGES_END && Instant::now() < *until.lock().unwrap().get_or_insert_with(begin);
        if is_away { Manners::Unavailable } else { Manners::Good }
    });
    assert_eq!(picture(inside.path(), &server.url, "256MiB"), known, "away for a while");
    let server = Server::of(&inside.path().join("model.trex"), |_| Manners::Elsewhere);
    assert_eq!(picture(inside.path(), &server.url, "256MiB"), known, "where it was sent on");
}

/// What a server does from its first request on ends in an error in four parts and in no picture; where pages alone
/// cannot be had, the picture is not whole.
#[test]
fn what_a_server_does_for_good_is_told() {
    let inside = folder();
    built_in(inside.path(), MODEL, "model.trex");
    let render = |url: &str| {
        let line = format!("render {url} -o none.png {PICTURE} --memory-limit 256MiB --json");
        let ran = run_in(inside.path(), &line);
        assert!(!inside.path().join("none.png").exists(), "{}", ran.line);
        ran
    };
    let path = inside.path().join("model.trex");
    for (bad, code, exit) in [
        (Manners::Nothing, "input-unreadable", 3),
        (Manners::Forbidden, "input-unreadable", 3),
        (Manners::Whole, "input-unreadable", 3),
        (Manners::NoRange, "input-unreadable", 3),
        (Manners::Unavailable, "io", 7),
        (Manners::Closed, "io", 7),
        (Manners::Short, "io", 7),
        (Manners::Long, "io", 7),
        (Manners::Endless, "io", 7),
        (Manners::OtherRange, "io", 7),
    ] {
        let server = Server::of(&path, move |_| bad);
        let told = render(&server.url).expect_error(exit, code);
        assert!(told["where"].as_str().unwrap().contains(&server.url), "{bad:?}: {told:#}");
    }
    // Pages that cannot be had are left out of the picture, as damaged ones of a file are, and the status says so.
    let mut asked = Vec::new();
    for bad in [Manners::Changed, Manners::Unavailable, Manners::Damaged] {
        let pages_asked = Arc::new(AtomicUsize::new(0));
        let count = Arc::clone(&pages_asked);
        let server = Server::of(&path, move |first| {
            let is_page = first < PAGES_END;
            count.fetch_add(usize::from(is_page), Ordering::Relaxed);
            if is_page { bad } else { Manners::Good }
        });
        let line = format!("render {} -o holes.png {PICTURE} --memory-limit 256MiB --json", server.url);
        let ran = run_in(inside.path(), &line);
        ran.expect(1);
        let pages = ran.document()["damaged_pages"].as_array().unwrap().len();
        assert!(pages > 0, "{bad:?}: {}", ran.stdout);
        asked.push(pages_asked.load(Ordering::Relaxed));
    }
    // What is for good is asked for once, what may pass three times.
    assert!(asked[1] > 2 * asked[0], "requests: {asked:?}");
}

#[test]
fn an_address_without_a_server_or_with_a_password_is_told() {
    let inside = folder();
    let told = run_in(inside.path(), "info http://127.0.0.1:1/model.trex --json").expect_error(7, "io");
    assert!(told["next_step"].as_str().unwrap().contains("network"), "{told:#}");
    let ran = run_in(inside.path(), "info http://me:secret@127.0.0.1:1/model.trex --json");
    let told = ran.expect_error(2, "usage");
    // The line that was typed stands in the document; what is told does not repeat the password.
    assert!(!told["where"].as_str().unwrap().contains("secret"), "{told:#}");
}

/// What was read once comes from the disk the second time; where that was damaged, from the server again.
#[test]
fn what_is_kept_on_disk_is_not_asked_for_again() {
    let inside = folder();
    built_in(inside.path(), MODEL, "model.trex");
    let known = picture(inside.path(), "model.trex", "256MiB");
    let server = Server::of(&inside.path().join("model.trex"), |_| Manners::Good);
    let counts = || (server.requests(), server.sent_bytes());
    let file = format!("{} --cache-dir kept", server.url);
    let look = || {
        let before = counts();
        assert_eq!(picture(inside.path(), &file, "256MiB"), known);
        let after = counts();
        [after.0 - before.0, after.1 - before.1]
    };
    let [first, second] = [look(), look()];
    // The version is asked for each time that the file is opened: for its sizes, and to be read.
    assert!(second[0] <= 2 && second[1] <= 128 << 10 && second[1] < first[1], "{first:?}, {second:?}");
    // A bit in every 500 bytes of what is kept, behind the lists.
    let places: Vec<_> = std::fs::read_dir(inside.path().join("kept")).unwrap().collect();
    assert_eq!(places.len(), 1);
    let segment = places[0].as_ref().unwrap().path().join("0.segment");
    let mut bytes = std::fs::read(&segment).unwrap();
    bytes.iter_mut().skip(16 << 10).step_by(500).for_each(|byte| *byte ^= 4);
    std::fs::write(&segment, bytes).unwrap();
    assert!(look()[0] > 2, "what is damaged is asked for again");
    assert_eq!(look(), second, "and kept anew");
    // Of what was verified nothing is kept, and nothing that is kept counts.
    let before = counts();
    document_in(inside.path(), &format!("verify {}", server.url));
    assert!(counts().1 - before.1 >= inside.path().join("model.trex").metadata().unwrap().len() as usize);
    // A folder that cannot be written costs the cache, and no picture.
    std::fs::write(inside.path().join("taken"), "").unwrap();
    let file = format!("{} --cache-dir taken", server.url);
    assert_eq!(picture(inside.path(), &file, "256MiB"), known);
    let ran = run_in(inside.path(), &format!("render {file} -o p.png {PICTURE} --progress plain"));
    assert!(ran.stderr.contains("nothing more is kept in taken"), "{}", ran.stderr);
}

/// A cache that holds less than a picture needs stays below its limit.
#[test]
fn a_small_cache_stays_small() {
    let inside = folder();
    built_in(inside.path(), MODEL, "model.trex");
    let known = picture(inside.path(), "model.trex", "256MiB");
    let server = Server::of(&inside.path().join("model.trex"), |_| Manners::Good);
    let file = format!("{} --cache-dir kept --cache-limit 100KiB", server.url);
    assert_eq!(picture(inside.path(), &file, "256MiB"), known);
    let place = std::fs::read_dir(inside.path().join("kept")).unwrap().next();
    let segments = place.map(|place| std::fs::read_dir(place.unwrap().path()).unwrap());
    let used: u64 = segments.into_iter().flatten().map(|file| file.unwrap().metadata().unwrap().len()).sum();
    assert!(used <= 200 << 10, "{used} bytes");
}

/// Over a wire of 30 ms, pages come many at a time.
#[test]
fn a_long_wire_is_waited_for_a_few_times() {
    let inside = folder();
    built_in(inside.path(), MODEL, "model.trex");
    let wire = Wire { round_trip: std::time::Duration::from_millis(30), bytes_per_second: 50 << 20 };
    let wrap = Box::new(|stream| Box::new(stream) as Box<dyn server::Connection>);
    let server = Server::over(&inside.path().join("model.trex"), |_| Manners::Good, wire, wrap);
    let known = picture(inside.path(), "model.trex", "256MiB");
    assert_eq!(picture(inside.path(), &server.url, "256MiB"), known);
    // Pages that lie side by side come with one request.
    let pages = document_in(inside.path(), "info model.trex")["page_count"].as_u64().unwrap() as usize;
    assert!(server.requests() <= pages, "{} requests for {pages} pages", server.requests());
}

/// A server for which nobody of Mozilla's list vouches is asked where its own certificate is named, and refused
/// elsewhere.
#[test]
fn certificates_of_ones_own_are_taken_from_a_file() {
    let inside = folder();
    built_in(inside.path(), MODEL, "model.trex");
    let (wrap, pem) = tls::certified();
    std::fs::write(inside.path().join("ca.pem"), pem).unwrap();
    std::fs::write(inside.path().join("none.pem"), "no certificate").unwrap();
    let server = Server::over(&inside.path().join("model.trex"), |_| Manners::Good, Wire::default(), wrap);
    let url = format!("https://localhost:{}/model.trex", server.host.rsplit(':').next().unwrap());
    let known = picture(inside.path(), "model.trex", "256MiB");
    assert_eq!(picture(inside.path(), &format!("{url} --ca-file ca.pem"), "256MiB"), known);
    for (flags, exit, code) in [
        ("", 3, "input-unreadable"),
        (" --ca-file none.pem", 3, "input-format"),
        (" --ca-file absent.pem", 3, "input-unreadable"),
    ] {
        run_in(inside.path(), &format!("info {url}{flags} --json")).expect_error(exit, code);
    }
}

/// Addresses of S3 are signed with what the environment has, and nothing of that is told.
#[test]
fn objects_of_s3_are_asked_for_with_a_signature() {
    let inside = folder();
    built_in(inside.path(), MODEL, "model.trex");
    let known = document_in(inside.path(), "info model.trex")["triangle_count"].clone();
    let info = |server: &Server, keys: bool, line: &str| {
        let mut command = trex_in(inside.path(), &format!("info s3://models/a%20b/{line} --json -vv"));
        command.env("AWS_ENDPOINT_URL", format!("http://{}", server.host));
        for name in [
            "AWS_ACCESS_KEY_ID",
            "AWS_SECRET_ACCESS_KEY",
            "AWS_SESSION_TOKEN",
            "AWS_ENDPOINT_URL_S3",
            "AWS_REGION",
        ] {
            command.env_remove(name);
        }
        if keys {
            command.env("AWS_ACCESS_KEY_ID", "AKIDEXAMPLE").env("AWS_SECRET_ACCESS_KEY", "verysecret");
            command.env("AWS_SESSION_TOKEN", "atoken");
        }
        let ran = ran(line, command.output().unwrap());
        for word in ["verysecret", "atoken", "AKIDEXAMPLE", "X-Amz"] {
            assert!(!ran.stdout.contains(word) && !ran.stderr.contains(word), "{word}: {}", ran.stderr);
        }
        ran
    };
    let path = inside.path().join("model.trex");
    let server = Server::of(&path, |_| Manners::Good);
    assert_eq!(info(&server, true, "model.trex").document()["triangle_count"], known);
    let asked = server.asked();
    assert!(asked.starts_with("/models/a%2520b/model.trex?"), "{asked}");
    for word in ["X-Amz-Signature=", "X-Amz-Credential=AKIDEXAMPLE", "X-Amz-Security-Token=atoken"] {
        assert!(asked.contains(word), "{asked}");
    }
    assert!(!asked.contains("verysecret"), "{asked}");
    assert_eq!(info(&server, false, "model.trex").document()["triangle_count"], known);
    assert_eq!(server.asked(), "/models/a%2520b/model.trex", "an open bucket is asked without");
    // Credentials are sent to nobody that the server names.
    let server = Server::of(&path, |_| Manners::Elsewhere);
    info(&server, true, "model.trex").expect_error(3, "input-unreadable");
    assert!(server.asked().contains("X-Amz"), "nothing came after the first request: {}", server.asked());
    let server = Server::of(&path, |_| Manners::Forbidden);
    let told = info(&server, false, "model.trex").expect_error(3, "input-unreadable");
    assert!(told["next_step"].as_str().unwrap().contains("AWS_ACCESS_KEY_ID"), "{told:#}");
    run_in(inside.path(), "info s3://models --json").expect_error(2, "usage");
    run_in(inside.path(), "info s3://models/x --s3-endpoint ftp://host --json").expect_error(2, "usage");
}
