"""What the command centre's trust was worth: metrics and tables of a run with `trust` messages. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.evaluation.effects import Effects
from mast_zenoh.evaluation.estimate_wires import Influences
from mast_zenoh.fusion.pipelines.heard import RELAY
from mast_zenoh.integrity import STATES
from mast_zenoh.metrics import Table
from mast_zenoh.metrics.assignment import Places, nearest
from mast_zenoh.metrics.record import TruthTable
from mast_zenoh.metrics.trust import (
    Conduct,
    Fault,
    TrustHistory,
    TrustUpdate,
    agent_table,
    fault_frames,
    lasting,
    object_table,
    summary,
)

#: m, in the bird's-eye view, from an object of the centre to the real object that it stands for.
GATE_M = 2.0


def lies(
    effects: Effects,
    roles: Mapping[str, str],
    agents: Sequence[str],
    frames: Ints,
    no_lie: Bools,
    influences: Influences,
) -> Bools:
    """(f, a) whether an interposer other than a link changed what an agent said about a frame.

    effects: as measured on the wires;  roles: of the nodes;  frames: (f,);  no_lie: (n,) effects that do not count
    """
    result = np.zeros((len(frames), len(agents)), bool)
    counts = ~no_lie
    counts[effects.rows("unsettled")] = False
    about = np.where(effects.frame >= 0, effects.frame, effects.step)
    for index, passage in enumerate(effects.passages):
        known = influences.of(passage)
        agent = known.speaker(passage.wire) if known else ""
        if roles.get(passage.node) != "link" and agent in agents:
            changed = about[counts & (effects.passage == index)]
            result[:, list(agents).index(agent)] |= np.isin(frames, changed)
    return result


def integrity(
    updates: Sequence[TrustUpdate],
    lied: Bools,
    faults: Mapping[str, Sequence[Fault]],
    agents: Sequence[str],
    frames: Ints,
    times_ns: Mapping[int, int],
    period_s: float,
    lasting_s: float,
    deceived: Bools | None = None,
) -> dict[str, Any]:
    """The part `integrity` of metrics.json, without withheld objects.

    lied: (f, a) as from `lies`;  faults: by agent;  lasting_s: s for which a lie or a fault counts
    deceived: (f, a) whether an agent's picture has an error that an adversary caused; None: agents do not relay theirs
    """
    times_s = np.array([times_ns.get(frame, 0) for frame in frames.tolist()], np.float64) * 1e-9
    conduct = Conduct(lied, fault_frames(faults, agents, times_s), round(lasting_s / period_s))
    part = summary(TrustHistory.of(updates, agents, frames), conduct, agents, times_s, period_s, STATES)
    for agent, kinds in ((agent, {kind for kind, _, _ in faults.get(agent, ())}) for agent in agents):
        part["agents"][agent]["faults"] = sorted(kinds)
    if deceived is not None:
        history = TrustHistory.of(updates, [f"{agent}{RELAY}" for agent in agents], frames)
        judged = np.isfinite(history.log_odds).any(axis=0)
        was_deceived = lasting(deceived, conduct.lasting_frames)  # as a lie lasts: evidence is summed over time
        of_judged = {agents[index]: was_deceived[:, index] for index in np.flatnonzero(judged).tolist()}
        of_run = summary(history, conduct, agents, times_s, period_s, STATES)
        part["relays"] = _relays(of_run, of_judged, times_s)
    return part


def _relays(of_run: Mapping[str, Any], deceived: Mapping[str, Bools], times_s: Floats) -> dict[str, Any]:
    """How what agents relay was judged.

    of_run: the summary, with the conduct of the agents
    deceived: by agent that was judged, (f,) whether its picture was wrong because of an adversary, not long before
    """
    relays = {
        agent: {name: of_run["agents"][agent][name] for name in ("suspensions", "undecided", "false_alarms", "seconds")}
        for agent in deceived
    }
    for agent, relay in relays.items():
        for period in (*relay["suspensions"], *relay["undecided"]):
            # A peer judges what it heard in the frame before.
            row = int(np.searchsorted(times_s, period["from_s"] - 1e-6)) - 1
            period["deceived"] = bool(deceived[agent][max(row, 0)])
    return {
        "agents": relays,
        "honest_suspended": [agent for agent, relay in relays.items() if relay["false_alarms"]],
        "false_alarms": sum(relay["false_alarms"] for relay in relays.values()),
    }


def withheld(objects: Table, truth: TruthTable, frames: Ints, scored: slice, min_points: int) -> tuple[int, int]:
    """Numbers of withheld objects that were true and false, in the scored frames.

    objects: as from `object_table`;  truth: of (f,) frames;  min_points: lidar points from which an object is seen

    An object is true if it is within GATE_M of one that an agent sees.
    """
    counted = frames[scored]
    of_frame = np.searchsorted(frames, objects["frame"])
    rows = np.flatnonzero(objects["withheld"] & np.isin(objects["frame"], counted))
    position: Floats = np.column_stack([objects[axis][rows] for axis in "xyz"])
    seen = truth.seen >= min_points
    real = Places(truth.boxes.group[seen], truth.boxes.position[seen])
    match, _ = nearest(Places(of_frame[rows], position), real, GATE_M)
    true = int((match >= 0).sum())
    return true, len(rows) - true


def tables(updates: Sequence[TrustUpdate], times_ns: Mapping[int, int]) -> dict[str, Table]:
    """The tables trust and trust_objects."""
    return {
        "trust": agent_table(updates, times_ns, STATES),
        "trust_objects": object_table(updates, times_ns),
    }
