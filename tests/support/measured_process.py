"""The peak memory and the processor time of a command."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from typing import NamedTuple

#: Linux counts the memory of the process that starts another one as the other's, so a small one starts it.
_START = """
import json, os, subprocess, sys
child = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
_, status, usage = os.wait4(child.pid, 0)
child.returncode = os.waitstatus_to_exitcode(status)
print(json.dumps([child.returncode, usage.ru_maxrss << 10, usage.ru_utime]))
"""


class Measured(NamedTuple):
    """A finished process.

    peak_bytes: of resident memory;  user_s: s of processor time
    """

    code: int
    peak_bytes: int
    user_s: float


def measure(words: Sequence[str], timeout_s: float) -> Measured:
    """Run a command to its end. Raises TimeoutExpired if it takes longer, such as in a file that never ends."""
    starter = [sys.executable, "-I", "-c", _START, *words]
    with subprocess.Popen(starter, stdout=subprocess.PIPE, process_group=0) as process:
        try:
            output, _ = process.communicate(timeout=timeout_s)
        except BaseException:
            os.killpg(process.pid, signal.SIGKILL)
            raise
    return Measured(*json.loads(output))
