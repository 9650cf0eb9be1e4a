"""A defended run with a fault is compared with the same run without it, in every place that compares."""

from __future__ import annotations

from pathlib import Path

import pytest

import mast_zenoh as testbed
from mast_zenoh.scenario.reading import load
from mast_zenoh.viewer.page.page import viewer_page


@pytest.mark.heavy
def test_a_defended_run_is_compared_with_the_same_run_without_its_fault(mast, tmp_path: Path) -> None:
    _, scenario = load("defended", ["defence=FaultOrLie", "attack_start_s=0.5", "n_infrastructure=2"])
    fault = dict(type="BlindSector", node="infra_1", at=0.5, azimuth_min_deg=-60.0, azimuth_max_deg=60.0)
    faulted, sound = (
        testbed.run(scenario | dict(faults=faults), frames=40, seed=5, out=tmp_path / name)
        for name, faults in (("faulted", [fault]), ("sound", []))
    )
    code, out, err = mast("report", "faulted", "--against", "sound")
    assert code == 0, err
    assert "than sound" in " ".join(out.split())
    compared = testbed.compare(sound, faulted)
    assert compared.headline in " ".join(str(compared).split())
    assert len(set(compared.table["run"].to_pylist())) == 2
    assert "defended and sound" in viewer_page([faulted.path, sound.path]).decode()
