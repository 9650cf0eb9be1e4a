"""An observer gives way to the nodes of a run while that is running, and no longer."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

_SYS_NICE = 23  # the capability to raise priorities
_STATUS = Path("/proc/self/status")
_CAPABILITIES = re.search(r"^CapEff:\s*(\w+)", _STATUS.read_text(), re.MULTILINE) if _STATUS.is_file() else None

SCRIPT = """
import os, sys
from mast_zenoh.viewer.live import priority

def state():
    return [(os.sched_getscheduler(int(each)), os.getpriority(os.PRIO_PROCESS, int(each)))
            for each in os.listdir("/proc/self/task")]

(before,) = {*state()}
restore = getattr(priority, sys.argv[1])()
during = (os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0))
restore()
print(during != before, {*state()} == {before})
"""


@pytest.mark.skipif(
    _CAPABILITIES is None or not int(_CAPABILITIES[1], 16) >> _SYS_NICE & 1, reason="the system lets nobody go back"
)
@pytest.mark.parametrize("function", ["yield_processors", "yield_to_nodes"])
def test_an_observer_that_gave_way_has_its_priority_back_when_the_run_is_over(function: str) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "MAST_VIEWER_NICENESS"}
    output = subprocess.check_output(
        [sys.executable, "-c", SCRIPT, function], text=True, env=environment, start_new_session=True
    )
    assert output.split() == ["True", "True"]
