"""`make bench` measures every ratio."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
COMPARED = (
    *("in process, baseline: other", "in process, attacked: other", "in process, defended: other"),
    *("mesh, baseline: other", "mesh, baseline: secured", "mesh, baseline: bare messages"),
    *("tracker: filterpy", "tracker: stone soup", "link: relay"),
)


@pytest.mark.heavy
@pytest.mark.mesh
@pytest.mark.timeout(1200)
def test_every_ratio_is_measured_at_least_once_however_short_the_time() -> None:
    for needed in ("hatchling", "stonesoup"):
        pytest.importorskip(needed)
    git = shutil.which("git")
    if not git or subprocess.run([git, "rev-parse", "HEAD"], cwd=ROOT, capture_output=True).returncode:
        pytest.skip("this is no git checkout, so there is no other version to compare with")
    command = [sys.executable, "benchmarks/ratios.py", "--minutes", "0", "--frames", "20", "--against", "HEAD"]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    times = dict(line.rsplit(maxsplit=4)[::4] for line in done.stdout.splitlines()[2:])
    assert times.keys() >= set(COMPARED)
    assert set(times.values()) == {"1"}
