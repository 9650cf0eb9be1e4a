"""A scenario on the mesh: one process per role, same result as in one."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
from launched import Launched, Observer

from mast_zenoh import scenario
from mast_zenoh.launch import run as launcher

pytestmark = pytest.mark.mesh
FRAMES = 12
SHORT = ("--frames", str(FRAMES))


def metrics(folder: Path) -> bytes:
    return (folder / "metrics.json").read_bytes()


def in_process(out: Path, name: str, *settings: str, frames: int = FRAMES, seed: int | None = None) -> Path:
    path, loaded = scenario.load(name, settings)
    outcome = launcher.run(scenario.resolve(path, loaded, frames=frames, seed=seed), out, runtime="inproc")
    assert outcome.error is None
    return outcome.folder


def test_every_role_runs_in_its_own_process_and_the_output_is_plain_lines_without_a_terminal(launch) -> None:
    run: Launched = launch("uncoordinated", "--set", "n_adversaries=2", *SHORT)
    code, output = run.end()
    assert code == 0, output
    record = run.record()
    roles = sorted(node["role"] for node in record["nodes"].values())
    assert roles == sorted(
        ["simulator", *["agent"] * 5, "broker", "command_center", "adversary", "adversary", "evaluator", "recorder"]
    )
    assert len(set(run.pids())) == 12
    assert all(node["ended"] == "ok" and node["last_frame"] == FRAMES - 1 for node in record["nodes"].values())
    assert record["status"] == "ok"
    assert record["timings"]["frames_per_second"] > 0
    assert {
        "scenario.json",
        "wiring.json",
        "metrics.json",
        "metrics.parquet",
        "objects.parquet",
        "attacks.parquet",
        "messages.mcap",
    } <= {path.name for path in run.out.iterdir()}
    assert (run.out / "logs" / "ego.log").is_file()
    assert "\x1b[" not in output
    assert "FN" in output
    assert str(run.out) in output.replace("\n", "")


def test_metrics_on_the_mesh_equal_those_in_one_process_exactly(launch, tmp_path: Path) -> None:
    run: Launched = launch("coordinated", "--frames", "60", "--seed", "3")
    code, output = run.end()
    assert code == 0, output
    assert metrics(run.out) == metrics(in_process(tmp_path / "inproc", "coordinated", frames=60, seed=3))


def test_interposers_that_change_nothing_leave_no_trace(launch, tmp_path: Path) -> None:
    """Key, encoding, attachment, payload (header and number), order and QoS."""
    seen = []
    for name in ("baseline", "passthrough"):
        run: Launched = launch(name, *SHORT)
        observer = Observer(run.started())
        try:
            code, output = run.end()
        finally:
            observer.close()
        assert code == 0, output
        by_key: dict[str, list] = {}
        for key, s in observer.samples:
            by_key.setdefault(key, []).append(
                (
                    str(s.encoding),
                    s.attachment.to_bytes() if s.attachment else None,
                    s.payload.to_bytes(),
                    s.kind,
                    s.priority,
                    s.congestion_control,
                    s.express,
                    s.timestamp,
                    s.source_info,
                )
            )
        assert len(by_key["clock"]) == FRAMES, "the observer was connected from the first frame"
        seen.append((by_key, metrics(run.out)))
    (plain, plain_metrics), (tapped, tapped_metrics) = seen
    assert plain.keys() == tapped.keys()
    for key in plain:
        assert plain[key] == tapped[key], key
    measured, expected = json.loads(tapped_metrics), json.loads(plain_metrics)
    assert all(interposer["effects"] == {} for interposer in measured.pop("interposers").values())
    assert not any(each["success_centre"] or each["success_ego"] for each in measured.pop("achieved").values())
    assert (expected.pop("interposers"), expected.pop("achieved")) == ({}, {})
    assert measured == expected


def test_simultaneous_runs_do_not_interfere(launch, tmp_path: Path) -> None:
    runs = [launch("baseline", *SHORT, "--seed", "1") for _ in range(2)]
    for run in runs:
        code, output = run.end()
        assert code == 0, output
        assert not any(node["foreign"] or node["rejected"] for node in run.record()["nodes"].values())
    assert metrics(runs[0].out) == metrics(runs[1].out) == metrics(in_process(tmp_path / "alone", "baseline", seed=1))
    assert runs[0].record()["id"] != runs[1].record()["id"]


def test_a_real_time_run_keeps_pace_and_measures_its_latency(launch) -> None:
    run: Launched = launch("baseline", "--frames", "40", "--mode", "realtime", "--rate", "2")
    code, output = run.end()
    assert code == 0, output
    scores = json.loads(metrics(run.out))
    assert scores["frames"] == 40
    assert scores["frames_per_second"] == pytest.approx(20, rel=0.2), "twice 10 Hz"
    assert 0 < scores["latency_ms"]["sim_to_picture"]["p50"] <= scores["latency_ms"]["sim_to_picture"]["p99"]
    wires = scores["latency_ms"]["by_wire"]
    assert {"clock", "agent/ego/detections", "agent/infra_1/tracks", "cc/picture"} <= wires.keys()
    assert all(0 < wire["p50"] <= wire["p95"] <= wire["p99"] and 0 < wire["n"] <= 40 for wire in wires.values())
    assert wires["agent/ego/pose"]["p50"] < wires["agent/ego/tracks"]["p50"] < wires["cc/picture"]["p50"]
    assert scores["agents"]["ego"]["picture"]["tp"]["mean"] > 5


def test_an_existing_router_can_be_used(launch, tmp_path: Path) -> None:
    from mast_zenoh.runtime.mesh.session import open_router

    router, endpoint = open_router()
    with router:
        run: Launched = launch("baseline", *SHORT, "--endpoint", endpoint)
        code, output = run.end()
    assert code == 0, output
    assert metrics(run.out) == metrics(in_process(tmp_path / "inproc", "baseline"))


def test_a_user_defined_node_next_to_the_scenario_takes_part(launch, tmp_path: Path) -> None:
    (tmp_path / "deaf.py").write_text(
        "import gc\n"
        "from mast_zenoh.node import Node\n"
        "from mast_zenoh.runtime.mesh.main import main\n"
        "class Deaf(Node):\n"
        "    role = 'adversary'\n"
        "    inputs = {'clock': 'clock', 'detections': 'detections'}\n"
        "    outputs = {'detections_out': 'detections'}\n"
        "    def __init__(self, agent: str):\n"
        "        self.agent = agent\n"
        "    def on_clock(self, received, context):\n"
        "        assert gc.isenabled(), 'it is off only until the node is hosted'\n"
        "    def on_detections(self, received, context):\n"
        "        empty = {name: column if name.startswith('mount') else column[:0]\n"
        "                 for name, column in received.body.items()}\n"
        "        context.relay('detections_out', received, empty)\n"
        "if __name__ == '__main__':\n"
        "    main(Deaf)\n"
    )
    (tmp_path / "mine.py").write_text(
        "from mast_zenoh.config import loading\n"
        "_, baseline = loading.function('scenarios', 'baseline', 'scenario')\n"
        "def scenario():\n"
        "    return baseline() | dict(\n"
        "        adversaries=dict(deaf=dict(file='deaf.py', agent='infra_2')),\n"
        "        keyexpr=dict(map='testbed.toml', rewrites=[dict(insert=[dict(wire='agent/{agent}/detections',\n"
        "            role='adversary', input='detections', output='detections_out')])]),\n"
        "    )\n"
    )
    run: Launched = launch(str(tmp_path / "mine.py"), *SHORT)
    code, output = run.end()
    assert code == 0, output
    agents = json.loads(metrics(run.out))["agents"]
    assert agents["infra_2"]["local"]["tp"]["mean"] == 0
    assert agents["infra_1"]["local"]["tp"]["mean"] > 0


def test_a_node_that_dies_beyond_the_last_recorded_frame_is_named_with_its_frame(launch, tmp_path: Path) -> None:
    shutil.copy(Path(__file__).parents[1] / "support" / "live" / "simulator.py", tmp_path)
    (tmp_path / "mortal.py").write_text(
        "import os\n"
        "from mast_zenoh.node import Node\n"
        "class Mortal(Node):\n"
        "    role = 'adversary'\n"
        "    inputs = {'clock': 'clock', 'detections': 'detections'}\n"
        "    outputs = {'detections_out': 'detections'}\n"
        "    def __init__(self, agent: str):\n"
        "        self.agent = agent\n"
        "    def on_clock(self, received, context):\n"
        "        if received.frame == 25:\n"
        "            os._exit(9)\n"
        "    def on_detections(self, received, context):\n"
        "        context.relay('detections_out', received)\n"
    )
    (tmp_path / "longer.py").write_text(
        "from mast_zenoh.config import loading\n"
        "_, baseline = loading.function('scenarios', 'baseline', 'scenario')\n"
        "def scenario():\n"
        "    return baseline(n_infrastructure=1) | dict(\n"
        "        adversaries=dict(mallory=dict(file='mortal.py', agent='infra_1', on_exit='fail')),\n"
        "        keyexpr=dict(map='testbed.toml', rewrites=['on_detections.toml']),\n"
        "    )\n"
    )
    run: Launched = launch(str(tmp_path / "longer.py"), "--frames", "10", "--no-record")
    code, output = run.end()
    assert code == 22, output
    died = re.search(r"mallory exit code 9 at frame (\d+)", output)
    assert died, output
    assert int(died[1]) >= 25
    frames = [int(frame) for frame in re.findall(r"frame (\d+) of 10", output)]
    assert max(frames) <= 10, "beyond the recording the length is unknown"
