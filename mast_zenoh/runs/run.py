"""One model of a run: its record as tables, with a list of missing files.

Figures, films, pages and the Python interface read it. `frame` has the frames of a run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import pyarrow
from numpy.typing import NDArray
from pyarrow import parquet

from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.errors import ConfigurationError, MastError, RunFolderError, nearest
from mast_zenoh.launch import liveness
from mast_zenoh.launch.measurement import recorded_wirings
from mast_zenoh.metrics.estimates import LOCAL, MISSION
from mast_zenoh.metrics.record import Series
from mast_zenoh.run_folder import check_plain, read_object
from mast_zenoh.run_folder.tables import from_arrow, read_arrow, read_groups
from mast_zenoh.scenario.driving import driver_of_car
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.runs import routes
from mast_zenoh.wiring.model import Wiring

#: A table: one array per column, all of one length.
Table = dict[str, NDArray[Any]]

_COUNTS = ("frame", "agent", "estimator", "fn", "fp", "tp", "rmse_m", "id_switches")
_OBJECTS = (
    *("frame", "agent", "estimator", "kind", "outcome", "id", "match_id"),
    *("x", "y", "z", "l", "w", "h", "yaw", "cause", "by"),
)
_TARGETS = (
    *("adversary", "kind", "object", "frame", "x", "y", "seen_by_others"),
    *("believed_centre", "judged_centre", "error_m_centre", "believed_ego", "judged_ego", "error_m_ego"),
)
_TRUST = ("frame", "time_s", "agent", "mean", "log_odds", "state", "reason")
_JUDGED = ("frame", "id", "x", "y", "z", "l", "w", "h", "yaw", "withheld")
_EFFECTS = (
    *("interposer", "role", "wire", "message", "before_subscriber", "frame", "effect"),
    *("before_x", "before_y", "before_z", "after_x", "after_y", "after_z"),
)
#: What distinguishes effects.
_KINDS = ("interposer", "wire", "message", "before_subscriber", "effect")
_DRIVING = ("frame", "agent", "estimate", "false", "missed", "ttc_s", "brake", "needless", "omitted")
_DRIVEN = ("agent", "frame", "time_s", "x", "y", "heading", "speed_mps", "acceleration_mps2", "brake")


#: Frames whose boxes and manipulations are in memory, at most: of a longer run, those of every n-th frame.
MOST_FRAMES = 3000


class Sample(NamedTuple):
    """Which frames of a run are in memory with their boxes and manipulations: every n-th from `first` to before `end`.

    The first n frames of a sample without `end` are before `first`: of a run, every n-th frame is in it.
    """

    every: int = 1
    first: int = 0
    end: int | None = None

    @classmethod
    def of(cls, frames: int, wanted: int | None = None) -> Sample:
        """The sample of a run of so many frames; wanted: a frame that is in it."""
        every = max(1, -(-frames // MOST_FRAMES))
        return cls(every, (wanted or 0) % every)

    def has(self, frames: NDArray[Any]) -> Bools:
        """(n,) bool: which of n frames are in the sample."""
        inside = (frames - self.first) % self.every == 0
        return np.asarray(inside if self.end is None else inside & (frames >= self.first) & (frames < self.end))

    @property
    def span(self) -> tuple[float, float]:
        """The first and the last frame."""
        return (self.first, self.end - 1) if self.end is not None else (-np.inf, np.inf)


#: All frames.
ALL = Sample()


def rows(table: Table, mask: Bools) -> Table:
    """The rows of a table selected by a mask (n,)."""
    return {name: column[mask] for name, column in table.items()}


def driven_table(path: Path) -> Table:
    """The columns of a driven.parquet that pictures show. Raises ValueError or OSError if it is missing or damaged."""
    return _table(_DRIVEN)(path)


def column(table: Table, name: str) -> NDArray[np.float64]:
    """A column as numbers."""
    return np.asarray(table[name], np.float64)


#: What texts call a centre and its picture, and what they are in a run without one, in which the ego's are shown.
_WITHOUT_CENTRE = (
    ("the common picture", "the picture of the ego"),
    ("The common picture", "The picture of the ego"),
    ("the command centre", "the ego peer"),
    ("The command centre", "The ego peer"),
)


@dataclass(frozen=True, eq=False)
class RunRecord:
    """The contents of a run folder.

    Absent and unreadable files are empty and listed in `missing`.

    path:      the folder
    run:       run.json
    scenario:  scenario.json
    wiring:    wiring.json
    metrics:   metrics.json
    counts:    metrics.parquet: a row per frame, agent and estimator
    sample:    the frames of which `objects` and `trust_objects` have rows
    objects:   objects.parquet: a row per box; only those of the ego
    effects:   attacks.parquet: a row per measured effect of an interposer; of a frame that is not in the sample, a row
               for all effects of a kind of an interposer on a wire
    recording: scene.npz
    missing:   one sentence for each file that is absent or unreadable, saying what the report lacks without it
    checks:    checks.json, of runs with checks
    targets:   targets.parquet: a row per manipulated object and frame
    driving:   driving.parquet: a row per frame, vehicle and estimate
    driven:    driven.parquet: a row per frame and driven car
    results:   by node, the names of its files under results/
    trust, trust_objects: trust.parquet, trust_objects.parquet: of a command centre that judges agents
    viewer:    the agent whose boxes these are, if not those of the main agent
    """

    path: Path
    run: dict[str, Any]
    scenario: dict[str, Any]
    wiring: dict[str, Any]
    metrics: dict[str, Any]
    counts: Table | None
    objects: Table | None
    effects: Table | None
    recording: Recording | None
    checks: dict[str, Any] = field(default_factory=dict)
    targets: Table | None = None
    driving: Table | None = None
    driven: Table | None = None
    results: tuple[tuple[str, tuple[str, ...]], ...] = ()
    trust: Table | None = None
    trust_objects: Table | None = None
    viewer: str = ""
    sample: Sample = ALL
    missing: list[str] = field(default_factory=list)

    @classmethod
    def load(cls, path: Path, frame: int | None = None) -> Self:
        """Read a run folder; raises RunFolderError if it is not a run folder.

        frame: of a run that is so long that only every n-th frame is read whole: one of them
        """
        if not path.is_dir():
            raise RunFolderError(f"{path}: no such folder, expected the folder of a run")
        if not (path / "run.json").is_file() and not (path / "scenario.json").is_file():
            raise RunFolderError(f"{path}: holds neither run.json nor scenario.json, expected the folder of a run")
        reader = _Reader(path)
        read, optional = reader.read, reader.read_optional
        run = read("run.json", _json_object, "how the run and its nodes ended is not known", {})
        scenario = read("scenario.json", _json_object, "no configuration", {})
        wiring = read("wiring.json", _json_object, "the nodes on each wire are not known", {})
        metrics = read("metrics.json", _json_object, "no table of means", {})
        counts = read("metrics.parquet", _counts, "no counts over time", None)
        played = metrics.get("frames") or run.get("frames")
        sample = Sample.of(played if isinstance(played, int) else 0, frame)
        lost = "no buildings, agents and camera view in the pictures"
        recording = read("scene.npz", partial(_scene, sweeps=sample.every == 1), lost, None)
        objects = _table(_OBJECTS, _ego(metrics, counts, recording) or "", sample=sample)
        boxes = read("objects.parquet", objects, "no outcomes of objects, no bird's-eye and camera views", None)
        intercepted = any(wire.get("interposers") for wire in wiring.get("wires", ()))
        changes = "what interposers changed is not marked"
        effects = (read if intercepted else optional)("attacks.parquet", _effects(sample), changes, None)
        if metrics and "achieved" not in metrics and effects is not None:
            reader.missing.append("metrics.json has no achievements: what attacks achieved is not known.")
        checks = optional("checks.json", _json_object, "what was checked is not known", {})

        def of(metric: str, name: str, columns: Callable[[Path], Table], consequence: str) -> Table | None:
            """A table that the evaluator writes only for runs to which it applies."""
            table: Table | None = (read if metrics.get(metric) else optional)(name, columns, consequence, None)
            return table

        return cls(
            path=path,
            run=liveness.current_record(run),
            scenario=scenario,
            wiring=wiring,
            metrics=metrics,
            counts=counts,
            objects=boxes,
            effects=effects,
            recording=recording,
            checks=checks,
            targets=of("achieved", "targets.parquet", _table(_TARGETS), "what attacks achieved is not explained"),
            driving=of("driving", "driving.parquet", _table(_DRIVING), "no chart of driving"),
            driven=of("driven", "driven.parquet", _table(_DRIVEN), "the course of driven cars is not shown"),
            results=_node_results(path / "results"),
            trust=of("integrity", "trust.parquet", _table(_TRUST), "trust in agents is not shown"),
            trust_objects=of(
                "integrity", "trust_objects.parquet", _table(_JUDGED, sample=sample), "withheld objects are not shown"
            ),
            sample=sample,
            missing=reader.missing,
        )

    def read_objects(self) -> Any:
        """Objects.parquet, of every agent and the frames in the sample, as an Arrow table.

        Raises OSError, RunFolderError or ArrowException if it is missing, broken or too large when unpacked.
        """
        path, sample = self.path / "objects.parquet", self.sample
        return read_arrow(path) if sample == ALL else read_arrow(path, sample.has, sample.span)

    def window(self, first: int, end: int, *, boxes: bool = False) -> Self:
        """The same run with the tables of all frames from `first` to before `end`; boxes: also `objects`."""
        sample = Sample(1, first, end)
        objects, judged = self.objects, self.trust_objects
        if boxes:
            objects = _table(_OBJECTS, self.ego or "", sample=sample)(self.path / "objects.parquet")
            judged = judged and _table(_JUDGED, sample=sample)(self.path / "trust_objects.parquet")
        effects = self.effects and _effects(sample)(self.path / "attacks.parquet")
        counts = self.counts and rows(self.counts, sample.has(self.counts["frame"]))
        return replace(self, sample=sample, effects=effects, counts=counts, objects=objects, trust_objects=judged)

    @property
    def origin(self) -> Floats:
        """(3,) m, of the local planes of the run: x and y, and 0.

        What has 32 bits, or is a map projection, is relative to it. Raises ValueError or TypeError if it is damaged.
        """
        x, y = self.scenario.get("origin") or (0.0, 0.0)
        return np.array([x, y, 0.0])

    @cached_property
    def wirings(self) -> Sequence[tuple[int, Wiring]]:
        """The wirings that the run had, each with the frame after which it holds; the first one with -1.

        Raises RunFolderError if one cannot be read.
        """
        return recorded_wirings(self.path)

    @cached_property
    def agents(self) -> tuple[str, ...]:
        """The agents by the wirings, the main one first: nodes that send tracks which a broker collates."""
        names = dict.fromkeys(
            wire.legs[0].publisher.node
            for _, wiring in self.wirings
            for wire in wiring.wires
            if wire.message == "tracks" and wire.legs[0].publisher.port == "tracks" and wire.subject
        )
        return tuple(sorted(names, key=lambda name: name != "ego"))

    @cached_property
    def topics(self) -> Mapping[Series, str]:
        """By series of objects, its key expression: the truth first, then the pictures, then those of each agent."""
        topics: dict[Series, str] = {}
        for _, wiring in self.wirings:
            topics |= routes.topics(wiring, self.agents)
        return routes.in_order(topics, self.agents)

    @property
    def id(self) -> str:
        """The run's own id."""
        return str(self.run.get("id") or self.path.name)

    @cached_property
    def label(self) -> str:
        """The name of the run."""
        return str(self.run.get("name") or self.run.get("id") or self.path.name)

    @cached_property
    def ego(self) -> str | None:
        """The agent whose view the report shows: `ego` or else the first; None: unknown."""
        return self.viewer or _ego(self.metrics, self.counts, self.recording)

    def seen_by(self, agent: str) -> Self:
        """The same run with another agent in the place of the ego.

        Raises ConfigurationError if the run has no such agent.
        """
        known = self.known_agents
        if agent not in known:
            raise ConfigurationError(f"{self.path}: no agent {agent!r} in this run{nearest(agent, known)}")
        if agent == self.ego:
            return self
        reader = _Reader(self.path)
        table = _table(_OBJECTS, agent, sample=self.sample)
        objects = reader.read("objects.parquet", table, "no bird's-eye and camera views", None)
        return replace(self, objects=objects, viewer=agent)

    @property
    def known_agents(self) -> list[str]:
        """The agents of the scene, or else those with metrics."""
        return list(self.recording.agent_names) if self.recording else list(self.metrics.get("agents", ()))

    def node_spec(self, node: str) -> dict[str, Any]:
        """A node in scenario.json; of a replay's played node, the recorded one."""
        spec = dict(self.scenario.get("nodes", {}).get(node, {}))
        recorded = (spec.get("config") or {}).get("recorded")
        return spec | recorded if self.run.get("replay") and isinstance(recorded, dict) else spec

    @property
    def believed(self) -> str | None:
        """The estimate of the agent that its driver believes; None: nobody drives its car, or by the truth."""
        config = self.node_spec(driver_of_car(self.ego)).get("config") if self.ego else None
        if not isinstance(config, dict):
            return None
        return {"safety": LOCAL, "mission": MISSION}.get(str(config.get("estimate", "mission")))

    def role(self, node: str) -> str:
        """The role of a node, from run.json or guessed from its wires and name."""
        known = self.run.get("nodes", {}).get(node, {}).get("role")
        known = known or self.metrics.get("interposers", {}).get(node, {}).get("role")
        if known:
            return str(known)
        is_agent = any(agent_of(wire["key"]) == node for wire in self.wiring.get("wires", []))
        return "agent" if is_agent else node.rstrip("0123456789").rstrip("_")

    @cached_property
    def attacks(self) -> Table | None:
        """Effects of interposers other than links, in known frames; None: not measured."""
        if self.effects is None:
            return None
        settled = (self.effects["effect"] != "unsettled") & (self.effects["frame"] >= 0)
        return rows(self.effects, settled & (self.effects["role"] != "link"))

    @cached_property
    def attack_frames(self) -> tuple[int, int] | None:
        """First and last frame with a change by an adversary; None: none, or not measured."""
        if self.attacks is None or not len(self.attacks["frame"]):
            return None
        return int(self.attacks["frame"].min()), int(self.attacks["frame"].max())

    @cached_property
    def scored_frames(self) -> tuple[int, int] | None:
        """First and last scored frame, over which means are taken; None: not known."""
        frames = self.metrics.get("scored_frames")
        return (int(frames[0]), int(frames[-1])) if frames else None

    @property
    def evaluator_config(self) -> dict[str, Any] | None:
        """The evaluator's settings in scenario.json; None: not known."""
        config = self.scenario.get("nodes", {}).get("evaluator", {}).get("config")
        return config if isinstance(config, dict) else None

    @cached_property
    def unsettled_frames(self) -> frozenset[int]:
        """Frames with unknown effects: around wiring changes, and the last frame."""
        if self.effects is None:
            return frozenset()
        return frozenset(self.effects["frame"][self.effects["effect"] == "unsettled"].tolist())

    @cached_property
    def timeline(self) -> tuple[dict[str, Any], ...]:
        """Planned faults and attacks.

        Each has label, kind, type, at_s, until_s (None: to the end), nodes and backend.
        Links that last for the whole run are not included.
        """
        planned = [each for each in self.scenario.get("timeline", ()) if {"label", "kind", "at_s"} <= each.keys()]
        always = [e["kind"] == "link" and e["at_s"] <= 0.0 and e.get("until_s") is None for e in planned]
        return tuple(each for each, whole in zip(planned, always, strict=True) if not whole)

    @property
    def metrics_damaged(self) -> bool:
        """Whether metrics.json is there, but cannot be read."""
        return any(sentence.startswith("metrics.json cannot be read") for sentence in self.missing)

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
        return list(self.run.get("churn") or ()) if self.run.get("mode") == "lockstep" else []

    @property
    def faulted(self) -> bool:
        """Whether links or faults are part of the run."""
        return any(each.get("kind") != "attack" for each in self.scenario.get("timeline", ()))

    @property
    def has_centre(self) -> bool:
        """Whether agents share a picture; otherwise each has a peer, which makes its own."""
        roles = {spec.get("role") for spec in self.scenario.get("nodes", {}).values()}
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
        return self.objects is not None and bool((self.objects["cause"] == "withheld").any())

    @property
    def defence(self) -> str:
        """The type of the command centre's integrity stage; empty: none, or not known."""
        for spec in self.scenario.get("nodes", {}).values():
            value = spec
            for key in ("config", "pipeline", "integrity", "type"):
                value = value.get(key) if isinstance(value, dict) else None
            if isinstance(value, str):
                return value.rpartition(":")[2]
        return ""

    def summary(self, estimate: str, agent: str | None = None) -> dict[str, Any]:
        """The metrics of one estimate of an agent, by default the ego; empty: none."""
        scores: dict[str, Any] = self.metrics.get("agents", {}).get(agent or self.ego or "", {}).get(estimate, {})
        return scores

    def original(self, estimate: str) -> str:
        """The ego's estimate that holds the boxes: this one, or the one that it equals."""
        return str(self.metrics.get("same_as", {}).get(self.ego or "", {}).get(estimate, estimate))

    def counts_of(self, estimator: str) -> Table | None:
        """The ego's counts of one estimator, by ascending frame; None: there are none."""
        if self.counts is None:
            return None
        selected = rows(self.counts, (self.counts["agent"] == self.ego) & (self.counts["estimator"] == estimator))
        order = np.argsort(selected["frame"], kind="stable")
        return {name: column[order] for name, column in selected.items()} if len(order) else None

    def seconds(self, frames: NDArray[Any]) -> Floats | None:
        """Time of frames (n,) in s since the first; None: scene absent or shorter."""
        if self.recording is None or not len(frames) or frames.max() >= len(self.recording):
            return None
        times = self.recording.times_ns
        return np.asarray((times[frames.astype(np.int64)] - times[0]) * 1e-9, np.float64)

    @property
    def period_s(self) -> float:
        """s from frame to frame."""
        return float(self.scenario.get("period_ns", 100_000_000)) * 1e-9


def agent_of(key: str) -> str | None:
    """The agent in a key such as `prefix/agent/infra_1/tracks`; None: no agent."""
    chunks = key.split("/")
    following = chunks.index("agent") + 1 if "agent" in chunks else len(chunks)
    return chunks[following] if following < len(chunks) else None


def _ego(metrics: dict[str, Any], counts: Table | None, recording: Recording | None) -> str | None:
    names = list(recording.agent_names) if recording else []
    names = names or list(metrics.get("agents", {}))
    if not names and counts is not None:
        names = sorted(set(counts["agent"]))
    return "ego" if "ego" in names else (names[0] if names else None)


class _Reader:
    """Reads files of a folder.

    missing: absent and unreadable files, one sentence each
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.missing: list[str] = []

    def read(self, name: str, reader: Callable[[Path], Any], consequence: str, default: Any) -> Any:
        """Read a file; returns `default` on failure, with its `consequence` in `missing`."""
        path = self.folder / name
        try:
            return reader(path)
        except FileNotFoundError:
            self.missing.append(f"{name} is absent: {consequence}.")
        except (OSError, ValueError, KeyError, MastError, pyarrow.ArrowException) as error:
            reason = str(error).removeprefix(f"{path}: ")
            self.missing.append(f"{name} cannot be read ({reason}): {consequence}.")
        return default

    def read_optional(self, name: str, reader: Callable[[Path], Any], consequence: str, default: Any) -> Any:
        """Like `read`, for a file that not every run has: its absence is not reported."""
        return self.read(name, reader, consequence, default) if (self.folder / name).is_file() else default


def _json_object(path: Path) -> dict[str, Any]:
    """A JSON file that holds an object."""
    path.lstat()  # raises FileNotFoundError
    return read_object(path)


def _scene(path: Path, *, sweeps: bool) -> Recording:
    """The recorded scene; sweeps: with those of the sensors."""
    return Recording.load(check_plain(path), sweeps=sweeps)


def _counts(path: Path) -> Table:
    """The counts of metrics.parquet."""
    table = _table(_COUNTS)(path)
    if any(np.isnan(column(table, name)).any() for name in ("fn", "fp", "tp", "id_switches")):
        raise ValueError("found missing counts, expected a number in every row")
    return table


def _table(columns: tuple[str, ...], agent: str = "", *, sample: Sample = ALL) -> Callable[[Path], Table]:
    """A reader of columns of a Parquet table, for one agent if given, and for the frames in a sample."""

    def read(path: Path) -> Table:
        if sample != ALL:
            parts = read_groups(path, *columns, keep=sample.has, span=sample.span)
            return _joined(path, columns, (rows(part, part["agent"] == agent) if agent else part for part in parts))
        content = read_arrow(path)
        if missing := sorted(set(columns) - set(content.column_names)):
            raise ValueError(f"found no column {', '.join(missing)}")
        own: Any = from_arrow(content.select(["agent"]))["agent"] == agent if agent else slice(None)
        return from_arrow(content.select(columns), own)

    return read


def _effects(sample: Sample) -> Callable[[Path], Table]:
    """A reader of attacks.parquet, see `RunRecord.effects`."""
    if sample.every == 1:
        return _table(_EFFECTS, sample=sample)

    def wanted(part: Table) -> Table:
        kinds = [np.unique(part[name], return_inverse=True)[1] for name in _KINDS]
        first = np.unique(np.column_stack([part["frame"], *kinds]), axis=0, return_index=True)[1]
        mask = sample.has(part["frame"])
        mask[first] = True
        return rows(part, mask)

    return lambda path: _joined(path, _EFFECTS, map(wanted, read_groups(path, *_EFFECTS)))


def _joined(path: Path, columns: tuple[str, ...], parts: Iterable[Table]) -> Table:
    """Parts of a long table, which is never in memory as a whole."""
    content = parquet.read_schema(check_plain(path)).empty_table()
    if missing := sorted(set(columns) - set(content.column_names)):
        raise ValueError(f"found no column {', '.join(missing)}")
    tables = [from_arrow(content.select(columns)), *parts]
    return {name: np.concatenate([table[name] for table in tables]) for name in columns}


def _node_results(folder: Path) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """The names of each node's files in results/<node>/."""
    if not folder.is_dir():
        return ()
    nodes = sorted(path for path in folder.iterdir() if path.is_dir())
    return tuple((path.name, tuple(sorted(file.name for file in path.iterdir()))) for path in nodes)
