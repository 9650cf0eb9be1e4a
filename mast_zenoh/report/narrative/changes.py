"""What changed in a run, of all kinds: against another run, or by what the run's own errors are due to."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.scores import ESTIMATES

FALSE, MISSED, DISPLACED, IDENTITY = "false", "missed", "displaced", "identity"
#: By kind, its key in metrics.json.
KEYS = {FALSE: "fp", MISSED: "fn", DISPLACED: "rmse_m", IDENTITY: "id_switches"}

#: m2, what GOSPA (c = 5 m, p = 2, alpha = 2) charges for a missed or a false object: changes of all kinds are weighed
#: by what they add to it, in objects per frame. A switch of identity counts as a missed and a false object.
OBJECT_M2 = 12.5
SWITCH = 2.0
#: Part of the largest change that an earlier estimate must show to be named instead: there the change arises.
SAME_CHANGE = 0.8
#: Part of a change that attacks or faults must account for to be named as its cause; and, of what is due to attacks,
#: the part that an adversary must account for.
NAMED, CULPRIT = 0.2, 0.05
#: The picture between the command centre and the agent that acts on it; part of a change of it that must show in what
#: the agent acts on, or in what the command centre believes, to be named there instead.
ON_THE_WAY = ("picture_received", "picture_on_arrival")
REACHES = 0.2


#: What metrics.json holds of one estimate of one agent.
Summary = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Change:
    """A change of one kind in one estimate of one agent.

    amount: false, missed: objects per frame; displaced: m, of the RMSE; identity: switches in the run
    weight: objects per frame, see OBJECT_M2; below zero: fewer errors
    attack, fault: the parts of `amount` that are due to attacks, and to links and faults; None: not measured
    by:     the adversaries that it is due to, with how many rows; may be empty
    """

    agent: str
    estimate: str
    kind: str
    amount: float
    weight: float
    attack: float | None = None
    fault: float | None = None
    by: Counter[str] = field(default_factory=Counter)

    @property
    def is_attack(self) -> bool:
        """Whether a part of it worth naming is due to attacks."""
        return self.attack is not None and _share(self.attack, self.amount) >= NAMED

    @property
    def is_fault(self) -> bool:
        """The same of links and faults."""
        return self.fault is not None and _share(self.fault, self.amount) >= NAMED


def against(run: RunFolder, reference: RunFolder, agents: Iterable[str] | None = None) -> list[Change]:
    """Every change of a run's scores over those of another run of the same scene; by default of the ego."""
    found = []
    for agent in agents or [run.ego or ""]:
        for estimate in ESTIMATES:
            here, there = run.summary(estimate, agent), reference.summary(estimate, agent)
            found += between(run, here, there, agent, estimate)
    return found


def between(
    run: RunFolder, here: Summary, there: Summary, agent: str | None = None, estimate: str = ""
) -> list[Change]:
    """Every change of one summary of metrics.json over another, both over as many frames."""
    found = []
    for kind, key in KEYS.items():
        one, two = _mean(here.get(key)), _mean(there.get(key))
        if one is None or two is None:
            continue
        weight = _weight(run, kind, here, one) - _weight(run, kind, there, two)
        attack, fault = (_part(here, kind, who, there) for who in ("attack", "fault"))
        if kind == DISPLACED:
            attack = _displacement(run, estimate)[0] if agent == run.ego else None
        found.append(_change(run, agent or run.ego or "", estimate, kind, (one - two, weight, attack, fault)))
    return found


def attributed(run: RunFolder, agents: Iterable[str] | None = None) -> list[Change]:
    """What of a run's errors is due to attacks and to links and faults, by its own measurements."""
    found = []
    for agent in agents or [run.ego or ""]:
        for estimate in ESTIMATES:
            here = run.summary(estimate, agent)
            for kind in (FALSE, MISSED, IDENTITY):
                attack, fault = _part(here, kind, "attack"), _part(here, kind, "fault")
                if attack is not None and fault is not None:
                    amount = attack + fault
                    found.append(
                        _change(run, agent, estimate, kind, (amount, _weight(run, kind, here, amount), attack, fault))
                    )
            metres, weight = _displacement(run, estimate) if agent == run.ego else (None, 0.0)
            if metres is not None:
                found.append(_change(run, agent, estimate, DISPLACED, (metres, weight, metres, 0.0)))
    return found


def largest(changes: Iterable[Change]) -> Change | None:
    """The largest change of any kind, in the first estimate that shows nearly all of it; None: nothing changed.

    A change of the picture on its way to an agent gives way to the largest of what the agent acts on and of what the
    command centre believes, where that is at least REACHES of it.
    """
    changed = [change for change in changes if change.weight != 0.0]
    known = [change for change in changed if change.estimate != "received"] or changed  # on its way to be fused
    if not known:
        return None
    most = _first_alike(known)
    if most.estimate in ON_THE_WAY:
        ends = [each for each in known if each.agent == most.agent and each.estimate in ("picture", "mission")]
        if ends and max(abs(each.weight) for each in ends) >= REACHES * abs(most.weight):
            return _first_alike(ends)
    return most


def _first_alike(changes: Sequence[Change]) -> Change:
    """The largest of some changes, in the first estimate that shows nearly all of it."""
    most = max(changes, key=lambda change: abs(change.weight))
    order = list(ESTIMATES)
    alike = [
        change
        for change in changes
        if (change.agent, change.kind) == (most.agent, most.kind)
        and change.weight * np.sign(most.weight) >= SAME_CHANGE * abs(most.weight)
    ]
    return min(alike, key=lambda change: order.index(change.estimate))


def largest_change(run: RunFolder, reference: RunFolder | None) -> Change | None:
    """The largest change for the ego; where there is none, the largest for another agent."""
    others = [agent for agent in run.metrics.get("agents", {}) if agent != run.ego]

    def changes(agents: list[str]) -> list[Change]:
        return attributed(run, agents) if reference is None else against(run, reference, agents)

    return largest(changes([run.ego or ""])) or (largest(changes(others)) if others else None)


def _change(
    run: RunFolder, agent: str, estimate: str, kind: str, numbers: tuple[float, float, float | None, float | None]
) -> Change:
    by = culprits(run, estimate, kind) if agent == run.ego and numbers[2] else Counter[str]()
    return Change(agent, estimate, kind, *numbers, by)


def culprits(run: RunFolder, estimate: str, kind: str) -> Counter[str]:
    """By adversary, how many of the ego's errors of a kind in the scored frames are due to it."""
    if kind in (FALSE, MISSED) and run.objects is not None and "by" in run.objects:
        outcome, what = ("false", "track") if kind == FALSE else ("missed", "truth")
        table = run.objects
        mine = (table["estimator"] == run.original(estimate)) & (table["outcome"] == outcome) & (table["kind"] == what)
        mine &= (table["by"] != "") & scored(run, table["frame"])
        return Counter(name for names in table["by"][mine].tolist() for name in str(names).split("+") if name)
    if kind == DISPLACED and run.targets is not None:
        moved = np.isin(run.targets["kind"], ("moved", "altered")) & scored(run, run.targets["frame"])
        return Counter(run.targets["adversary"][moved].tolist())
    who = "ego" if estimate == "mission" else "centre"
    achieved: dict[str, Any] = run.metrics.get("achieved", {})
    switches = {name: each.get(f"id_switches_{who}", 0) for name, each in achieved.items() if name != "all"}
    return Counter({name: count for name, count in switches.items() if count})


def scored(run: RunFolder, frames: np.ndarray) -> np.ndarray:
    """(n,) bool: which of n frames the means are over."""
    first, last = run.scored_frames or (-np.inf, np.inf)
    inside: np.ndarray = (frames >= first) & (frames <= last)
    return inside


def _displacement(run: RunFolder, estimate: str) -> tuple[float | None, float]:
    """How much of an RMSE is due to objects that adversaries moved or altered, m, and its weight; None: none is known.

    A track beyond the gate is a false one, and no part of the RMSE. Objects that nobody moved have an error too: the
    moved ones count with what they have more.
    """
    who = "ego" if estimate == "mission" else "centre"
    summary = run.summary(estimate)
    rmse, matched, frames = summary.get("rmse_m"), _mean(summary.get("tp")), _frames(run)
    if run.targets is None or rmse is None or not matched or not frames or estimate in ("local", "received"):
        return None, 0.0
    table, error = run.targets, np.asarray(run.targets[f"error_m_{who}"], np.float64)
    mine = np.isin(table["kind"], ("moved", "altered")) & (error <= run.gate_m) & scored(run, table["frame"])
    _, first = np.unique(np.column_stack([table["object"][mine], table["frame"][mine]]), axis=0, return_index=True)
    squared = error[mine][first] ** 2
    pairs = matched * frames
    others = pairs - len(squared)
    if not len(squared) or others <= 0:
        return (None, 0.0) if not len(squared) else (rmse, pairs * rmse**2 / frames / OBJECT_M2)
    natural = max(rmse**2 * pairs - float(squared.sum()), 0.0) / others
    excess = max(float(squared.sum()) - natural * len(squared), 0.0)
    return rmse - float(np.sqrt(max(rmse**2 - excess / pairs, 0.0))), excess / frames / OBJECT_M2


def _weight(run: RunFolder, kind: str, summary: Summary, amount: float) -> float:
    if kind == DISPLACED:
        return (_mean(summary.get("tp")) or 0.0) * amount**2 / OBJECT_M2
    return amount * SWITCH / (_frames(run) or 1) if kind == IDENTITY else amount


def _frames(run: RunFolder) -> int:
    if run.scored_frames is None:
        return int(run.metrics.get("frames", 0))
    return run.scored_frames[1] - run.scored_frames[0] + 1


def _part(summary: Summary, kind: str, who: str, reference: Summary | None = None) -> float | None:
    """The part of a score that is due to attacks or faults, less that in the reference; None: not measured."""
    here = (summary.get(f"{KEYS[kind]}_split") or {}).get(who)
    if reference is None or here is None:
        return here
    return float(here - ((reference.get(f"{KEYS[kind]}_split") or {}).get(who) or 0.0))


def _mean(value: object) -> float | None:
    if isinstance(value, dict):
        value = value.get("mean")
    return float(value) if isinstance(value, (int, float)) else None


def _share(part: float, whole: float) -> float:
    return part / whole if whole else 0.0
