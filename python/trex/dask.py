"""Builds and pictures by the workers of a Dask cluster (``dask.distributed``).

>>> from dask.distributed import Client
>>> import trex.dask
>>> client = Client("scheduler:8786")
>>> trex.dask.build("plant.ply", "plant.trex", shards=16, client=client, memory_limit="3GiB")
>>> trex.dask.render("plant.trex", "plant.png", parts=16, client=client, flags=["--spp", "256"])

A task is a process of the command ``trex``, which has to be on every worker's ``PATH``; inputs and outputs lie in
folders that all of them share, under the same paths. The bytes are those of one ``trex build`` and one ``trex render``.
A task whose worker is gone is done again by another one; what was whole by then is left as it is.

Start workers with ``--nthreads 1 --memory-limit 0``: a worker then runs one command at a time, and the memory limit of a
task is the command's, which keeps it; Dask's own would end workers for what it cannot move. The dashboard counts the
commands' memory as that of their workers.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import psutil
from distributed import Client, WorkerPlugin, get_client

from . import _command
from ._arguments import Path, bytes_of, thread_count
from .errors import UsageError

if TYPE_CHECKING:
    from distributed import Future, Worker

__all__ = ["build", "render"]

#: Most shards and parts: those of the command.
_SHARES_MAX = 512


class CommandMemory(WorkerPlugin):
    """Has a worker count the memory of the commands that it runs as its own, for the dashboard."""

    name = "trex-command-memory"

    def setup(self, worker: Worker) -> None:
        own = worker.monitor.get_process_memory

        def with_commands() -> int:
            return own() + sum(_resident(child) for child in psutil.Process().children(recursive=True))

        self._undo = lambda: setattr(worker.monitor, "get_process_memory", own)
        worker.monitor.get_process_memory = with_commands

    def teardown(self, worker: Worker) -> None:
        self._undo()


def build(
    inputs: Path | Iterable[Path],
    out: Path,
    *,
    client: Client | None = None,
    shards: int | None = None,
    memory_limit: int | str = "512MiB",
    threads: int | None = None,
    overwrite: bool = False,
    scan_flags: Sequence[str] = (),
    input_flags: Sequence[str] = (),
    temp_dir: Path | None = None,
    command: str = "trex",
) -> dict[str, Any]:
    """Builds the page file ``out`` in so many shards, one for each worker unless told.

    ``inputs`` as those of ``trex.build``, but for arrays. ``memory_limit`` is that of each task; ``threads`` its
    threads, one for each processor of its machine unless told. ``scan_flags`` say what is built (``["--voxels", "512"]``),
    ``input_flags`` how inputs are read (``["--colors", "drop"]``, ``["--iso", "60"]``): see ``trex scan --help``.
    ``temp_dir``: where a worker keeps its scratch, a disk of its own.

    Plan and fragments lie in ``OUT.shards`` beside it. They stay there where a task failed, for the next call to go on
    with, and are removed at the end. Every shard reads all of the inputs, or with ``scan_flags=["--keep-triangles"]`` its
    share of the plan, which then holds them.

    Returns the document of ``trex merge``: counts, sizes and times. Raises the exceptions of ``trex.build``.
    """
    client = client or get_client()
    names = [inputs] if isinstance(inputs, (str, os.PathLike)) else list(inputs)
    names = [os.fspath(name) for name in names]
    out = os.path.abspath(os.fspath(out))
    if os.path.lexists(out) and not overwrite:
        raise UsageError("the output exists", out, "", "give overwrite=True, or another name")
    count = _count(shards, client, "shards")
    limits = _limits(memory_limit)
    scratch = [] if temp_dir is None else ["--temp-dir", os.fspath(temp_dir)]
    folder = f"{out}.shards"
    plan = os.path.join(folder, "plan.trexplan")
    fragments = [os.path.join(folder, f"{number}-of-{count}.trexfrag") for number in range(1, count + 1)]
    with _folder(folder), _Tasks(client, command, threads) as tasks:
        # A plan is made anew: it is the same where the inputs are, and its fragments are told by it.
        scan = tasks.submit(["scan", *names, "-o", plan, "--overwrite", *scan_flags, *input_flags, *limits, *scratch])
        built = []
        for number, fragment in enumerate(fragments, 1):
            share = ["--plan", plan, "--shard", f"{number}/{count}", "-o", fragment]
            built.append(tasks.submit(["build", *names, *share, *input_flags, *limits, *scratch], after=[scan]))
        replace = ["--overwrite"] if overwrite else []
        merged = tasks.submit(["merge", *fragments, "-o", out, *replace, *limits, *scratch], after=built)
        return merged.result()


def render(
    model: Path,
    out: Path,
    *,
    client: Client | None = None,
    parts: int | None = None,
    memory_limit: int | str = "512MiB",
    threads: int | None = None,
    overwrite: bool = False,
    flags: Sequence[str] = (),
    command: str = "trex",
) -> dict[str, Any]:
    """Renders the picture ``out`` (.png, .exr) in so many shares of its tiles, one for each worker unless told.

    ``model``: a page file, also at an address, or a scene. ``flags`` are those of ``trex render`` that say what the
    picture is. Parts lie in ``OUT.parts`` beside it, and are removed at the end.

    Returns the document of ``trex image merge``.
    """
    client = client or get_client()
    model = os.fspath(model)
    out = os.path.abspath(os.fspath(out))
    if os.path.lexists(out) and not overwrite:
        raise UsageError("the output exists", out, "", "give overwrite=True, or another name")
    count = _count(parts, client, "parts")
    limits = _limits(memory_limit)
    folder = f"{out}.parts"
    names = [os.path.join(folder, f"{number}-of-{count}.trexpart") for number in range(1, count + 1)]
    with _folder(folder), _Tasks(client, command, threads) as tasks:
        made = []
        for number, name in enumerate(names, 1):
            arguments = ["render", model, "--tiles", f"{number}/{count}", "-o", name, "--overwrite", *flags, *limits]
            made.append(tasks.submit(arguments))
        replace = ["--overwrite"] if overwrite else []
        merged = tasks.submit(["image", "merge", *names, "-o", out, *replace, *limits], after=made)
        return merged.result()


@contextmanager
def _folder(path: str) -> Iterator[None]:
    """A folder for what is between: gone at the end, and where the work fails if nothing is in it."""
    os.makedirs(path, exist_ok=True)
    try:
        yield
    except BaseException:
        with suppress(OSError):
            os.rmdir(path)
        raise
    shutil.rmtree(path, ignore_errors=True)


class _Tasks:
    """Commands as tasks of a client; those that have not begun are given up where one fails."""

    def __init__(self, client: Client, command: str, threads: int | None) -> None:
        self._client, self._command = client, command
        self._threads = [] if threads is None else ["--threads", str(thread_count(threads))]
        self._futures: list[Future] = []
        client.register_plugin(CommandMemory())

    def __enter__(self) -> _Tasks:
        return self

    def __exit__(self, *_: object) -> None:
        self._client.cancel([future for future in self._futures if not future.done()])

    def submit(self, arguments: list[str], after: Sequence[Future] = ()) -> Future:
        # The same command again is another task, since files may have changed.
        future = self._client.submit(
            _task, self._command, [*arguments, *self._threads], list(after), key=f"trex-{arguments[0]}-{uuid4()}"
        )
        self._futures.append(future)
        return future


def _task(command: str, arguments: list[str], after: list[dict[str, Any]]) -> dict[str, Any]:
    """A task: one command, once those ``after`` which it comes are done."""
    del after
    return _command.run(command, arguments)


def _resident(process: psutil.Process) -> int:
    """Bytes of a process in memory, none of one that has ended."""
    try:
        return process.memory_info().rss
    except psutil.Error:
        return 0


def _limits(memory_limit: int | str) -> list[str]:
    return ["--memory-limit", f"{bytes_of(memory_limit, 'memory_limit')}B"]


def _count(asked: int | None, client: Client, where: str) -> int:
    count = len(client.nthreads()) if asked is None else asked
    if not 0 < count <= _SHARES_MAX:
        raise UsageError("this is no number of shares", where, str(count), f"give a number in 1..={_SHARES_MAX}")
    return count
