"""A program of its own: becomes a command that is told to end when the process that asked for it is gone (Linux).

Usage: ``_tied.py PARENT COMMAND ARGUMENT...``; of the package it imports nothing, to be quick.
"""

import ctypes
import os
import signal
import sys

#: Of ``prctl(2)``: the signal that a process gets when its parent is gone.
PR_SET_PDEATHSIG = 1

if __name__ == "__main__":
    parent, command = int(sys.argv[1]), sys.argv[2:]
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
        if os.getppid() != parent:
            sys.exit("the process that asked for it is gone")
    os.execv(command[0], command)
