"""A message with an implausible time costs only itself, and is counted."""

from pathlib import Path

import numpy as np
import pytest
from tiny_world import PERIOD_NS, Bench, Run, detections, pose, states, tiny

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.effects.passages import RESTAMPED
from mast_zenoh.messages.schemas import text

FRAMES, WRONG = 30, 20
SECOND = 10**9

RESTAMPER = '''
from mast_zenoh.node import Node


class Restamper(Node):
    """Puts the times of the batches wrong from one frame on, for so many frames."""

    role = "tap"
    inputs = {"collated": "collated"}
    outputs = {"collated_out": "collated"}

    def __init__(self, at: int, frames: int, by_ns: int, declared_s: float = 0.0) -> None:
        self.at, self.frames, self.by_ns, self.declared_s = at, frames, by_ns, declared_s

    def restamps_s(self, duration_s):
        return self.declared_s

    def on_collated(self, received, context):
        wrong = self.at <= received.frame < self.at + self.frames
        context.relay("collated_out", received, time_ns=max(0, received.time_ns + self.by_ns) if wrong else None)
'''


def restamped(folder: Path, **config: object) -> Resolved:
    """A scenario with changed times of some batches to the command centre."""
    file = folder / "restamper.py"
    file.write_text(RESTAMPER)
    path, content = scenario.load("baseline", ["n_infrastructure=2"])
    content["nodes"] = {"restamper": dict(role="tap", file=str(file), at=WRONG, **config)}
    insert = dict(wire="cc/collated", role="tap", input="collated", output="collated_out")
    content["keyexpr"] = {"rewrites": [{"insert": [insert]}]}
    return scenario.resolve(path, content, frames=FRAMES, seed=0)


def pictured(run: Run) -> list[int]:
    return [message.header.frame for message in run.decoded("cc/picture", "picture")]


def all_but(*frames: int) -> list[int]:
    return [frame for frame in range(FRAMES) if frame not in frames]


@pytest.mark.parametrize("encode", [True, False])
@pytest.mark.parametrize("by_ns", [10**17, 30 * SECOND, -3 * SECOND // 2])
def test_a_batch_with_an_impossible_time_costs_one_picture(tmp_path: Path, by_ns: int, encode: bool) -> None:
    run = Run(restamped(tmp_path, frames=1, by_ns=by_ns), encode=encode)
    assert pictured(run) == all_but(WRONG)
    assert run.rejected["command_center"] == {("cc/collated", "time"): 1}
    assert not run.failures
    meter = next(m for m in run.nodes["evaluator"].data.meter.meters if m.passage.node == "restamper")
    assert [(e.effect, e.frame) for e in meter.effects.messages] == [(RESTAMPED, WRONG)]


def test_batches_older_than_the_newest_are_omitted_without_a_failure(tmp_path: Path) -> None:
    run = Run(restamped(tmp_path, frames=3, by_ns=-SECOND // 2))
    assert pictured(run) == all_but(WRONG, WRONG + 1, WRONG + 2)
    assert run.rejected["command_center"] == {("cc/collated", "old"): 3}
    assert not run.failures


def test_a_batch_ahead_within_the_leeway_only_supersedes_the_next_batches(tmp_path: Path) -> None:
    run = Run(restamped(tmp_path, frames=1, by_ns=SECOND // 2))
    assert pictured(run) == all_but(*range(WRONG + 1, WRONG + 5))
    assert run.rejected["command_center"] == {("cc/collated", "old"): 4}
    assert not run.failures


def test_the_declared_time_error_of_a_node_is_allowed(tmp_path: Path) -> None:
    wrong = dict(frames=FRAMES, by_ns=30 * SECOND)
    assert pictured(Run(restamped(tmp_path, **wrong))) == list(range(WRONG))
    run = Run(restamped(tmp_path, **wrong, declared_s=30.0))
    assert pictured(run) == list(range(FRAMES))
    assert not run.rejected


def test_a_scenario_with_a_faulty_clock_widens_the_tolerance() -> None:
    def skewed(content: dict[str, object]) -> None:
        skew = dict(type="ClockSkew", offset_s=-20.0)
        content["links"] = {"infra_1": dict(up=[skew]), "*": dict(up=[])}

    plain, faulty = tiny(), tiny(edit=skewed)
    assert plain.timespan.leeway_ns == SECOND
    assert faulty.timespan.leeway_ns == 21 * SECOND
    assert Resolved.from_json(faulty.to_json(), faulty.wiring).timespan == faulty.timespan
    assert not Run(faulty).rejected


def test_detections_of_a_later_frame_do_not_advance_an_agents_tracker() -> None:
    agent = Bench(tiny(), "infra_1")
    mount = detections((5.0, 0.0))
    for frame in range(3):
        agent.clock(frame)
        agent.send("pose", pose(), frame)
        if frame == 0:
            forged = agent.message(agent.key("detections"), mount, 2, time_ns=3 * SECOND)
            agent.deliver(agent.key("detections"), forged, step=0)
        agent.send("detections", mount, frame)
    times = [message.header.time_ns for message in agent.heard("agent/infra_1/tracks")]
    assert times == [0, PERIOD_NS, 2 * PERIOD_NS]
    assert not agent.host.failures


@pytest.mark.parametrize("encode", [True, False])
def test_no_pipeline_gets_a_batch_older_than_the_previous_one(encode: bool) -> None:
    centre = Bench(tiny(), "command_center", encode=encode)
    body = states((0.0, 0.0)).columns() | {
        "agent": np.zeros(1, np.int64),
        "agents": text(["a"]),
        "age_ns": np.zeros(1, np.int64),
    }
    key = centre.key("collated")
    for frame, time_ns in ((0, 0), (1, 4 * PERIOD_NS), (2, 2 * PERIOD_NS), (3, 4 * PERIOD_NS)):
        centre.clock(frame)
        centre.deliver(key, centre.message(key, body, frame, time_ns=time_ns))
    assert [message.header.frame for message in centre.heard("cc/picture")] == [0, 1, 3]
    assert centre.host.rejected == {(key, "old"): 1}
    assert centre.host.first_rejected[key][1].startswith("old: collated: time_ns is 200000000, expected at least 4000")
    assert not centre.host.failures
