"""An observer gives way to the nodes of a run while that is running, and no longer."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from mast_zenoh.runs.live import priority

_SYS_NICE = 23  # the capability to raise priorities
_STATUS = Path("/proc/self/status")
_CAPABILITIES = re.search(r"^CapEff:\s*(\w+)", _STATUS.read_text(), re.MULTILINE) if _STATUS.is_file() else None

SCRIPT = """
import os, sys
from mast_zenoh.runs.live import priority

def state():
    return [(os.sched_getscheduler(int(each)), os.getpriority(os.PRIO_PROCESS, int(each)))
            for each in os.listdir("/proc/self/task")]

(before,) = {*state()}
restore = getattr(priority, sys.argv[1])()
during = (os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0))
restore()
print(during != before, {*state()} == {before})
"""


NICE = pytest.mark.skipif(
    _CAPABILITIES is None or not int(_CAPABILITIES[1], 16) >> _SYS_NICE & 1, reason="the system lets nobody go back"
)


@NICE
@pytest.mark.parametrize("function", ["yield_processors", "yield_to_nodes"])
def test_an_observer_that_gave_way_has_its_priority_back_when_the_run_is_over(function: str) -> None:
    output = subprocess.check_output(
        [sys.executable, "-c", SCRIPT, function], text=True, env=environment(), start_new_session=True
    )
    assert output.split() == ["True", "True"]


@NICE
def test_who_waits_for_an_observer_gives_it_its_priority_back() -> None:
    script = (
        "from mast_zenoh.runs.live import priority; priority.yield_processors(); print('yields', flush=True); input()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=environment(),
        start_new_session=True,
    ) as process:
        assert process.stdout.readline() == b"yields\n"
        before = state_of(process.pid)
        priority.restore(process.pid, os.getpriority(os.PRIO_PROCESS, 0))
        assert state_of(process.pid) == state_of(0) != before
        process.communicate(b"\n")


def state_of(process: int) -> tuple[int, int]:
    """Scheduling policy and niceness; 0: this process."""
    return os.sched_getscheduler(process), os.getpriority(os.PRIO_PROCESS, process)


def environment() -> dict[str, str]:
    """That of this process, with the usual niceness of observers."""
    return {name: value for name, value in os.environ.items() if name != priority.NICENESS}
