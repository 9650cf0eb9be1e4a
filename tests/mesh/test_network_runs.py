"""Runs in three namespaces: partitions, a slow link, and interruptions."""

import json
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import zenoh
from launched import Launched, Observer, alive, eventually
from namespaced import leftovers_of, require

from mast_zenoh.launch.netns.namespaces import NAMESPACES, sweep
from mast_zenoh.messages import codec
from mast_zenoh.run_folder.recording.reader import read

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]
WEST = {"infra_1", "infra_2"}


@pytest.fixture
def two_hosts(launch) -> Iterator:
    """Starts scenarios/two_hosts.py; fails if anything of it remains."""
    require("partition", "relay")
    runs: list[Launched] = []

    def start(frames: int, **settings: object) -> Launched:
        words = [word for key, value in settings.items() for word in ("--set", f"{key.replace('__', '.')}={value}")]
        runs.append(launch("two_hosts", "--frames", str(frames), *words))
        return runs[-1]

    yield start
    assert [name for run in runs for name in leftovers_of(run.process.pid)] == []


class Stopwatch(Observer):
    """Records the arrival time of each message, ns."""

    def __init__(self, record: dict) -> None:
        self.came_ns: dict[str, dict[int, int]] = {}
        super().__init__(record)

    def _take(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr).removeprefix(self.prefix)
        if (attachment := sample.attachment) and (key == "clock" or key.endswith("/tracks")):
            frame = int.from_bytes(attachment.to_bytes()[16:24], "little", signed=True)
            self.came_ns.setdefault(key, {}).setdefault(frame, time.monotonic_ns())

    def longest_silence_s(self, key: str) -> float:
        """The longest gap between two messages on a key."""
        return float(np.diff(sorted(self.came_ns[key].values())).max()) * 1e-9

    def delays_ms(self, agent: str) -> np.ndarray:
        """Time from a frame's clock to this agent's tracks, as seen at the centre."""
        clock, tracks = self.came_ns.get("clock", {}), self.came_ns.get(f"agent/{agent}/tracks", {})
        return np.array([(tracks[frame] - clock[frame]) * 1e-6 for frame in tracks if frame in clock])


def test_after_a_partition_of_five_seconds_the_picture_recovers_within_three(two_hosts) -> None:
    run: Launched = two_hosts(100, cut_s=1.5, partition_s=5.0)
    with closing(Stopwatch(run.started())) as watch:
        run.ended()
    for key in ("clock", "agent/infra_3/tracks"):
        assert watch.longest_silence_s(key) < 2.0, "agents that are not cut off continue during the partition"
    record = run.record()
    assert record["status"] == "ok"
    assert {name: (node["ended"], node["restarts"]) for name, node in record["nodes"].items()} == dict.fromkeys(
        record["nodes"], ("ok", 0)
    ), "no process has crashed"
    assert [(step["at_s"], step["hosts"]) for step in record["network"]] == [(1.5, ["west"]), (6.5, ["west"])]

    heard = {}  # by frame, the agents whose own message about this frame is in the collation
    for message in read(run.out):
        if message.message == "collated":
            decoded = codec.decode(message.payload, "collated")
            heard[decoded.header.frame] = set(decoded.body["agents"][decoded.body["age_ns"] == 0].tolist())
    assert any(heard[frame] >= WEST for frame in range(15) if frame in heard)
    assert not any(heard[frame] & WEST for frame in range(20, 65) if frame in heard), "west is cut off"
    back = min(frame for frame in heard if frame >= 65 and heard[frame] >= WEST)
    assert back <= 95, "within 3 s of the heal both are members again"

    checks = json.loads((run.out / "checks.json").read_text())
    assert [check["name"] for check in checks["checks"] if not check["ok"]] == [], checks
    assert checks["heals_s"] == [6.5]
    assert checks["converged_after_s"] <= 3.0
    missed = json.loads((run.out / "metrics.json").read_text())["agents"]["ego"]["picture"]["fn"]["mean"]
    assert missed > 0, "the partition had an effect"


def test_a_slow_link_adds_twice_its_delay_to_a_round_trip(two_hosts) -> None:
    settings = {"hosts__west__delay_ms": 20, "hosts__west__delay_by": "relay"}
    run: Launched = two_hosts(40, partition_s=0, **settings)
    with closing(Stopwatch(run.started())) as watch:
        run.ended()
    near, far = (np.concatenate([watch.delays_ms(agent) for agent in agents]) for agents in (("infra_3", "ego"), WEST))
    assert len(far) > 20
    # Detections cross to the agent, tracks back. The faster frames, as the machine may be busy; not the very fastest,
    # whose clock the stopwatch may have recorded late.
    quick = np.percentile(far, 25)
    assert quick >= 40.0
    rise = quick - np.percentile(near, 25)
    assert 30.0 < rise < 60.0
    measured = json.loads((run.out / "metrics.json").read_text())["latency_ms"]["by_wire"]
    for agent in WEST:
        assert measured[f"agent/{agent}/detections"]["p50"] >= 20.0
        assert measured[f"agent/{agent}/tracks"]["p50"] >= 40.0
    for agent in ("infra_3", "infra_4", "ego"):
        assert measured[f"agent/{agent}/detections"]["p50"] < measured["agent/infra_1/detections"]["p50"]


@pytest.mark.parametrize("how", ["scene ends", "Ctrl-C"])
def test_a_run_that_ends_during_a_partition_heals_it_and_collects_all_results(two_hosts, how: str) -> None:
    run: Launched = two_hosts(40 if how == "scene ends" else 150, cut_s=0.5, partition_s=1000.0)
    if how == "Ctrl-C":
        run.at_frame(35)  # disconnected nodes have been given up
        run.process.send_signal(signal.SIGINT)
    run.ended(0 if how == "scene ends" else 130)
    record = run.record()
    assert all(node["exit"] == 0 and node["last_frame"] is not None for node in record["nodes"].values()), record
    assert (run.out / "metrics.json").is_file()


def test_remnants_of_a_killed_launcher_are_empty_and_removed_by_the_next_run(two_hosts) -> None:
    run: Launched = two_hosts(100, partition_s=1000.0, hosts__west__delay_ms=5, hosts__west__delay_by="relay")
    run.at_frame(5)
    pids = run.pids()
    assert alive(pids) == pids
    run.kill()
    eventually(lambda: not alive(pids), "all nodes have left", seconds=10.0)
    left = list(NAMESPACES.glob(f"mast-{run.process.pid}-*"))
    assert len(left) == 3

    def inside(namespace: Path) -> str:
        return subprocess.run(["ip", "netns", "pids", namespace.name], capture_output=True, text=True).stdout

    eventually(lambda: not any(inside(path) for path in left), "router and relay have left", seconds=5.0)
    sweep()
