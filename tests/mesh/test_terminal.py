"""What a terminal shows of a run on a mesh is measured there, also on a secure one."""

from __future__ import annotations

from pathlib import Path

import pytest
from drawn_statuses import console, drawn_statuses, evaluated

from mast_zenoh import scenario
from mast_zenoh.launch import run

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]
SILENT = {"evaluator", "recorder"}


@pytest.mark.parametrize(("mode", "secure", "frames"), [("lockstep", "acl", 240), ("realtime", "open", 60)])
def test_rates_lags_and_the_score_are_those_of_the_run(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, mode: str, secure: str, frames: int
) -> None:
    drawn = drawn_statuses(monkeypatch)
    path, loaded = scenario.load(
        "coordinated", ("n_infrastructure=2", "n_adversaries=1", f"attack_start_s={frames / 20}")
    )
    resolved = scenario.resolve(path, loaded, frames=frames, mode=mode, rate=2.0, record=True)
    ended = run.run(resolved, tmp_path / "run", secure=secure, console=console(80))
    assert ended.error is None
    playing = [each for each in drawn if each.activities]
    heard = [each for each in playing if all(each.activities[name].drops is not None for name in ("ego", "broker"))]
    for name in resolved.nodes.keys() - SILENT:
        activities = [each.activities[name] for each in playing]
        assert any(each.rate_hz for each in activities), name
        assert min(each.lag for each in activities if each.lag is not None) <= 1, name
    assert all(each.activities[name].rate_hz is None for each in playing for name in SILENT)
    if mode == "lockstep":
        assert all(each.activities[name].drops == 0 for each in heard for name in ("simulator", "ego", "broker"))
    states = {
        (each.frame > frames // 2, each.states["adversary_1"]) for each in playing if each.states["ego"] == "running"
    }
    assert states >= {(False, "running"), (True, "attack")}
    expected = evaluated(ended.folder)
    scores = [each.score for each in playing if each.score is not None]
    assert len({each.frame for each in scores}) > 3
    assert all(each[2:5] == expected[each.frame] for each in scores)
    latencies = {each.latency_ms is not None and each.latency_ms > 0.0 for each in scores}
    assert latencies == {mode == "realtime"}
