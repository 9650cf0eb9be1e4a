"""A message with an implausible time costs only itself, and is counted."""

from pathlib import Path

import numpy as np
import pytest
from tiny_world import PERIOD_NS, Bench, Run, states, tiny

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


@pytest.mark.parametrize("encode", [True, False])
@pytest.mark.parametrize(
    ("frames", "by_ns", "lost", "reason"),
    [
        *((1, by_ns, [WRONG], "time") for by_ns in (10**17, 30 * SECOND, -3 * SECOND // 2)),
        (3, -SECOND // 2, [WRONG, WRONG + 1, WRONG + 2], "old"),
        (1, SECOND // 2, [*range(WRONG + 1, WRONG + 5)], "old"),
    ],
    ids=["far in the future", "in the future", "in the past", "older than the newest", "ahead within the leeway"],
)
def test_a_batch_with_an_implausible_time_costs_only_pictures(
    tmp_path: Path, frames: int, by_ns: int, lost: list[int], reason: str, encode: bool
) -> None:
    run = Run(restamped(tmp_path, frames=frames, by_ns=by_ns), encode=encode)
    assert pictured(run) == [frame for frame in range(FRAMES) if frame not in lost]
    assert run.rejected["command_center"] == {("cc/collated", reason): len(lost)}
    assert not run.failures
    meter = next(m for m in run.nodes["evaluator"].data.meter.meters if m.passage.node == "restamper")
    effects = [(e.effect, e.frame) for e in meter.effects.messages]
    assert effects == [(RESTAMPED, frame) for frame in range(WRONG, WRONG + frames)]


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
