"""User-written scenarios with failures, for one process or a mesh."""

from pathlib import Path

#: By name: a scenario file, and node files next to it.
FILES = {
    # An attack that fails from frame 5 on, on the detections of infra_1.
    "attack": {
        "attack.py": """
from mast_zenoh.config import loading
from mast_zenoh.attacks import Attack, Tampering

_, baseline = loading.function("scenarios", "baseline", "scenario")


class Fragile(Attack):
    def step(self, frame, time_ns, objects, agent_position, directive=None):
        if frame >= 5:
            raise ValueError(f"no [plan] for frame {frame}")
        return Tampering.nothing(len(objects))


def scenario():
    return baseline(n_infrastructure=1) | dict(
        name="attack",
        adversaries=dict(eve=dict(agent="infra_1", attack=dict(type="Fragile"))),
        keyexpr=dict(map="testbed.toml", rewrites=["on_detections.toml"]),
    )
"""
    },
    # A stage of the command centre's pipeline that fails in every third frame.
    "center": {
        "center.py": """
from mast_zenoh.config import loading
from mast_zenoh.fusion.clustering import SampledAssignmentClusterer

_, baseline = loading.function("scenarios", "baseline", "scenario")


class Fragile(SampledAssignmentClusterer):
    calls = 0

    def cluster(self, states, agent):
        self.calls += 1
        if self.calls % 3 == 0:
            raise RuntimeError("no clusters")
        return super().cluster(states, agent)


def scenario():
    made = baseline(n_infrastructure=1)
    pipeline = made["command_center"]["pipeline"] | dict(clustering=dict(type="Fragile"))
    return made | dict(name="center", command_center=dict(pipeline=pipeline))
"""
    },
    # An adversary that cannot start.
    "start": {
        "start.py": """
from mast_zenoh.config import loading

_, baseline = loading.function("scenarios", "baseline", "scenario")


def scenario():
    return baseline(n_infrastructure=1) | dict(
        name="start",
        adversaries=dict(eve=dict(agent="infra_1", file="idle.py")),
        keyexpr=dict(map="testbed.toml", rewrites=["on_detections.toml"]),
    )
""",
        "idle.py": """
from mast_zenoh.node import Node


class Idle(Node):
    role = "adversary"
    inputs = {"clock": "clock", "detections": "detections"}
    outputs = {"detections_out": "detections"}

    def __init__(self, agent: str):
        self.agent = agent

    def start(self, context):
        raise FileNotFoundError("no weights")

    def on_clock(self, received, context): ...

    def on_detections(self, received, context):
        context.relay("detections_out", received)
""",
    },
    # An evaluator that fails at the end.
    "evaluator": {
        "evaluator_fails.py": """
from mast_zenoh.config import loading

_, baseline = loading.function("scenarios", "baseline", "scenario")


def scenario():
    return baseline(n_infrastructure=1) | dict(name="evaluator", evaluator=dict(file="judge.py"))
""",
        "judge.py": """
from mast_zenoh.node import Node


class Judge(Node):
    role = "evaluator"
    inputs = {"everything": "*"}

    def __init__(self, agents: tuple[str, ...]):
        self.agents = agents

    def on_everything(self, overheard, context): ...

    def finish(self, context):
        return {"metrics": {"mean": 1 / 0}}
""",
    },
    # A user-defined metric that fails, and one that does not.
    "metric": {
        "metric_fails.py": """
from mast_zenoh.config import loading
from mast_zenoh.metrics import FrameMetric, RunMetric

_, baseline = loading.function("scenarios", "baseline", "scenario")


class Broken(FrameMetric):
    def per_frame(self, estimate):
        raise ValueError("no box in frame " + str(len([])))


class Tracks(RunMetric):
    def per_run(self, estimate):
        return float(estimate.is_track.sum())


def scenario():
    metrics = [dict(type="Broken"), dict(type="Tracks")]
    return baseline(n_infrastructure=1) | dict(name="metric", evaluator=dict(metrics=metrics))
"""
    },
    # Two more nodes, which receive only the clock and return fake metrics and tables.
    "second": {
        "second.py": """
from mast_zenoh.config import loading

_, baseline = loading.function("scenarios", "baseline", "scenario")


def scenario():
    counter = dict(role="visualizer", file="counter.py")
    return baseline(n_infrastructure=1) | dict(
        name="second",
        nodes=dict(counter=counter, other=counter | dict(table="../other")),
        keyexpr=dict(rewrites=[{"listen": [dict(wire="clock", role="visualizer", input="clock")]}]),
    )
""",
        "counter.py": """
import numpy as np

from mast_zenoh.node import Node


class Counter(Node):
    role = "visualizer"
    inputs = {"clock": "clock"}

    def __init__(self, table: str = "metrics"):
        self.table = table
        self.frames = []

    def on_clock(self, received, context):
        self.frames.append(received.frame)

    def finish(self, context):
        frames = np.array(self.frames)
        return {
            "metrics": {"frames": "mine", "mean": np.float64("nan"), "all": frames},
            "tables": {self.table: {"frame": frames, "name": [context.name] * len(frames)}},
        }
""",
    },
}


def write(name: str, folder: Path) -> Path:
    """Write the scenario of this name and its files to a folder; returns its path."""
    for file, text in FILES[name].items():
        (folder / file).write_text(text)
    return folder / next(iter(FILES[name]))
