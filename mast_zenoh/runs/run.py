"""One model of a run: what its documents and tables say. Whatever shows or compares runs reads it.

`frame` has the frames of a run.

One agent of a recorded run: the messages that it sent and received.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
import pyarrow
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Floats
from mast_zenoh.config.resolved import RECORDING
from mast_zenoh.errors import ConfigurationError, RunFolderError, nearest
from mast_zenoh.evaluation.estimate_wires import EstimateWires
from mast_zenoh.launch import liveness
from mast_zenoh.launch.ending import RUNNING
from mast_zenoh.metrics.estimates import LOCAL, MISSION, PICTURE, PICTURE_RECEIVED, RECEIVED
from mast_zenoh.metrics.record import Series
from mast_zenoh.run_folder import json_or_empty, read_json, read_object
from mast_zenoh.run_folder.finding import Finding
from mast_zenoh.run_folder.tables import from_arrow, read_arrow
from mast_zenoh.runs import messages as decoded
from mast_zenoh.runs import routes
from mast_zenoh.runs.evaluated import Evaluated
from mast_zenoh.runs.files import RunFiles, Table, rows
from mast_zenoh.runs.messages import WireMessage
from mast_zenoh.scenario.driving import driver_of_car
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.wiring.model import NO_WIRING, Wiring, subject_of

#: Frames of a long run whose tables are read together.
_AROUND = 250
#: What texts call a centre and its picture, and what they are in a run without one, in which the ego's are shown.
_WITHOUT_CENTRE = (
    ("the common picture", "the picture of the ego"),
    ("The common picture", "The picture of the ego"),
    ("the command centre", "the ego peer"),
    ("The command centre", "The ego peer"),
)


class Run:
    """A run: a finished one, one that is going on, or one as of a moment.

    path:  its folder
    frame: of a run that is so long that only every n-th frame is read whole: one of them

    Raises RunFolderError if that is not the folder of a run.
    """

    def __init__(self, path: str | Path, frame: int | None = None) -> None:
        path = Path(path)
        if not path.is_dir():
            raise RunFolderError(f"{path}: no such folder, expected the folder of a run")
        if not (path / "run.json").is_file() and not (path / "scenario.json").is_file():
            raise RunFolderError(f"{path}: holds neither run.json nor scenario.json, expected the folder of a run")
        self.files = RunFiles(path, frame=frame)

    @classmethod
    def of(cls, files: RunFiles) -> Self:
        """A run with these files."""
        run = cls.__new__(cls)
        run.files = files
        return run

    def with_(self, **changes: Any) -> Self:
        """The same run with other contents of its files, by name."""
        return self.of(self.files.with_(**changes))

    def within(self, first: int, end: int) -> Self:
        """The same run with the tables by frame, but for driving and targets, of all from `first` to before `end`."""
        return self.with_(sample=range(first, end))

    def around(self, frame: int) -> Self:
        """The same run with the tables by frame of all frames around one, where it has only a sample of them."""
        if self.files.sample.step == 1:
            return self
        first = frame - frame % _AROUND
        if first not in self._around:
            self._around = {first: self.within(first, first + _AROUND)}
        return self._around[first]

    @cached_property
    def _around(self) -> dict[int, Self]:
        """By first frame, the part of a long run that was asked for last."""
        return {}

    def seen_by(self, agent: str) -> Self:
        """The same run with another agent in the place of the ego.

        Raises ConfigurationError if the run has no such agent.
        """
        if agent not in self.agents:
            raise ConfigurationError(f"{self.path}: no agent {agent!r} in this run{nearest(agent, self.agents)}")
        return self if agent == self.ego else self.with_(agent=agent)

    @property
    def path(self) -> Path:
        """The folder."""
        return self.files.path

    @property
    def origin(self) -> Floats:
        """(3,) m, of the local planes of the run: x and y, and 0.

        What has 32 bits, or is a map projection, is relative to it. Raises ValueError or TypeError if it is damaged.
        """
        x, y = self.files.scenario.get("origin") or (0.0, 0.0)
        return np.array([x, y, 0.0])

    @cached_property
    def agents(self) -> tuple[str, ...]:
        """The agents, the main one first: those of the scenario, or else of the scene, or else with metrics."""
        nodes = self.files.scenario.get("nodes", {})
        names = [name for name, spec in nodes.items() if (spec or {}).get("role") == "agent"]
        names = names or list(self.files.scene.agent_names if self.files.scene else ())
        return tuple(sorted(names or self.files.summary.get("agents", ()), key=lambda name: name != "ego"))

    @cached_property
    def wiring(self) -> Wiring:
        """Its wires by wiring.json; none if that is missing or damaged."""
        try:
            return Wiring.from_json(self.files.wiring)
        except (TypeError, ValueError, LookupError):
            return NO_WIRING

    @cached_property
    def estimate_wires(self) -> EstimateWires:
        """What can affect which estimate; nodes that were inserted live are on the same wires."""
        return EstimateWires(self.wiring, self.agents)

    @cached_property
    def topics(self) -> Mapping[Series, str]:
        """By series of objects, its key expression: the truth first, then the pictures, then those of each agent."""
        topics: dict[Series, str] = {}
        for _, wiring in self.files.wirings:
            topics |= routes.topics(wiring, self.agents)
        return routes.in_order(topics, self.agents)

    @cached_property
    def evaluated(self) -> Evaluated:
        """The evaluator's tables by frame; without outcomes if objects.parquet cannot be used."""
        objects, same_as = self.files.all_objects, self.files.summary.get("same_as") or {}
        judged = from_arrow(objects) if objects is not None else None
        return Evaluated(judged, self.files.counts, self.files.effects, same_as if judged else {})

    @property
    def scored(self) -> list[Series]:
        """Agents and estimates that have objects and scores; of a run that is going on, that can have scores."""
        known = {series.estimator for series in self.topics}
        if not self.files.is_live:
            return [series for series in self.evaluated.series if series.estimator in known]
        estimators = [name for name in (LOCAL, RECEIVED, PICTURE, PICTURE_RECEIVED, MISSION) if name in known]
        series = [Series(agent, name) for agent in self.agents for name in estimators]
        return [each for each in series if each.estimator == PICTURE or each in self.topics]

    @property
    def id(self) -> str:
        """The run's own id."""
        return str(self.files.record.get("id") or self.path.name)

    @cached_property
    def name(self) -> str:
        """The scenario's name, or else what the run is known by."""
        return str(self.files.record.get("name") or self.files.record.get("id") or self.path.name)

    @property
    def ego(self) -> str | None:
        """The agent whose view is shown: `ego` or else the first; None: unknown."""
        return self.files.agent

    def node_spec(self, node: str) -> dict[str, Any]:
        """A node in scenario.json; of a replay's played node, the recorded one."""
        spec = dict(self.files.scenario.get("nodes", {}).get(node, {}))
        recorded = (spec.get("config") or {}).get("recorded")
        return spec | recorded if self.files.record.get("replay") and isinstance(recorded, dict) else spec

    @property
    def believed(self) -> str | None:
        """The estimate of the agent that its driver believes; None: nobody drives its car, or by the truth."""
        config = self.node_spec(driver_of_car(self.ego)).get("config") if self.ego else None
        if not isinstance(config, dict):
            return None
        return {"safety": LOCAL, "mission": MISSION}.get(str(config.get("estimate", "mission")))

    def role(self, node: str) -> str:
        """The role of a node, from run.json or guessed from its wires and name."""
        known = self.files.record.get("nodes", {}).get(node, {}).get("role")
        known = known or self.files.summary.get("interposers", {}).get(node, {}).get("role")
        if known:
            return str(known)
        return "agent" if node in self._agents_in_keys else node.rstrip("0123456789").rstrip("_")

    @cached_property
    def _agents_in_keys(self) -> set[str | None]:
        return {agent_in_key(wire["key"]) for wire in self.files.wiring.get("wires", ())}

    @cached_property
    def manipulations(self) -> Table | None:
        """Effects of interposers other than links, in known frames; None: not measured."""
        if self.files.effects is None:
            return None
        settled = (self.files.effects["effect"] != "unsettled") & (self.files.effects["frame"] >= 0)
        return rows(self.files.effects, settled & (self.files.effects["role"] != "link"))

    @cached_property
    def attack_frames(self) -> tuple[int, int] | None:
        """First and last frame with a change by an adversary; None: none, or not measured."""
        if self.manipulations is None or not len(self.manipulations["frame"]):
            return None
        return int(self.manipulations["frame"].min()), int(self.manipulations["frame"].max())

    @cached_property
    def scored_frames(self) -> tuple[int, int] | None:
        """First and last scored frame, over which means are taken; None: not known."""
        frames = self.files.summary.get("scored_frames")
        return (int(frames[0]), int(frames[-1])) if frames else None

    @property
    def evaluator_config(self) -> dict[str, Any] | None:
        """The evaluator's settings in scenario.json; None: not known."""
        config = self.files.scenario.get("nodes", {}).get("evaluator", {}).get("config")
        return config if isinstance(config, dict) else None

    @cached_property
    def unsettled_frames(self) -> frozenset[int]:
        """Frames with unknown effects: around wiring changes, and the last frame."""
        if self.files.effects is None:
            return frozenset()
        return frozenset(self.files.effects["frame"][self.files.effects["effect"] == "unsettled"].tolist())

    @cached_property
    def timeline(self) -> tuple[dict[str, Any], ...]:
        """Planned faults and attacks.

        Each has label, kind, type, at_s, until_s (None: to the end), nodes and backend.
        Links that last for the whole run are not included.
        """
        planned = [each for each in self.files.scenario.get("timeline", ()) if {"label", "kind", "at_s"} <= each.keys()]
        always = [e["kind"] == "link" and e["at_s"] <= 0.0 and e.get("until_s") is None for e in planned]
        return tuple(each for each, whole in zip(planned, always, strict=True) if not whole)

    @property
    def metrics_damaged(self) -> bool:
        """Whether metrics.json is there, but cannot be read."""
        return not self.files.summary and self.files.is_damaged("metrics.json")

    @cached_property
    def notices(self) -> list[Finding]:
        """What its launcher noted at its end: losses, refusals, and parts that took part in nothing."""
        return [Finding.from_json(each) for each in self.files.record.get("notices") or ()]

    @property
    def range_m(self) -> float:
        """m, the range of the metrics."""
        return float(self._scorer.get("range_m", 100.0))

    @property
    def gate_m(self) -> float:
        """m, the gate of the metrics: a track matches a real object within this distance."""
        return float((self._scorer.get("assigner") or {}).get("gate_m", 2.0))

    @property
    def _scorer(self) -> dict[str, Any]:
        """The scorer's settings; {}: its defaults, or not known."""
        return (self.evaluator_config or {}).get("scorer") or {}

    @property
    def lost(self) -> list[dict[str, Any]]:
        """Nodes lost in lock-step without a step of the scenario, and their returns."""
        return list(self.files.record.get("churn") or ()) if self.files.record.get("mode") == "lockstep" else []

    @property
    def faulted(self) -> bool:
        """Whether links or faults are part of the run."""
        return any(each.get("kind") != "attack" for each in self.files.scenario.get("timeline", ()))

    @property
    def has_centre(self) -> bool:
        """Whether agents share a picture; otherwise each has a peer, which makes its own."""
        roles = {spec.get("role") for spec in self.files.scenario.get("nodes", {}).values()}
        return "peer" not in roles or not roles.isdisjoint(("command_center", "center"))

    def worded(self, text: str) -> str:
        """A text about the run in terms of a centre, in those of the ego and its peer if there is none."""
        if not self.has_centre:
            for central, own in _WITHOUT_CENTRE:
                text = text.replace(central, own)
        return text

    @property
    def withholds(self) -> bool:
        """Whether objects are missed because the command centre withheld them."""
        return self.files.objects is not None and bool((self.files.objects["cause"] == "withheld").any())

    @property
    def defence(self) -> str:
        """The type of the command centre's integrity stage; empty: none, or not known."""
        for spec in self.files.scenario.get("nodes", {}).values():
            value = spec
            for key in ("config", "pipeline", "integrity", "type"):
                value = value.get(key) if isinstance(value, dict) else None
            if isinstance(value, str):
                return value.rpartition(":")[2]
        return ""

    def scores_of(self, estimate: str, agent: str | None = None) -> dict[str, Any]:
        """The metrics of one estimate of an agent, by default the ego; empty: none."""
        scores: dict[str, Any] = self.files.summary.get("agents", {}).get(agent or self.ego or "", {}).get(estimate, {})
        return scores

    def original(self, estimate: str) -> str:
        """The ego's estimate that holds the boxes: this one, or the one that it equals."""
        return str(self.files.summary.get("same_as", {}).get(self.ego or "", {}).get(estimate, estimate))

    def counts_of(self, estimator: str) -> Table | None:
        """The ego's counts of one estimator, by ascending frame; None: there are none."""
        if self.files.counts is None:
            return None
        counts = self.files.counts
        selected = rows(counts, (counts["agent"] == self.ego) & (counts["estimator"] == estimator))
        order = np.argsort(selected["frame"], kind="stable")
        return {name: column[order] for name, column in selected.items()} if len(order) else None

    def seconds(self, frames: NDArray[Any]) -> Floats | None:
        """Time of frames (n,) in s since the first; None: scene absent or shorter."""
        if self.files.scene is None or not len(frames) or frames.max() >= len(self.files.scene):
            return None
        times = self.files.scene.times_ns
        return np.asarray((times[frames.astype(np.int64)] - times[0]) * 1e-9, np.float64)

    def times(self, frames: NDArray[Any]) -> Floats:
        """As `seconds`, or by the period where the scene does not say."""
        seconds = self.seconds(frames)
        return np.asarray(frames * self.period_s, np.float64) if seconds is None else seconds

    @property
    def period_s(self) -> float:
        """s from frame to frame."""
        return float(self.files.scenario.get("period_ns", 100_000_000)) * 1e-9

    # -- what its files hold now: for users, of every agent and frame; raises RunFolderError if they don't -------------

    @property
    def record(self) -> dict[str, Any]:
        """run.json: id, status, seed, versions, timings, node endings (docs/explanation-architecture.md)."""
        if self.files.is_live:
            return self.files.record
        return liveness.current_record(read_object(self._folder / "run.json"))

    @property
    def status(self) -> str:
        """`running`, `ok`, or another status (docs/explanation-architecture.md#how-a-run-ends)."""
        return str(self.record.get("status", ""))

    @property
    def seed(self) -> int:
        """The seed of all its random draws."""
        return int(self.record.get("seed", 0))

    @property
    def running(self) -> bool:
        """Whether the run is still in progress."""
        return self.status == RUNNING

    @property
    def summary(self) -> dict[str, Any]:
        """metrics.json: means and deviations over scored frames (docs/explanation-metrics-and-causes.md)."""
        return dict(self._written("metrics.json", read_json))

    @property
    def metrics(self) -> pyarrow.Table:
        """A row per frame, agent and estimator.

        Columns: fn, fp, tp (objects), rmse_m (m), id_switches, ospa_m, gospa_m (m), length_error_m, width_error_m,
        heading_error_deg, speed_error_mps, velocity_error_mps, iou_3d, scored (counts in `summary`).
        """
        return self._table("metrics.parquet")

    @property
    def objects(self) -> pyarrow.Table:
        """A row per box in range of an agent: outcome and pose, m, rad (docs/explanation-metrics-and-causes.md)."""
        return self._table("objects.parquet")

    @property
    def attacks(self) -> pyarrow.Table:
        """A row per measured effect of an interposer; may be empty (docs/explanation-metrics-and-causes.md)."""
        return self._table("attacks.parquet")

    @property
    def targets(self) -> pyarrow.Table:
        """A row per frame and object that an adversary manipulated (docs/explanation-metrics-and-causes.md)."""
        return self._table("targets.parquet")

    @property
    def driving(self) -> pyarrow.Table:
        """A row per frame, vehicle and estimate: effects on driving (docs/explanation-metrics-and-causes.md)."""
        return self._table("driving.parquet")

    @property
    def driven(self) -> pyarrow.Table:
        """A row per frame and driven car: its course (docs/explanation-metrics-and-causes.md).

        Raises RunFolderError for a run without drivers.
        """
        return self._table("driven.parquet")

    @property
    def trust(self) -> pyarrow.Table:
        """A row per frame and agent: the command centre's trust (docs/explanation-metrics-and-causes.md).

        Raises RunFolderError for a run whose command centre judges nobody.
        """
        return self._table("trust.parquet")

    @property
    def trust_objects(self) -> pyarrow.Table:
        """A row per frame and object that a judging command centre tracks, withheld or not."""
        return self._table("trust_objects.parquet")

    def messages(self, pattern: str = "*", *, taps: bool = False) -> Iterator[WireMessage]:
        """The recorded messages on the wires that a glob matches, sorted by frame.

        For example `run.messages("agent/*/tracks")`.

        taps: include the hidden legs of intercepted wires, with messages before an interposer changed them
        Raises ConfigurationError, at the end of the iteration, for a pattern that matches no wire.
        """
        none = True
        for message in decoded.messages(self._folder, pattern, taps=taps):
            none = False
            yield message
        wires = [wire["key"] for wire in json_or_empty(self._folder / "wiring.json").get("wires", ())] if none else []
        if wires and not any(fnmatchcase(wire, pattern) for wire in wires):
            raise ConfigurationError(f"{self.path}: no wire matches {pattern!r}{nearest(pattern, wires)}")

    @property
    def truth(self) -> pyarrow.Table:
        """A row per frame and object of the scene, world frame.

        Columns: frame, time_s (s), id, class, x y z (m, centre), vx vy vz (m/s), l w h (m), yaw (rad), and points, the
        lidar returns at the agent that has the most.
        """
        return decoded.table_of(self._folder, "scene/truth", decoded.truth)

    @property
    def picture(self) -> pyarrow.Table:
        """Objects of the common picture by frame: columns of `truth`, score, support."""
        common = self.wiring.find(estimate=PICTURE)
        if common is None:
            raise RunFolderError(f"{self.path}: wiring.json names no common picture")
        return decoded.table_of(self._folder, common.key, decoded.states)

    def agent(self, name: str) -> AgentMessages:
        """The agent of this name; raises ConfigurationError if there is none."""
        if name not in self.agents:
            raise ConfigurationError(f"{self.path}: no agent {name!r} in this run{nearest(name, self.agents)}")
        return AgentMessages(self._folder, name, self.wiring)

    @property
    def _folder(self) -> Path:
        if self.files.is_live:
            raise RunFolderError(f"{self.name}: is seen on its mesh, without its folder: expected a run of a folder")
        return self.path

    def _table(self, name: str) -> pyarrow.Table:
        return self._written(name, read_arrow)

    def _written(self, name: str, read: Any) -> Any:
        """Read a file that a run writes at its end; raises RunFolderError if unusable."""
        path = self._folder / name
        if not path.is_file():
            why = (
                "the run is still in progress, and writes it at its end"
                if self.running
                else f"the run is {self.status}"
            )
            raise RunFolderError(f"{path}: missing; {why}")
        try:
            return read(path)
        except (OSError, ValueError, pyarrow.ArrowException) as error:
            raise RunFolderError(f"{path}: {error}") from None


def agent_in_key(key: str) -> str | None:
    """The agent in a key such as `prefix/agent/infra_1/tracks`; None: no agent."""
    chunks = key.split("/")
    following = chunks.index("agent") + 1 if "agent" in chunks else len(chunks)
    return chunks[following] if following < len(chunks) else None


class AgentMessages:
    """The messages that one agent of a run sent and received, by frame."""

    def __init__(self, path: Path, name: str, wiring: Wiring) -> None:
        self.path = path
        self.name = name
        self._wiring = wiring

    @property
    def tracks(self) -> pyarrow.Table:
        """Tracks by frame, as the broker receives them: columns of `Run.truth`, and score."""
        return self._rows(decoded.states, estimate=LOCAL)

    @property
    def mission(self) -> pyarrow.Table:
        """Objects of the mission estimate (own tracks and picture) by frame, as `tracks`.

        Raises ConfigurationError for an agent that does not act on one, as poles do not.
        """
        if self._wiring.wires and self._wiring.find(self.name, estimate=MISSION) is None:
            others = [wire.subject for wire in self._wiring.wires if wire.traits.estimate == MISSION]
            raise ConfigurationError(
                f"{self.path}: {self.name} makes no mission estimate, as it does not act on one; found "
                f"{', '.join(others) or 'none'}: play the run with --set agents.{self.name}.acts=true"
            )
        return self._rows(decoded.states, estimate=MISSION)

    @property
    def detections(self) -> pyarrow.Table:
        """Received detections by frame, in the sensor's frame: columns of `tracks`, no id.

        `time_s` is the time of the measurement. Of several sensors: those of the first.
        """
        return self._rows(decoded.detections, message="detections")

    def detections_of(self, sensor: str) -> pyarrow.Table:
        """As `detections`, of one of several sensors. Raises ConfigurationError for a name that none has."""
        agents = {agent.name: agent for agent in Recording.open(self.path / RECORDING).agents}
        names = [each.name for each in agents[self.name].sensors]
        if sensor not in names:
            raise ConfigurationError(f"{self.name}: no sensor {sensor!r}{nearest(sensor, names)}")
        return self._rows(decoded.detections, sensor if names.index(sensor) else "", message="detections")

    @property
    def pose(self) -> pyarrow.Table:
        """A row per frame: the agent's pose and velocity in the world frame.

        Columns: x y z (m), vx vy vz (m/s) and the quaternion qw qx qy qz.
        """
        return self._rows(decoded.pose, message="pose")

    def _rows(self, rows: Any, part: str = "", *, estimate: str = "", message: str = "") -> pyarrow.Table:
        """The rows of the messages with an estimate or of a type, of the agent or of a part of it."""
        wire = self._wiring.find(subject_of(self.name, part), estimate=estimate, message=message)
        if wire is None:
            raise RunFolderError(f"{self.path}: wiring.json names no wire with {estimate or message} of {self.name}")
        return decoded.table_of(self.path, wire.key, rows)

    def __repr__(self) -> str:
        return f"<Agent {self.name}: tracks, mission, detections, pose; {self.path}>"
