"""The command ``trex`` as a process that ends with the one that began it, its documents and its errors.

Invariants: 1. where the process that asked is gone, killed too, the command is told to end (Linux); 2. what the
command tells as an error is raised as the exception of its code.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import Any

from .errors import BY_CODE, BugError, InputUnreadableError, TrexError

#: Seconds for which a command that was told to end may still hold the lock of its output.
LOCK_WAIT_S = 60.0
#: How the command says that.
_IS_AT_WORK = "another build of this output is at work"


def find(command: str) -> str:
    """The path of the command.

    Raises ``InputUnreadableError`` where there is none of that name.
    """
    path = shutil.which(command)
    if path is None:
        raise InputUnreadableError(
            "there is no such command",
            command,
            f"PATH {os.environ.get('PATH', '')}",
            "install it on every machine (cargo install --path . in a clone), or name it: command=",
        )
    return path


def run(command: str, arguments: Sequence[str]) -> dict[str, Any]:
    """Runs the command with ``arguments`` and ``--json``; its document.

    A command that was told to end a moment ago may still hold the lock of the output: that is waited for.
    """
    waited_until = time.monotonic() + LOCK_WAIT_S
    while True:
        try:
            return _run_once(command, arguments)
        except TrexError as error:
            if error.what != _IS_AT_WORK or time.monotonic() > waited_until:
                raise
            time.sleep(0.2)


def _tied_program() -> str:
    return os.path.join(os.path.dirname(__file__), "_tied.py")


def _run_once(command: str, arguments: Sequence[str]) -> dict[str, Any]:
    called = [find(command), *arguments, "--json", "--progress", "none"]
    tied = [sys.executable, "-I", _tied_program(), str(os.getpid()), *called]
    ended = subprocess.run(tied, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    try:
        document = json.loads(ended.stdout)
    except json.JSONDecodeError:
        raise BugError(
            "the command gave no document", " ".join(called), f"status {ended.returncode}: {ended.stderr[-2000:]}"
        ) from None
    if document.get("schema", "").startswith("trex.error/"):
        kind = BY_CODE.get(document["code"], TrexError)
        parts = (document[part] for part in ("what", "where", "numbers", "next_step", "smallest_limit_bytes"))
        raise kind(*parts)
    return document
