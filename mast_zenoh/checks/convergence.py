"""Checks that the picture converges to the picture of a run without faults."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.checks import reference
from mast_zenoh.checks.base import Check
from mast_zenoh.checks.evidence import Evidence
from mast_zenoh.metrics import Boxes, SetDistance

NAME = "convergence"

#: OSPA with c = 5 m and p = 1: of n objects, a missing one costs 5 / n m, one that is 1 m off 1 / n m.
DISTANCE = SetDistance(c=5.0, p=1.0)
#: m; pictures closer than this count as the same: at most one object of ten is missing or false.
THRESHOLD_M = 0.5
#: s; a run that ends sooner after its last heal is too short to judge.
ENOUGH_S = 2.0


def check_convergence(evidence: Evidence) -> Check:
    """Check that the picture is close to that without links and faults at the end.

    converged_after_s is the time from the last heal until the distance stays below the threshold. The check is skipped
    if nothing was healed, if a fault or a link with its own rules lasts to the end, and if an adversary or a
    coordinator was restarted, because it then chooses its targets again.
    """
    heals = evidence.heals_s()
    reason = _undefined(evidence)
    if not heals and not reason:
        return Check.skipped(NAME, "no fault was healed")
    expected = reference.pictures(evidence.resolved, evidence.folder)
    actual = {message.frame: message.content for message in evidence.sent.get(reference.PICTURE, ())}
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


def _undefined(evidence: Evidence) -> str | None:
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
