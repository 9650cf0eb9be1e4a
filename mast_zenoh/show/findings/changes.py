"""Changes of a run's scores, over a reference run or by its own measurements, and which of them is the largest."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.metrics.estimates import ESTIMATES, IN_TRANSIT, LOCAL, RECEIVED
from mast_zenoh.runs.run import Run
from mast_zenoh.show.comparison import Reference

FALSE, MISSED, DISPLACED, IDENTITY = "false", "missed", "displaced", "identity"


class Error(NamedTuple):
    """A kind of error of an estimate.

    key: in metrics.json;  unit: of its amount
    metres: of matched boxes, m per unit: how far it puts a car's ends off in 1 s
    """

    key: str
    unit: str = ""
    metres: float = 0.0


#: m, half the length of a car: the arm of an error of its heading.
_ARM_M = 2.25
#: Kinds of errors.
ERRORS = {
    FALSE: Error("fp", "objects a frame"),
    MISSED: Error("fn", "objects a frame"),
    DISPLACED: Error("rmse_m", "m", 1.0),
    IDENTITY: Error("id_switches", "switches"),
    "length": Error("length_error_m", "m", 1.0),
    "width": Error("width_error_m", "m", 1.0),
    "heading": Error("heading_error_deg", "\u00b0", math.radians(_ARM_M)),
    "velocity": Error("velocity_error_mps", "m/s", 1.0),
}

#: m2, the cost of a missed or a false object in GOSPA (c = 5 m, p = 2, alpha = 2). Changes of all kinds are weighted
#: by their contribution to it, in objects per frame. An identity switch counts as a missed and a false object.
OBJECT_M2 = 12.5
SWITCH = 2.0
#: An earlier estimate with at least this share of the largest change is named instead: the change arises there.
MIN_SAME_SHARE = 0.8
#: Smallest share of a change for attacks or faults to be named as its cause; and smallest share of an attack's effect
#: for an adversary to be named.
MIN_NAMED_SHARE, MIN_CULPRIT_SHARE = 0.2, 0.05
#: Smallest share of a change of the picture in transit in the command centre's picture, or in what the agent acts on,
#: for the change to be named there instead.
MIN_TRANSFERRED_SHARE = 0.2


#: Objects per frame; smaller changes are not notable beside a larger one.
NOTHING = 0.025

#: Groups of causes that are not natural, as in `fn_split` of metrics.json.
_GROUPS = ("attack", "fault", "withheld")

#: The metrics of one estimate of one agent, as in metrics.json.
Summary = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Change:
    """A change of one kind in one estimate of one agent.

    amount: false, missed: objects per frame; identity: switches in the run; others: of the mean error, in its unit
    weight: objects per frame, see OBJECT_M2; below zero: fewer errors
    parts:  the parts of `amount` due to each group of causes, where they were measured
    by:     rows by responsible adversary; may be empty
    """

    agent: str
    estimate: str
    kind: str
    amount: float
    weight: float
    parts: Mapping[str, float] = field(default_factory=dict)
    by: Counter[str] = field(default_factory=Counter)

    def due_to(self, group: str) -> bool:
        """Whether a group of causes has a share of at least MIN_NAMED_SHARE: attack, fault or withheld."""
        return bool(self.amount) and self.parts.get(group, -math.inf) / self.amount >= MIN_NAMED_SHARE


def against(run: Run, reference: Run, agents: Iterable[str] | None = None) -> list[Change]:
    """Changes of scores over a reference run of the same scene; by default the ego's."""
    changes = []
    for agent in [run.ego or ""] if agents is None else agents:
        for estimate in ESTIMATES:
            here, there = run.scores_of(estimate, agent), reference.scores_of(estimate, agent)
            for kind, error in ERRORS.items():
                value, before = _mean(here.get(error.key)), _mean(there.get(error.key))
                if value is None or before is None:
                    continue
                weight = _weight(run, kind, here, value) - _weight(run, kind, there, before)
                parts, old = _split(here, kind), _split(there, kind)
                parts = {group: part - old.get(group, 0.0) for group, part in parts.items()}
                if kind == DISPLACED and agent == run.ego:
                    displacement = _displacement(run, estimate)[0]
                    parts = {} if displacement is None else {"attack": displacement}
                changes.append(_change(run, agent, estimate, kind, value - before, weight, parts))
    return changes


def attributed(run: Run, agents: Iterable[str] | None = None) -> list[Change]:
    """Errors of a run due to attacks, links and faults, and the defence, by its own measurements.

    Groups of causes with less than MIN_NAMED_SHARE of the errors are left out: no sentence names them.
    """
    changes = []
    for agent in [run.ego or ""] if agents is None else agents:
        for estimate in ESTIMATES:
            here = run.scores_of(estimate, agent)
            for kind in (FALSE, MISSED, IDENTITY):
                if {"attack", "fault"} <= (parts := _split(here, kind)).keys():
                    all_errors = sum(parts.values())
                    parts = {name: part for name, part in parts.items() if part >= MIN_NAMED_SHARE * all_errors}
                    amount = sum(parts.values())
                    weight = _weight(run, kind, here, amount)
                    changes.append(_change(run, agent, estimate, kind, amount, weight, parts))
            displacement_m, weight = _displacement(run, estimate) if agent == run.ego else (None, 0.0)
            if displacement_m is not None:
                parts = {"attack": displacement_m, "fault": 0.0, "withheld": 0.0}
                changes.append(_change(run, agent, estimate, DISPLACED, displacement_m, weight, parts))
    return changes


def largest(changes: Iterable[Change]) -> Change | None:
    """The largest change, in the first estimate that shows nearly all of it.

    None: no change.

    Of changes that are nearly as large, more errors come before fewer, and then what attacks caused before the others.
    A change of the picture in transit is replaced by the largest change of the command centre's picture and of what
    the agent acts on, if that is at least MIN_TRANSFERRED_SHARE of it.
    """
    changed = [change for change in changes if change.weight != 0.0]
    known = [change for change in changed if change.estimate != RECEIVED] or changed  # in transit to the fusion
    if not known:
        return None
    top = _first_alike(known)
    if top.estimate in IN_TRANSIT:
        ends = [each for each in known if each.agent == top.agent and each.estimate in ("picture", "mission")]
        if ends and max(abs(each.weight) for each in ends) >= MIN_TRANSFERRED_SHARE * abs(top.weight):
            return _first_alike(ends)
    return top


def _first_alike(changes: Sequence[Change]) -> Change:
    """The largest of some changes, in the first estimate that shows nearly all of it."""
    most = max(abs(change.weight) for change in changes)
    nearly_largest = [change for change in changes if abs(change.weight) >= MIN_SAME_SHARE * most]
    top = max(nearly_largest, key=lambda change: (change.weight > 0.0, change.due_to("attack"), abs(change.weight)))
    order = list(ESTIMATES)
    candidates = [
        change
        for change in changes
        if (change.agent, change.kind) == (top.agent, top.kind)
        and change.weight * np.sign(top.weight) >= MIN_SAME_SHARE * abs(top.weight)
    ]
    return min(candidates, key=lambda change: order.index(change.estimate))


def changes(run: Run, over: Reference | None, agents: Sequence[str] | None = None) -> list[Change]:
    """The changes over a reference or by the run's own measurements; by default the ego's."""
    return attributed(run, agents) if over is None else against(run, over.run, agents)


def largest_change(run: Run, over: Reference | None) -> Change | None:
    """The largest change for the ego, or, if only its tracks in transit changed, for all agents."""
    others = [agent for agent in run.files.summary.get("agents", {}) if agent != run.ego]
    of_ego = changes(run, over)
    scored_for_ego = largest([change for change in of_ego if change.estimate != RECEIVED])
    return scored_for_ego or largest([*of_ego, *changes(run, over, others)])


def _change(
    run: Run, agent: str, estimate: str, kind: str, amount: float, weight: float, parts: Mapping[str, float]
) -> Change:
    by = culprits(run, estimate, kind) if agent == run.ego and parts.get("attack") else Counter[str]()
    return Change(agent, estimate, kind, amount, weight, parts, by)


def culprits(run: Run, estimate: str, kind: str) -> Counter[str]:
    """Number of the ego's errors of a kind in scored frames, by responsible adversary."""
    if kind in (FALSE, MISSED) and run.files.objects is not None:
        outcome, box_kind = ("false", "track") if kind == FALSE else ("missed", "truth")
        table = run.files.objects
        selected = (
            (table["estimator"] == run.original(estimate)) & (table["outcome"] == outcome) & (table["kind"] == box_kind)
        )
        selected &= (table["by"] != "") & (table["cause"] != "withheld") & scored(run, table["frame"])
        return _names(run, table["by"][selected])
    if kind == DISPLACED and run.files.targets is not None:
        moved = np.isin(run.files.targets["kind"], ("moved", "altered")) & scored(run, run.files.targets["frame"])
        return Counter(run.files.targets["adversary"][moved].tolist())
    viewer = "ego" if estimate == "mission" else "centre"
    achieved: dict[str, Any] = run.files.summary.get("achieved", {})
    switches = {name: each.get(f"id_switches_{viewer}", 0) for name, each in achieved.items() if name != "all"}
    return Counter({name: count for name, count in switches.items() if count})


def witnesses_of_withheld(run: Run, estimate: str) -> float | None:
    """How many agents that were not suspended reported a missed object that was withheld, in the mean.

    In scored frames; None: not known
    """
    table, trust = run.files.objects, run.files.trust
    if table is None or trust is None:
        return None
    selected = (table["estimator"] == run.original(estimate)) & (table["cause"] == "withheld")
    selected &= scored(run, table["frame"])
    out = trust["state"] == "suspended"
    suspended = set(zip(trust["frame"][out].tolist(), trust["agent"][out].tolist(), strict=True))
    numbers = [
        sum((frame, name) not in suspended for name in str(names).split("+") if name)
        for frame, names in zip(table["frame"][selected].tolist(), table["by"][selected].tolist(), strict=True)
    ]
    return float(np.mean(numbers)) if numbers else None


def _names(run: Run, by: np.ndarray) -> Counter[str]:
    """How often each name is in a column `by` of the objects; as estimated, of a run of which only a sample is read."""
    counts = Counter(name for names in by.tolist() for name in str(names).split("+") if name)
    return Counter({name: count * run.files.sample.step for name, count in counts.items()})


def scored(run: Run, frames: np.ndarray) -> np.ndarray:
    """(n,) bool: which of n frames are scored."""
    first, last = run.scored_frames or (-np.inf, np.inf)
    in_range: np.ndarray = (frames >= first) & (frames <= last)
    return in_range


def _displacement(run: Run, estimate: str) -> tuple[float | None, float]:
    """The part of an RMSE due to moved and altered objects: (m, weight).

    None: not known.

    A track beyond the gate is false and not part of the RMSE. Only the error of moved objects in excess of that of
    other objects counts.
    """
    viewer = "ego" if estimate == "mission" else "centre"
    summary = run.scores_of(estimate)
    rmse, matched, frames = summary.get("rmse_m"), _mean(summary.get("tp")), _frames(run)
    if run.files.targets is None or rmse is None or not matched or not frames or estimate in (LOCAL, RECEIVED):
        return None, 0.0
    table, error = run.files.targets, np.asarray(run.files.targets[f"error_m_{viewer}"], np.float64)
    selected = np.isin(table["kind"], ("moved", "altered")) & (error <= run.gate_m) & scored(run, table["frame"])
    _, first = np.unique(
        np.column_stack([table["object"][selected], table["frame"][selected]]), axis=0, return_index=True
    )
    squared = error[selected][first] ** 2
    pairs = matched * frames
    other_pairs = pairs - len(squared)
    if not len(squared) or other_pairs <= 0:
        return (None, 0.0) if not len(squared) else (rmse, pairs * rmse**2 / frames / OBJECT_M2)
    natural = max(rmse**2 * pairs - float(squared.sum()), 0.0) / other_pairs
    excess = max(float(squared.sum()) - natural * len(squared), 0.0)
    return rmse - float(np.sqrt(max(rmse**2 - excess / pairs, 0.0))), excess / frames / OBJECT_M2


def _weight(run: Run, kind: str, summary: Summary, amount: float) -> float:
    if ERRORS[kind].metres:
        return (_mean(summary.get("tp")) or 0.0) * (amount * ERRORS[kind].metres) ** 2 / OBJECT_M2
    return amount * SWITCH / (_frames(run) or 1) if kind == IDENTITY else amount


def _frames(run: Run) -> int:
    if run.scored_frames is None:
        return int(run.files.summary.get("frames", 0))
    return run.scored_frames[1] - run.scored_frames[0] + 1


def _split(summary: Summary, kind: str) -> dict[str, float]:
    """The parts of a score due to each group of causes, where they are known."""
    split = summary.get(f"{ERRORS[kind].key}_split") or {}
    return {group: split[group] for group in _GROUPS if split.get(group) is not None}


def _mean(value: object) -> float | None:
    if isinstance(value, dict):
        value = value.get("mean")
    return float(value) if isinstance(value, (int, float)) else None
