"""The viewer: what a browser is given, who may have it, and that it ends."""

from __future__ import annotations

import gc
import http.client
import os
import threading
import urllib.request

import pytest

import trex
from trex.errors import MemoryLimitError, SceneFormatError, UsageError


def fetched(viewer: trex.Viewer, path: str = "/", host: str | None = None) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", viewer.port, timeout=10)
    connection.request("GET", path, headers={} if host is None else {"Host": host})
    answer = connection.getresponse()
    return answer.status, dict(answer.getheaders()), answer.read()


def threads() -> set[str]:
    """Threads of this process, those of other tests, which may end meanwhile, too."""
    return set(os.listdir("/proc/self/task"))


def test_a_browser_is_given_the_page(model):
    with trex.view(model) as viewer:
        assert viewer.url.startswith(f"http://127.0.0.1:{viewer.port}/#token=") and not viewer.closed
        with urllib.request.urlopen(viewer.url, timeout=10) as answer:
            page = answer.read().decode()
        assert 'src="app.js"' in page
        status, headers, _ = fetched(viewer)
        sources = "frame-ancestors 'self' http://localhost:* http://127.0.0.1:*;"
        assert status == 200 and sources in headers["Content-Security-Policy"]
        assert fetched(viewer, host="elsewhere.example")[0] == 421
        # The model can be asked meanwhile.
        assert model.occluded([0, 0, 9.0], [0, 0, -1.0]).all()
    assert viewer.closed and "closed" in repr(viewer)
    assert model.occluded([0, 0, 9.0], [0, 0, -1.0]).all()
    viewer.close()


def test_parts_of_a_model_can_be_shown(model):
    with trex.view(model, sections=[[0, 0, 0.5, 0, 0, -1]], hide=[]) as viewer:
        assert not viewer.closed
    with pytest.raises(SceneFormatError):
        trex.view(model, hide=["gold"])


def test_a_notebook_has_it_in_a_frame(sphere_file):
    with trex.view(sphere_file, memory_limit="128MiB", height=300) as viewer:
        shown = viewer._repr_html_()
        assert f'<iframe src="{viewer.url}"' in shown and 'height="300"' in shown
    assert "iframe" not in viewer._repr_html_()


def test_a_proxy_has_an_address_of_its_own(model):
    hub = ["hub.example"]
    with trex.view(model, url_prefix="/user/me/proxy/{port}/", hosts=hub, embedders="https://hub.example") as viewer:
        assert viewer.url.startswith(f"/user/me/proxy/{viewer.port}/#token=")
        status, headers, _ = fetched(viewer, host="hub.example")
        assert status == 200 and "frame-ancestors https://hub.example;" in headers["Content-Security-Policy"]


def test_it_ends_with_its_last_reference_and_leaves_no_thread(sphere_file):
    with trex.open(sphere_file, memory_limit="128MiB", threads=2) as model:
        model.occluded([0, 0, 9.0], [0, 0, -1.0])
        with trex.view(model) as viewer:
            port = viewer.port
        before = threads()
        viewer = trex.view(model)
        port = viewer.port
        assert threads() - before
        del viewer
        gc.collect()
        deadline = threading.Event()
        for _ in range(100):
            if not threads() - before:
                break
            deadline.wait(0.1)
        assert not threads() - before
        with pytest.raises(OSError):
            http.client.HTTPConnection("127.0.0.1", port, timeout=1).request("GET", "/")


def test_what_cannot_be_shown_is_refused(model, sphere_file):
    with trex.view(model) as viewer:
        # The model's limit holds for its viewers, too; and a port has one.
        with pytest.raises((trex.TrexError, OSError)):
            trex.view(model, port=viewer.port)
    for arguments in (
        {"bind": "here"},
        {"port": 70000},
        {"port": True},
        {"embedders": ["*"]},
        {"resolution": (30000, 30000)},
    ):
        with pytest.raises(UsageError):
            trex.view(model, **arguments)
    with pytest.raises(SceneFormatError):
        trex.view(model, integrator="magic")
    with pytest.raises(MemoryLimitError):
        trex.view(sphere_file, memory_limit="128MiB", resolution=(8192, 8192))
