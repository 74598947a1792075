#!/usr/bin/env python3
"""Runs a program inside a memory control group (v1) and tells what it took.

    bench/peers.py LIMIT_MIB COMMAND...     one JSON object to stdout: seconds, most memory, how it ended

Time is from the start of the command to its end. Most memory is what the kernel counted of its largest process; pages of
files that the kernel keeps for it count to the group, and so to the limit, too.
"""

import json
import os
import resource
import signal
import subprocess
import sys
import time

limit_bytes, command = int(sys.argv[1]) << 20, sys.argv[2:]
group = f"/sys/fs/cgroup/memory/trex-peer-{os.getpid()}"
os.mkdir(group)


def tell(name, text):
    with open(f"{group}/{name}", "w") as file:
        file.write(text)


def enter():
    tell("cgroup.procs", str(os.getpid()))
    os.setsid()


def killed_count():
    with open(f"{group}/memory.oom_control") as file:
        return int(dict(line.split() for line in file)["oom_kill"])


try:
    tell("memory.limit_in_bytes", str(limit_bytes))
    begin = time.monotonic()
    process = subprocess.Popen(command, preexec_fn=enter, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    words = process.stderr.read().decode(errors="replace")
    status = process.wait()
    seconds = time.monotonic() - begin
    killed = killed_count() > 0
    peak_bytes = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss << 10
    if status and not killed:
        print(f"{command[0]} ended with status {status}:\n{words[-2000:]}", file=sys.stderr)
    print(
        json.dumps(
            {
                "limit_bytes": limit_bytes,
                "time_ms": 1e3 * seconds if status == 0 else None,
                "peak_rss_bytes": peak_bytes,
                "ended": "killed" if killed else "done" if status == 0 else "failed",
            }
        )
    )
finally:
    # What a killed parent has left.
    for _ in range(50):
        with open(f"{group}/cgroup.procs") as file:
            left = file.read().split()
        if not left:
            break
        for process_id in left:
            try:
                os.kill(int(process_id), signal.SIGKILL)
            except ProcessLookupError:
                pass
        time.sleep(0.1)
    os.rmdir(group)
