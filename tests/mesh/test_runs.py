"""A scenario on the mesh: one process per role, same result as in one."""

import json
import os
import signal
from collections import defaultdict
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from equal_runs import run_alone
from launched import Launched, Observer

from mast_zenoh.mesh.session import open_router

pytestmark = pytest.mark.mesh
FRAMES = 12
SHORT = ("--frames", str(FRAMES))


def metrics(folder: Path) -> bytes:
    return (folder / "metrics.json").read_bytes()


def test_at_a_given_router_every_role_has_its_own_process_and_metrics_are_those_of_one_process(
    launch, tmp_path
) -> None:
    router, endpoint = open_router()
    with router:
        run: Launched = launch(
            "uncoordinated", "--set", "n_infrastructure=2", *SHORT, "--seed", "3", "--endpoint", endpoint
        )
        output = run.ended()
    record = run.record()
    assert record["endpoint"] == endpoint
    roles = sorted(node["role"] for node in record["nodes"].values())
    assert roles == sorted(
        ["simulator", *["agent"] * 3, "broker", "command_center", "adversary", "adversary", "evaluator", "recorder"]
    )
    assert len(set(run.pids())) == 10
    assert all(node["ended"] == "ok" and node["last_frame"] == FRAMES - 1 for node in record["nodes"].values())
    assert record["status"] == "ok"
    assert record["timings"]["frames_per_second"] > 0
    tables = {f"{name}.parquet" for name in ("metrics", "objects", "attacks")}
    files = {path.name for path in run.out.iterdir()}
    assert {"scenario.json", "wiring.json", "metrics.json", "messages.mcap", *tables} <= files
    assert (run.out / "logs" / "ego.log").is_file()
    assert not (run.out / "logs" / "protocol").exists()
    assert "\x1b[" not in output
    assert "FN" in output
    assert str(run.out) in output.replace("\n", "")
    assert metrics(run.out) == metrics(
        run_alone(tmp_path / "inproc", "uncoordinated", "n_infrastructure=2", frames=FRAMES, seed=3)
    )


@pytest.mark.heavy
def test_simultaneous_runs_do_not_interfere_and_interposers_that_change_nothing_leave_no_trace(
    launch, tmp_path: Path
) -> None:
    """Key, encoding, attachment, payload (header and number), order and QoS."""
    runs: list[Launched] = []
    simulators: list[int] = []
    for name in ("baseline", "passthrough"):
        runs.append(launch(name, *SHORT, "--seed", "1"))
        simulators.append(runs[-1].started()["nodes"]["simulator"]["pid"])
        os.kill(simulators[-1], signal.SIGSTOP)  # no frame is played before the observers are there
    observers = [Observer(run.record()) for run in runs]
    for observer in observers:
        list(observer.session.liveliness().get(f"{observer.prefix}**"))  # answered after its subscription has arrived
    for pid in simulators:
        os.kill(pid, signal.SIGCONT)
    heard: list[dict[str, list[tuple[Any, ...]]]] = []
    for run, observer in zip(runs, observers, strict=True):
        with closing(observer):
            run.ended()
        assert not any(node["foreign"] or node["rejected"] for node in run.record()["nodes"].values())
        by_key = defaultdict(list)
        for key, s in observer.samples:
            content = s.payload.to_bytes(), s.attachment.to_bytes() if s.attachment else None
            quality = s.priority, s.congestion_control, s.express
            by_key[key].append((str(s.encoding), s.kind, s.timestamp, s.source_info, *quality, *content))
        assert len(by_key["clock"]) == FRAMES, "the observer was connected from the first frame"
        heard.append(by_key)
    plain, tapped = heard
    assert plain.keys() == tapped.keys()
    for key in plain:
        assert plain[key] == tapped[key], key
    assert metrics(runs[0].out) == metrics(run_alone(tmp_path / "alone", "baseline", frames=FRAMES, seed=1))
    expected, measured = (json.loads(metrics(run.out)) for run in runs)
    assert all(interposer["effects"] == {} for interposer in measured.pop("interposers").values())
    assert not any(each["success_centre"] or each["success_ego"] for each in measured.pop("achieved").values())
    assert (expected.pop("interposers"), expected.pop("achieved")) == ({}, {})
    assert measured == expected
    assert runs[0].record()["id"] != runs[1].record()["id"]


def test_a_real_time_run_keeps_pace_and_measures_its_latency(launch) -> None:
    run: Launched = launch(
        "baseline", "--set", "n_infrastructure=1", "--frames", "40", "--mode", "realtime", "--rate", "2"
    )
    run.ended()
    scores = json.loads(metrics(run.out))
    assert scores["frames"] == 40
    assert scores["frames_per_second"] == pytest.approx(20, rel=0.2), "twice 10 Hz"
    assert 0 < scores["latency_ms"]["sim_to_picture"]["p50"] <= scores["latency_ms"]["sim_to_picture"]["p99"]
    wires = scores["latency_ms"]["by_wire"]
    assert {"clock", "agent/ego/detections", "agent/infra_1/tracks", "cc/picture"} <= wires.keys()
    assert all(0 < wire["p50"] <= wire["p95"] <= wire["p99"] and 0 < wire["n"] <= 40 for wire in wires.values())
    assert wires["agent/ego/pose"]["p50"] < wires["agent/ego/tracks"]["p50"] < wires["cc/picture"]["p50"]
    assert scores["agents"]["ego"]["picture"]["tp"]["mean"] > 5
