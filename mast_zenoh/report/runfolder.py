"""A run folder, read for the report: whatever of it is there, and what is missing by name."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.parquet
from numpy.typing import NDArray

from mast_zenoh.errors import MastError, RunFolderError
from mast_zenoh.report.faulted import with_faults
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.states import Bools, Floats

#: A table: one array per column, all of one length.
Table = dict[str, NDArray[Any]]

_COUNTS = ("frame", "agent", "estimator", "fn", "fp", "tp", "rmse_m", "id_switches")
_OBJECTS = ("frame", "agent", "estimator", "kind", "outcome", "id", "x", "y", "z", "l", "w", "h", "yaw")
_ATTACKS = (
    *("interposer", "role", "frame", "effect"),
    *("before_x", "before_y", "before_z", "after_x", "after_y", "after_z"),
)


def rows(table: Table, mask: Bools) -> Table:
    """The rows of a table that a mask (n,) picks."""
    return {name: column[mask] for name, column in table.items()}


@dataclass(frozen=True, eq=False)
class RunFolder:
    """What a run left behind. Files that are absent or unreadable are empty here and named in `missing`.

    path:      the folder
    run:       run.json
    scenario:  scenario.json
    wiring:    wiring.json
    metrics:   metrics.json
    counts:    metrics.parquet: a row per frame, agent and estimator
    objects:   objects.parquet: a row per box; only those of the ego. `cause` where the run has told causes
    attacks:   attacks.parquet: a row per measured effect of an interposer that is no link
    recording: scene.npz
    checks:    checks.json, of runs with links or faults
    missing:   one sentence for each file that is absent or unreadable, saying what the report lacks for it
    """

    path: Path
    run: dict[str, Any]
    scenario: dict[str, Any]
    wiring: dict[str, Any]
    metrics: dict[str, Any]
    counts: Table | None
    objects: Table | None
    attacks: Table | None
    recording: Recording | None
    missing: tuple[str, ...]
    checks: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def load(cls, path: Path) -> RunFolder:
        """Read a run folder. Raises RunFolderError if it is not one (neither run.json nor scenario.json is there)."""
        if not path.is_dir():
            raise RunFolderError(f"{path}: no such folder, expected the folder of a run")
        if not (path / "run.json").is_file() and not (path / "scenario.json").is_file():
            raise RunFolderError(f"{path}: holds neither run.json nor scenario.json, expected the folder of a run")
        missing: list[str] = []

        def read(name: str, reader: Callable[[Path], Any], lack: str, default: Any) -> Any:
            try:
                return reader(path / name)
            except FileNotFoundError:
                missing.append(f"{name} is absent: {lack}.")
            except (OSError, ValueError, KeyError, MastError, pyarrow.ArrowException) as error:
                missing.append(f"{name} cannot be read ({str(error).removeprefix(f'{path / name}: ')}): {lack}.")
            return default

        run = read("run.json", _json, "how the run and its nodes ended is not known", {})
        scenario = read("scenario.json", _json, "no configuration", {})
        wiring = read("wiring.json", _json, "who sat on which wire is not known", {})
        metrics = read("metrics.json", _json, "no table of means", {})
        counts = read("metrics.parquet", _table(_COUNTS), "no counts over time", None)
        recording = read("scene.npz", _scene, "no buildings, agents and camera view in the pictures", None)
        ego = _ego(metrics, counts, recording)
        mine = [("agent", "==", ego)]
        objects = read(
            "objects.parquet", _table(_OBJECTS, mine, optional=("cause",)), "no bird's-eye and camera views", None
        )
        attacks = None
        if (path / "attacks.parquet").is_file():
            attacks = read("attacks.parquet", _effects, "what the adversaries changed is not marked", None)
        elif any(_role(run, wiring, name) == "adversary" for name in _interposers(wiring)):
            missing.append("attacks.parquet is absent: what the adversaries changed is not marked.")
        checks: dict[str, Any] = {}
        if (path / "checks.json").is_file():
            checks = read("checks.json", _json, "what was checked is not known", {})
        found = run, scenario, wiring, metrics, counts, objects, attacks, recording
        return cls(path, *found, tuple(missing), checks)

    @cached_property
    def ego(self) -> str | None:
        """The agent whose view the report shows: `ego` if there is one, else the first; None: nothing says."""
        return _ego(self.metrics, self.counts, self.recording)

    def role(self, node: str) -> str:
        """The role of a node; where run.json does not say, a guess from its wires and its name (`adversary_1`)."""
        return _role(self.run, self.wiring, node)

    @cached_property
    def adversaries(self) -> dict[str, tuple[str, ...]]:
        """The adversaries that sit on wires of an agent, by the agent's name."""
        found: dict[str, list[str]] = {}
        for wire in self.wiring.get("wires", []):
            agent = _agent_of(wire["key"])
            for node in wire.get("interposers", []):
                if agent and self.role(node) == "adversary" and node not in found.setdefault(agent, []):
                    found[agent].append(node)
        return {agent: tuple(nodes) for agent, nodes in sorted(found.items()) if nodes}

    @cached_property
    def attack_frames(self) -> tuple[int, int] | None:
        """First and last frame in which an adversary changed something; None: nothing was changed, or nobody says."""
        if self.attacks is None or not len(self.attacks["frame"]):
            return None
        return int(self.attacks["frame"].min()), int(self.attacks["frame"].max())

    @cached_property
    def timeline(self) -> tuple[dict[str, Any], ...]:
        """Faults and attacks as they were planned: label, kind, type, at_s, until_s (None: to the end), nodes, backend.

        Links that are as they are from beginning to end are not among them.
        """
        told = [each for each in self.scenario.get("timeline", ()) if {"label", "kind", "at_s"} <= each.keys()]
        always = [e["kind"] == "link" and e["at_s"] <= 0.0 and e.get("until_s") is None for e in told]
        return tuple(each for each, whole in zip(told, always, strict=True) if not whole)

    @property
    def faulted(self) -> bool:
        """Whether links or faults are part of the run."""
        return with_faults(self.scenario, self.checks)

    def counts_of(self, estimator: str) -> Table | None:
        """The ego's counts of one estimator, by ascending frame; None: there are none."""
        if self.counts is None:
            return None
        mine = rows(self.counts, (self.counts["agent"] == self.ego) & (self.counts["estimator"] == estimator))
        order = np.argsort(mine["frame"], kind="stable")
        return {name: column[order] for name, column in mine.items()} if len(order) else None

    def seconds(self, frames: NDArray[Any]) -> Floats | None:
        """Time of frames (n,) in s since the scene's first; None: the scene is not there, or shorter."""
        if self.recording is None or not len(frames) or frames.max() >= len(self.recording):
            return None
        times = self.recording.times_ns
        return np.asarray((times[frames.astype(np.int64)] - times[0]) * 1e-9, np.float64)


def _json(path: Path) -> dict[str, Any]:
    data = json.loads(path.read_text("utf-8"))
    if not isinstance(data, dict):
        raise ValueError(f"found {type(data).__name__}, expected an object")
    return data


def _scene(path: Path) -> Recording:
    if not path.is_file():
        raise FileNotFoundError(path)
    return Recording.load(path)


def _table(columns: tuple[str, ...], filters: Any = None, *, optional: tuple[str, ...] = ()) -> Callable[[Path], Table]:
    def read(path: Path) -> Table:
        table = pyarrow.parquet.read_table(path, filters=filters)
        absent = sorted(set(columns) - set(table.column_names))
        if absent:
            raise ValueError(f"found no column {', '.join(absent)}")
        there = (*columns, *(name for name in optional if name in table.column_names))
        return {name: table.column(name).to_numpy() for name in there}

    return read


def _effects(path: Path) -> Table:
    table = _table(_ATTACKS)(path)
    return rows(table, (table["role"] != "link") & (table["effect"] != "unsettled") & (table["frame"] >= 0))


def _role(run: dict[str, Any], wiring: dict[str, Any], node: str) -> str:
    told = run.get("nodes", {}).get(node, {}).get("role")
    if told:
        return str(told)
    is_agent = any(_agent_of(wire["key"]) == node for wire in wiring.get("wires", []))
    return "agent" if is_agent else node.rstrip("0123456789").rstrip("_")


def _interposers(wiring: dict[str, Any]) -> list[str]:
    return [node for wire in wiring.get("wires", []) for node in wire.get("interposers", [])]


def _agent_of(key: str) -> str | None:
    """The agent in a key expression such as `agent/infra_1/detections`, with or without a prefix."""
    chunks = key.split("/")
    place = chunks.index("agent") + 1 if "agent" in chunks else len(chunks)
    return chunks[place] if place < len(chunks) else None


def _ego(metrics: dict[str, Any], counts: Table | None, recording: Recording | None) -> str | None:
    names = list(recording.agent_names) if recording else []
    names = names or list(metrics.get("agents", {}))
    if not names and counts is not None:
        names = sorted(set(counts["agent"]))
    return "ego" if "ego" in names else (names[0] if names else None)
