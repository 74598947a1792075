"""A page file behind HTTP is opened by its address."""

import re
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
import trex


class Ranges(BaseHTTPRequestHandler):
    """Answers ranges of one file."""

    protocol_version = "HTTP/1.1"
    content = b""

    def do_GET(self) -> None:
        asked = re.fullmatch(r"bytes=(\d*)-(\d+)", self.headers["Range"])
        assert asked is not None
        length = len(self.content)
        first, last = asked.groups()
        begin = int(first) if first else max(0, length - int(last))
        end = min(int(last), length - 1) if first else length - 1
        body = self.content[begin : end + 1]
        self.send_response(206)
        self.send_header("Content-Range", f"bytes {begin}-{end}/{length}")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def url(surface_file):
    handler = type("OfSurface", (Ranges,), {"content": surface_file.read_bytes()})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_address[1]}/surface.trex"
    server.shutdown()
    server.server_close()
    thread.join()


def test_rays_and_description_are_those_of_the_file(surface_file, url):
    with trex.open(surface_file) as near, trex.open(url) as far:
        assert far.triangle_count == near.triangle_count
        low, high = np.array(near.bounds)
        origins = np.random.default_rng(1).uniform(low, high, (500, 3))
        directions = np.random.default_rng(2).normal(size=(500, 3))
        here, there = near.intersect(origins, directions), far.intersect(origins, directions)
        np.testing.assert_array_equal(there.t_hit, here.t_hit)
        np.testing.assert_array_equal(there.triangle, here.triangle)
        assert np.isfinite(there.t_hit).sum() > 100
    assert trex.info(url)["triangle_count"] == trex.info(surface_file)["triangle_count"]


def test_an_address_without_a_server_is_told():
    with pytest.raises(trex.TrexError) as told:
        trex.open("http://127.0.0.1:1/surface.trex")
    assert "network" in told.value.next_step
