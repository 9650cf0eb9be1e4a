"""Random scenarios are equal on the mesh and in one process: every message, and the metrics.

MAST_SCENARIOS=60 plays the first 60 of them instead of one of each kind.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from equal_runs import assert_equal, run_alone
from random_scenarios import FRAMES, KINDS, drawn

from mast_zenoh.run_folder.recording.reader import read

pytestmark = [pytest.mark.mesh, pytest.mark.heavy]


@pytest.mark.parametrize("number", range(int(os.environ.get("MAST_SCENARIOS", len(KINDS)))))
def test_a_random_scenario_is_the_same_on_the_mesh_and_in_one_process(launch, tmp_path: Path, number: int) -> None:
    scenario = drawn(number)
    words = [word for setting in scenario.settings for word in ("--set", setting)]
    run = launch(scenario.name, "--frames", str(FRAMES), "--seed", str(scenario.seed), *words)
    run.ended()
    recorded = run.record()["recorded"]  # links may have corrupted some
    assert (recorded["messages"], recorded["lost"]) == (len(list(read(run.out))), 0)
    alone = dict(frames=FRAMES, seed=scenario.seed, record=True)
    assert_equal(run.out, run_alone(tmp_path / "inproc", scenario.name, *scenario.settings, **alone))
