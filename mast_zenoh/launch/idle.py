"""Parts of a scenario that took part in nothing, and why.

They are measured: from the wiring, the effects on the wires, the scene and the recorded scores. What a node counts
itself is given as a reason only.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh.attacks.campaign import COUNTS
from mast_zenoh.config import registry
from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.errors import nearest
from mast_zenoh.evaluation.estimate_wires import estimates_on
from mast_zenoh.integrity import Integrity
from mast_zenoh.mesh.control.results import EVALUATOR
from mast_zenoh.metrics import Metric
from mast_zenoh.metrics.estimates import LOCAL
from mast_zenoh.metrics.measures import label_of
from mast_zenoh.run_folder.finding import Finding
from mast_zenoh.scenario.timeline import DIRECTED, acts_at, attack_starts
from mast_zenoh.scenes.recording import SEEN_RETURNS, Recording
from mast_zenoh.wiring.model import Wiring, agent_of, link_of

#: An attack that changes nothing on purpose.
_INERT_ATTACK = "PassThrough"
#: What adversaries publish besides the messages that they forward.
_OWN_MESSAGES = ("attack_report", "observation")


def idle_parts(
    resolved: Resolved,
    frames: int,
    handed_in: Mapping[str, Mapping[str, Any]],
    folder: Path,
    *,
    replayed: bool = False,
) -> list[Finding]:
    """A finding for each part of a run that took part in nothing.

    frames: number of frames played;  handed_in: what each node returned from `finish`
    folder: of the run, with its tables;  replayed: then of its metrics alone, as all else was played
    """
    run = _EndedRun(resolved, frames, handed_in, folder)
    found: list[Finding] = []
    if frames and not replayed:
        found += [*resolved.idle, *_adversaries(run), *_coordinators(run), *_defences(run)]
        found += [*_vetoes(run), *_links(run), *_faults(run), *_estimates(run), *_sensors(run), *_agents(run)]
    if frames or replayed:
        found += _metrics(run)
    return list(dict.fromkeys(found))


@dataclass(frozen=True)
class _EndedRun:
    """A run that is over."""

    resolved: Resolved
    frames: int
    handed_in: Mapping[str, Mapping[str, Any]]
    folder: Path

    @cached_property
    def wiring(self) -> Wiring:
        return Wiring.from_json(self.resolved.wiring)

    @cached_property
    def metrics(self) -> Mapping[str, Any]:
        """Of metrics.json; {} with a user's evaluator that returns something else."""
        metrics = self.handed_in.get(EVALUATOR, {}).get("metrics")
        return metrics if isinstance(metrics, Mapping) and isinstance(metrics.get("interposers"), Mapping) else {}

    @property
    def duration_s(self) -> float:
        """s of scene time from the first frame to the last."""
        return (self.frames - 1) * self.resolved.period_ns * 1e-9

    def of_role(self, role: str) -> dict[str, NodeSpec]:
        """The nodes of a role, by name."""
        return {name: spec for name, spec in self.resolved.nodes.items() if spec.role == role}

    def leads(self, sources: Collection[str], ends: Collection[str], message: str = "") -> bool:
        """Whether a wire leads from one of some nodes to one of others. message: its type; empty: any"""
        return any(
            wire.legs[0].publisher.node in sources and any(end.node in ends for end in wire.subscribers)
            for wire in self.wiring.wires
            if message in ("", wire.message)
        )

    def table(self, name: str, *columns: str) -> Iterator[Mapping[str, np.ndarray]]:
        """Some columns of a table of the evaluator, one row group after the other; none if it does not have them."""
        from mast_zenoh.run_folder.tables import TableFile  # loads Arrow

        table = TableFile(self.folder / f"{name}.parquet")
        with suppress(FileNotFoundError):
            if set(columns) <= set(table.columns):
                yield from table.parts(columns)


def _adversaries(run: _EndedRun) -> Iterator[Finding]:
    """Adversaries on no wire, and those that changed no message."""
    starts = {name: start for (_, start), names in attack_starts(run.resolved.nodes).items() for name in names}
    for name, spec in run.of_role("adversary").items():
        wires = [wire.key for wire in run.wiring.wires if name in wire.interposers]
        attack = spec.config.get("attack")
        kind = attack.get("type") if isinstance(attack, Mapping) else None
        if not wires:
            published = [wire for wire in run.wiring.wires if wire.legs[0].publisher.node == name]
            if all(wire.message in _OWN_MESSAGES for wire in published):
                yield Finding("idle", (name,), "no wire")
            continue
        measured = run.metrics.get("interposers", {}).get(name)
        if kind == _INERT_ATTACK or not isinstance(measured, Mapping):
            continue
        where = ", ".join(wires)
        if not measured.get("messages"):
            yield Finding("idle", (name,), "no message", where=where)
        elif not set(measured.get("effects", ())) - {"unsettled"}:
            reason = _why_unchanged(run, name, str(kind), starts.get(name))
            yield replace(reason, who=(name,), what="no change", where=where)


def _why_unchanged(run: _EndedRun, name: str, kind: str, start_s: float | None) -> Finding:
    """Why an adversary changed nothing, as far as that is known: `cause`, and when it begins, and the run ends."""
    begins = [] if start_s is None else [start_s]
    if kind == DIRECTED:
        directing = [other for other in run.of_role("coordinator") if run.leads([other], [name], "directive")]
        if not directing:
            return Finding("idle", cause=("no coordinator",))
        plan = run.resolved.nodes[directing[0]].config.get("coordination")
        if isinstance(plan, Mapping) and isinstance(plan.get("start_s"), (int, float)):
            begins.append(float(plan["start_s"]))
    if begins and max(begins) > run.duration_s:
        return Finding("idle", value=max(begins), other=run.duration_s, unit="s", cause=("late",))
    counts = run.handed_in.get(name, {})
    if type(counts.get("scans")) is int:
        left = [Finding("count", (why,), value=n) for why, n in counts.items() if why != "scans" and type(n) is int]
        hidden = [each.interposers for each in run.wiring.wires if name in each.interposers and counts.get("no_sight")]
        before = dict.fromkeys(other for nodes in hidden for other in nodes[: nodes.index(name)])
        return Finding("idle", value=counts["scans"], unit="scans", cause=("scans", *before), parts=tuple(left))
    chosen = [counts[name] for name in COUNTS if type(counts.get(name)) is int]
    return Finding("idle", cause=("no target",) if chosen and not any(chosen) else ())


def _coordinators(run: _EndedRun) -> Iterator[Finding]:
    """Coordinators to which no adversary reports, or that direct none."""
    adversaries = run.of_role("adversary")
    for name in run.of_role("coordinator"):
        why = ""
        if not adversaries:
            why = "none"
        elif run.resolved.nodes[name].config.get("adversaries") in ([], ()):
            why = "empty list"
        elif not run.leads(adversaries, [name]) or not run.leads([name], adversaries):
            why = "no wire"
        if why:
            yield Finding("idle", (name,), "no adversary", cause=(why,))


def _defences(run: _EndedRun) -> Iterator[Finding]:
    """Integrity stages that no view reaches, or that never had two agents to compare."""
    for name, spec in run.of_role("command_center").items():
        pipeline = spec.config.get("pipeline")
        stage = pipeline.get("integrity") if isinstance(pipeline, Mapping) else None
        kind = stage.get("type") if isinstance(stage, Mapping) else None
        cls = registry.known_types(Integrity).get(str(kind))
        yield from _trusted_strangers(run, stage)
        if cls is None or not getattr(cls, "needs_views", True):
            continue
        if not any(
            wire.message == "views" and any(end.node == name for end in wire.subscribers) for wire in run.wiring.wires
        ):
            yield Finding("idle", (str(kind), name), "no views")
        elif run.resolved.recording is not None and not _seen_by_two(run.resolved.recording, run.frames):
            yield Finding("idle", (str(kind),), "one viewer")


def _trusted_strangers(run: _EndedRun, stage: Any) -> Iterator[Finding]:
    """Agents that an integrity stage, or the one in it, compares all others with, and that do not exist."""
    if not isinstance(stage, Mapping):
        return
    kind, agents = str(stage.get("type")), run.of_role("agent")
    ego = stage.get("ego", getattr(registry.known_types(Integrity).get(kind), "ego", None))
    if isinstance(ego, str) and ego not in agents:
        yield Finding("idle", (kind, ego), "stranger", cause=(nearest(ego, agents),))
    yield from _trusted_strangers(run, stage.get("stage"))


def _vetoes(run: _EndedRun) -> Iterator[Finding]:
    """Drivers whose own sensors can refute nothing."""
    recording = run.resolved.recording
    if recording is not None and not len(recording.buildings):
        for name, spec in run.of_role("driver").items():
            if spec.config.get("veto"):
                yield Finding("idle", (name,), "no buildings")


def _seen_by_two(recording: Recording, frames: int) -> bool:
    """Whether an object was seen by two agents in one of the first frames."""
    rows = recording.truth_start[min(frames, len(recording))]
    return bool(((recording.points[:rows] >= SEEN_RETURNS).sum(axis=1) >= 2).any())


def _links(run: _EndedRun) -> Iterator[Finding]:
    """Links that received no message."""
    for name in run.of_role("link"):
        measured = run.metrics.get("interposers", {}).get(name)
        if isinstance(measured, Mapping) and not measured.get("messages"):
            yield Finding("idle", (name,), "no message")


def _faults(run: _EndedRun) -> Iterator[Finding]:
    """Faults on links that changed no message in their time, and rules of links that changed none.

    A profile that changes no message is a good link. In lock-step alone: in real time, delays of less than a frame are
    not measured as effects.
    """
    if run.resolved.mode != "lockstep" or not run.metrics:
        return
    frames: dict[str, set[int]] = {}  # by interposer, those in which it had an effect
    for rows in run.table("attacks", "interposer", "frame", "effect"):
        settled = rows["effect"] != "unsettled"
        for interposer in np.unique(rows["interposer"][settled]).tolist():
            affected = np.unique(rows["frame"][settled & (rows["interposer"] == interposer)])
            frames.setdefault(str(interposer), set()).update(affected.tolist())
    for band in run.resolved.timeline:
        if band["kind"] == "attack" or band["backend"] != "links" or band["at_s"] > run.duration_s:
            continue
        nodes = {link_of(place) for place in band["nodes"]} & run.of_role("link").keys()
        times_s = [frame * run.resolved.period_ns * 1e-9 for node in nodes for frame in frames.get(node, ())]
        if not nodes or acts_at(band, np.array(times_s)).any():
            continue
        if band["kind"] == "link":
            configs = [run.resolved.nodes[node].config for node in nodes]
            ruled = any(rules for each in configs for name, rules in each.items() if name.startswith("rules_"))
            if band["type"] == "rules" and ruled:
                yield Finding("idle", tuple(band["nodes"]), "link rules")
        else:
            until_s = run.duration_s if band["until_s"] is None else band["until_s"]
            yield Finding("idle", (band["label"],), "fault", when=(band["at_s"], until_s))


def _estimates(run: _EndedRun) -> Iterator[Finding]:
    """Estimates on wires that are no agent's, and are not scored."""
    scored = {each.wire.key for each in estimates_on(run.wiring, run.of_role("agent"))}
    for wire in run.wiring.wires:
        name, subject = wire.traits.estimate, agent_of(wire.subject)
        if name and wire.key not in scored and subject not in run.of_role("center"):
            yield Finding("idle", (subject, wire.key), "not scored", where=name)


def _sensors(run: _EndedRun) -> Iterator[Finding]:
    """Sensors whose detections are empty in all frames."""
    recording = run.resolved.recording
    if recording is None:
        return
    names = recording.sensor_names
    end = min(run.frames, len(recording)) * len(names)
    counts = np.diff(recording.detection_start[: end + 1]).reshape(-1, len(names)).sum(axis=0)
    lone = {agent.name for agent in recording.agents if len(agent.sensors) == 1}
    for name, count in zip(names, counts, strict=True):
        agent = name.partition("/")[0]
        if not count and agent in run.resolved.nodes:
            yield Finding("idle", (agent if agent in lone else name,), "no detections")


def _agents(run: _EndedRun) -> Iterator[Finding]:
    """Agents without a track of their own, in runs that last long enough for tracks to begin."""
    if run.metrics.get("settled") is not True:
        return
    tracked: dict[str, bool] = {}
    for rows in run.table("metrics", "agent", "estimator", "tp", "fp"):
        own = rows["estimator"].astype(str) == LOCAL
        for agent in dict.fromkeys(rows["agent"][own].tolist()):
            of_agent = own & (rows["agent"].astype(str) == agent)
            tracked[agent] = tracked.get(agent, False) or bool((rows["tp"][of_agent] + rows["fp"][of_agent]).any())
    yield from (Finding("idle", (agent,), "no tracks") for agent, any_ in tracked.items() if not any_)


def _metrics(run: _EndedRun) -> Iterator[Finding]:
    """The user's metrics that have no value in some estimates."""
    config = run.resolved.nodes[EVALUATOR].config.get("metrics", ()) if EVALUATOR in run.resolved.nodes else ()
    types = registry.known_types(Metric)
    summaries = run.metrics.get("agents", {})
    for spec in config if isinstance(config, (list, tuple)) else ():
        cls = types.get(str(spec.get("type"))) if isinstance(spec, Mapping) else None
        label = None if cls is None else label_of(cls)
        values = [each[label] for agent in summaries.values() for each in agent.values() if label in each]
        known = [(value.get("mean") if isinstance(value, Mapping) else value) is not None for value in values]
        if not all(known):
            yield Finding("idle", (str(label),), "no value", known.count(False), len(known), "estimates")
