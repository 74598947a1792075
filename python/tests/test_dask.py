"""Builds and pictures by the workers of a cluster: the bytes of one command, also where a worker is killed at work."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil
import pytest

import trex
from trex.errors import InputUnreadableError, UsageError

distributed = pytest.importorskip("distributed")
import trex.dask  # noqa: E402

#: The command that the tests of the repository have built, or that is installed.
BUILT = [Path(__file__).parents[2] / "target" / profile / "trex" for profile in ("debug", "release")]
COMMAND = next((str(path) for path in BUILT if path.is_file()), shutil.which("trex"))
pytestmark = pytest.mark.skipif(COMMAND is None, reason="NOT RUN: there is no command trex to be run by workers")


@pytest.fixture(scope="module")
def client():
    """Two workers, processes, of one thread each."""
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, memory_limit=0, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


def commands(verb: str) -> list[psutil.Process]:
    """Commands with this verb below this process."""
    found = []
    for process in psutil.Process().children(recursive=True):
        try:
            line = process.cmdline()
        except psutil.Error:
            continue
        if line[:1] == [COMMAND] and line[1:2] == [verb]:
            found.append(process)
    return found


def test_a_build_and_a_picture_have_the_bytes_of_one_command(client, tmp_path):
    whole, apart = tmp_path / "whole.trex", tmp_path / "apart.trex"
    trex.build(["gen:pipes:60k", "gen:scan:20k"], whole, voxels=64)
    report = trex.dask.build(
        ["gen:pipes:60k", "gen:scan:20k"],
        apart,
        client=client,
        shards=3,
        scan_flags=["--voxels", "64", "--keep-triangles"],
        threads=1,
        command=COMMAND,
    )
    assert apart.read_bytes() == whole.read_bytes()
    assert report["triangle_count"] == trex.info(whole)["triangle_count"]
    flags = ["--resolution", "64x48", "--spp", "2", "--integrator", "direct"]
    pictures = [tmp_path / f"{parts}.exr" for parts in (1, 4)]
    for parts, picture in zip((1, 4), pictures):
        trex.dask.render(apart, picture, client=client, parts=parts, flags=flags, threads=1, command=COMMAND)
    assert pictures[0].read_bytes() == pictures[1].read_bytes()
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".exr", ".exr", ".trex", ".trex"], "nothing is left"


def test_a_worker_that_is_killed_at_work_costs_its_task_alone(client, tmp_path):
    whole, apart = tmp_path / "whole.trex", tmp_path / "apart.trex"
    trex.build("gen:isosurface:800k", whole, voxels=64)
    killed, orphans = [], []

    def kill_one() -> None:
        until = time.monotonic() + 120
        while time.monotonic() < until:
            for process in commands("build"):
                worker = process.parent()
                orphans.append(process)
                killed.append(worker.pid)
                os.kill(worker.pid, signal.SIGKILL)
                return
            time.sleep(0.01)

    killer = threading.Thread(target=kill_one)
    killer.start()
    trex.dask.build(
        "gen:isosurface:800k", apart, client=client, shards=4, scan_flags=["--voxels", "64"], threads=1, command=COMMAND
    )
    killer.join()
    assert killed, "a worker was killed while it built"
    psutil.wait_procs(orphans, timeout=10)
    assert not any(process.is_running() for process in orphans), "a command ends with its worker"
    assert apart.read_bytes() == whole.read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"whole.trex", "apart.trex"}


def memory_told(client) -> list[int]:
    """The memory of each worker, bytes, as the dashboard has it."""
    return client.run_on_scheduler(
        lambda dask_scheduler: [worker.metrics["memory"] for worker in dask_scheduler.workers.values()]
    )


def test_the_memory_of_commands_counts_as_that_of_their_workers(client):
    client.register_plugin(trex.dask.CommandMemory())
    idle, held = memory_told(client), 300 << 20
    program = f"import sys; held = b'1' * {held}; sys.stdin.read()"

    def hold(seconds: float) -> None:
        child = subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE)
        time.sleep(seconds)
        child.communicate()

    task, told = client.submit(hold, 4.0, pure=False), []
    while not task.done():
        told.extend(memory_told(client))
        time.sleep(0.1)
    assert max(idle) < held < max(told) < 2 * held, (idle, max(told))


def test_errors_are_those_of_the_command_and_what_is_whole_stays(client, tmp_path):
    with pytest.raises(InputUnreadableError, match="missing.ply"):
        trex.dask.build("missing.ply", tmp_path / "a.trex", client=client, shards=2, command=COMMAND)
    assert not any(tmp_path.iterdir())
    with pytest.raises(InputUnreadableError, match="no-such-command"):
        trex.dask.build("gen:soup:10k", tmp_path / "b.trex", client=client, shards=1, command="no-such-command")
    (tmp_path / "c.trex").write_bytes(b"mine")
    with pytest.raises(UsageError, match="exists"):
        trex.dask.build("gen:soup:10k", tmp_path / "c.trex", client=client, command=COMMAND)
    with pytest.raises(UsageError, match="number of shares"):
        trex.dask.build("gen:soup:10k", tmp_path / "d.trex", client=client, shards=0, command=COMMAND)
    assert (tmp_path / "c.trex").read_bytes() == b"mine"
