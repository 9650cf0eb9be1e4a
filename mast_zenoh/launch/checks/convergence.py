"""Checks that the picture converges to the reference picture: that of the same run without links and faults."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.config.resolved import RECORDING, Resolved
from mast_zenoh.launch.checks.evidence import Check, RunEvidence
from mast_zenoh.mesh.host import Outgoing
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Message
from mast_zenoh.metrics import Boxes, SetDistance
from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.wiring import insertion
from mast_zenoh.wiring.model import Wiring

NAME = "convergence"

#: OSPA with c = 5 m and p = 1: of n objects, a missing one costs 5 / n m, one that is 1 m off 1 / n m.
DISTANCE = SetDistance(c=5.0, p=1.0)
#: m; pictures closer than this count as the same: at most one object of ten is missing or false.
THRESHOLD_M = 0.5
#: s; a run that ends sooner after its last heal is too short to judge.
ENOUGH_S = 2.0
#: Roles of nodes whose messages nothing depends on.
_OBSERVERS = ("recorder", "evaluator", "visualizer")

_cache: tuple[str, dict[int, Floats]] = ("", {})


def check_convergence(evidence: RunEvidence) -> Check:
    """Check that the picture is close to that without links and faults at the end.

    converged_after_s is the time from the last heal until the distance stays below the threshold. The check is skipped
    if nothing was healed, if a fault or a link with its own rules lasts to the end, and if an adversary or a
    coordinator was restarted, because it then chooses its targets again.
    """
    heals = evidence.heals_s()
    reason = _undefined(evidence)
    if not heals and not reason:
        return Check.skipped(NAME, "no fault was healed")
    picture = evidence.wiring.find(estimate=PICTURE)
    if picture is None:
        return Check.skipped(NAME, "there is no common picture")
    expected = pictures(evidence.resolved, evidence.folder)
    actual = {message.frame: message.content for message in evidence.sent.get(picture.key, ())}
    frames = np.array([frame for frame in sorted(expected) if frame in evidence.times_ns], np.int64)
    if not evidence.lockstep and actual:
        frames = frames[frames <= max(actual)]  # messages in transit are lost at the end of the run
    if len(frames) == 0:
        return Check.skipped(NAME, "there is no picture to compare")
    distance = distance_between(expected, actual, frames)
    times_s = np.array([evidence.times_ns[int(frame)] for frame in frames]) * 1e-9
    values = {
        "checked": not reason,
        "threshold_m": THRESHOLD_M,
        "greatest_m": round(float(distance.max()), 4),
        "last_m": round(float(distance[-1]), 4),
        "converged_after_s": None,
    }
    if reason:
        return Check(NAME, True, f"not required: {reason}; the distance was {distance[-1]:.2f} m at the end", values)
    after_s = converged_after(distance, times_s, heals[-1])
    left_s = float(times_s[-1]) - heals[-1]
    if after_s is not None:
        values["converged_after_s"] = round(after_s, 4)
        return Check(NAME, True, f"{after_s:.1f} s after the last heal the picture is as without faults", values)
    summary = f"the distance is {distance[-1]:.2f} m at the end, {left_s:.1f} s after the last heal"
    if left_s < ENOUGH_S:
        return Check(NAME, True, f"no time to converge: {summary}; the check needs {ENOUGH_S:g} s", values)
    return Check(NAME, False, f"the picture has not converged: {summary}, expected less than {THRESHOLD_M:g} m", values)


def _undefined(evidence: RunEvidence) -> str | None:
    """Why the pictures need not become equal."""
    if faults := evidence.open_faults():
        return f"{', '.join(faults)} lasts to the end"
    resolved = evidence.resolved
    for name, spec in resolved.nodes.items():
        rules = [*spec.config.get("rules_up", ()), *spec.config.get("rules_down", ())] if spec.role == "link" else []
        if any(rule.get("until") is None for rule in rules):
            return f"{name} has rules that last to the end"
    for step in resolved.steps:
        if resolved.nodes[step.node].role in ("adversary", "coordinator"):
            return f"{step.node} chose its targets again"
    return None


def distance_between(expected: dict[int, Floats], actual: dict[int, Floats], frames: Ints) -> Floats:
    """(frames,) m, OSPA between two pictures; a missing picture counts as empty."""
    ospa, _ = DISTANCE.of(_boxes(expected, frames), _boxes(actual, frames), len(frames))
    return ospa


def converged_after(distance: Floats, times_s: Floats, heal_s: float) -> float | None:
    """s from the heal until the distance stays below the threshold; None: never."""
    above = np.flatnonzero(distance >= THRESHOLD_M)
    if len(above) == 0:
        return 0.0
    first = int(above[-1]) + 1
    return None if first == len(distance) else max(0.0, float(times_s[first]) - heal_s)


def _boxes(positions: dict[int, Floats], frames: Ints) -> Boxes:
    parts = [positions.get(int(frame), np.zeros((0, 3))) for frame in frames]
    position = np.concatenate([np.zeros((0, 3)), *parts])
    n = len(position)
    group = np.repeat(np.arange(len(frames)), [len(part) for part in parts])
    return Boxes(group, np.arange(n), position, np.ones((n, 3)), np.zeros(n))


def without_faults(resolved: Resolved) -> Resolved:
    """The scenario in lock-step, without links and faults, whatever inserted the links.

    Recorders, evaluators and visualizers are removed, too, unless something other than links is before them alone.
    """
    wiring = Wiring.from_json(resolved.wiring)
    links = {name for name, spec in resolved.nodes.items() if spec.role == "link"}
    kept = {
        branch.subscriber.node
        for wire in wiring.wires
        for branch in wire.branches
        if not all(leg.publisher.node in links for leg in branch.legs)
    }
    observers = {name for name, spec in resolved.nodes.items() if spec.role in _OBSERVERS}
    removed = links | (observers - kept)
    nodes = {name: spec for name, spec in resolved.nodes.items() if name not in removed}
    wiring = insertion.never_inserted(wiring, removed)
    return replace(resolved, nodes=nodes, wiring=wiring.to_json(), mode="lockstep", steps=(), timeline=(), network={})


def pictures(resolved: Resolved, folder: Path) -> dict[int, Floats]:
    """(n, 3) m, world frame: positions of the reference picture's objects by frame.

    folder: the run folder, which holds the scene
    """
    global _cache
    reference = without_faults(resolved)
    content = json.dumps([reference.to_json(), reference.wiring], sort_keys=True, default=str)
    digest = hashlib.blake2b(content.encode()).hexdigest()

    def with_scene(value: Any) -> Any:
        return str(folder / RECORDING) if isinstance(value, str) and value == RECORDING else value

    if _cache[0] != digest:
        _cache = digest, _run(reference.with_values(with_scene))
    return _cache[1]


def _run(resolved: Resolved) -> dict[int, Floats]:
    positions: dict[int, Floats] = {}
    common = Wiring.from_json(resolved.wiring).find(estimate=PICTURE)
    key = common.key if common else ""

    def tap(outgoing: Outgoing) -> None:
        if outgoing.key == key:
            message = (
                outgoing.payload if isinstance(outgoing.payload, Message) else codec.decode(outgoing.payload, "picture")
            )
            positions[message.header.frame] = message.body["position"].copy()

    resolved.load_modules()
    InProcess(resolved, tap=tap).run()
    return positions
