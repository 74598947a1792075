"""Ctrl-C ends whatever is under way, and leaves the interpreter free meanwhile.

How long that takes is printed, not asserted: the machine may be busy. That the work was not taken to its end is.
"""

from __future__ import annotations

import os
import signal
import threading
import time

import numpy as np
import pytest
from conftest import random_rays

import trex


def interrupted_after(seconds: float, work) -> float:
    """Seconds from the signal to the exception of `work`."""
    sent = []

    def send() -> None:
        sent.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(seconds, send)
    timer.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            work()
        return time.monotonic() - sent[0]
    finally:
        timer.join()


def test_rays(model, capsys):
    origins, directions = random_rays(4096)
    # One origin counts for all: minutes of work in little memory.
    many = np.tile(directions, (5000, 1))
    took = interrupted_after(0.3, lambda: model.intersect(origins[0], many))
    assert np.isfinite(model.intersect(origins, directions).t_hit).any()
    with capsys.disabled():
        print(f"[rays: {took * 1e3:.0f} ms after the signal]", end=" ")


def test_a_picture(model, capsys):
    took = interrupted_after(0.3, lambda: model.render(resolution=(512, 512), spp=100_000))
    with capsys.disabled():
        print(f"[a picture: {took * 1e3:.0f} ms after the signal]", end=" ")


def test_a_build(tmp_path, capsys):
    took = interrupted_after(0.5, lambda: trex.build("gen:isosurface:100M", tmp_path / "a.trex"))
    assert not list(tmp_path.iterdir()), "nothing is left"
    with capsys.disabled():
        print(f"[a build: {took * 1e3:.0f} ms after the signal]", end=" ")


def test_other_threads_run_while_rays_are_answered(model):
    origins, directions = random_rays(1_000_000)
    ticks, is_done = [], threading.Event()

    def tick() -> None:
        while not is_done.wait(0.001):
            ticks.append(time.monotonic())

    ticker = threading.Thread(target=tick)
    ticker.start()
    model.intersect(origins, directions)
    is_done.set()
    ticker.join()
    assert len(ticks) > 10
