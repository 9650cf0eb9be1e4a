"""The lies of one run: which could be noticed, which were detected, what they left in the picture, and the trust."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools
from mast_zenoh.config.resolved import RECORDING
from mast_zenoh.errors import RunFolderError
from mast_zenoh.metrics.assignment import Places, nearest
from mast_zenoh.metrics.trust import AgentTrustSeries, Spans
from mast_zenoh.run_folder.tables import from_arrow
from mast_zenoh.runs.events import trust_in_agents
from mast_zenoh.runs.observability import observability
from mast_zenoh.runs.run import Run
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.study.choices import honest_majority
from mast_zenoh.study.numbers import ego, scored_frames

#: States that the figure shows.
_DRAWN_STATES = ("faulty", "suspended", "undecided")
#: Columns of objects.parquet that are read.
_OBJECT_COLUMNS = ["frame", "agent", "estimator", "outcome", "cause", "x", "y", "z"]
#: s, from one kept value of the log-odds to the next. Spans are exact.
_STEP_S = 0.2
#: m, from a false object on the wires to the one of the command centre or of the picture that stands for it.
GATE_M = 2.0

_Columns = Mapping[str, NDArray[Any]]


def evaluate(run: Run, compromised: Sequence[str]) -> dict[str, Any]:
    """The part `defence` of a trial's metrics, from its run folder.

    compromised: names of the agents with an adversary, whether it lied or not

    The result:
    first_attack_s: s of the first message that an adversary changed; None: none, although there are adversaries
    lies:   numbers of lies: all, observable, detected (of the observable ones), see `detected_lies`
    agents: by agent that lied: s of its first lie, of the first observable one, from there to its suspension (None:
            never), and for how long it was watched (None: not at all, as it was suspended already)
    false:  false objects per scored frame in the ego's picture that adversaries inserted, where honest viewers have the
            majority (`identifiable`), and where not
    honest_majority: share of the objects that more honest agents see than compromised ones; 1.0 without adversaries
    outnumbered: share of the observable lies, by object and frame, of which liars have more viewers than honest agents;
            None: there is no observable lie
    trust:  see `trace`
    """
    seen = observability(run)
    lies = from_arrow(seen.lies)
    recording = Recording.load(run.path / RECORDING)
    return {
        "first_attack_s": _first_attack_s(run, recording),
        "lies": detected_lies(lies, *_withheld(run, lies)),
        "agents": {
            agent: {
                "first_lie_s": first_s,
                "first_observable_s": seen.first_observable_s[agent],
                "suspended_after_s": seen.suspended_after_s[agent],
                "observed_s": seen.observed_s[agent],
            }
            for agent, first_s in seen.first_lie_s.items()
        },
        "false": _false_objects(run, lies),
        "honest_majority": honest_majority(recording.points, [name in compromised for name in recording.agent_names]),
        "outnumbered": outnumbered(lies),
        "trust": trace(run),
    }


def _first_attack_s(run: Run, recording: Recording) -> float | None:
    attacks = from_arrow(run.attacks.select(["frame", "role"]))
    frames = attacks["frame"][attacks["role"] == "adversary"]
    if not len(frames):
        return None
    return round(float(recording.times_ns[int(frames.min())] - recording.times_ns[0]) * 1e-9, 9)


def outnumbered(lies: _Columns) -> float | None:
    """Share of observable rows with more lying viewers than honest ones; None without an observable row.

    lies: n rows, as in `runs.observability`

    Rows that no honest agent could notice count neither way: they contradict nobody. At a tie, nobody is outnumbered.
    """
    rows = np.asarray(lies["observable"], bool)
    more = np.asarray(lies["lying_viewers"])[rows] > np.asarray(lies["honest_viewers"])[rows]
    return float(more.mean()) if len(more) else None


def detected_lies(lies: _Columns, withheld: Bools, suspended: Bools) -> dict[str, int]:
    """Numbers of lies: all, observable, and those of them that were detected.

    lies: n rows, as in `runs.observability`;  withheld: (n,) whether the command centre withholds the object of a row
    suspended: (n,) whether it suspends its agent in that frame

    A lie is what one agent claims about one object, from its first row to its last; rows without an id are one lie for
    each agent and effect. It is observable if a row is. It is detected if, from the first observable row on, its object
    is withheld in half of the rows or more, or its agent is suspended in any. Removing an object is detected by a
    suspension alone: nothing is left to withhold.
    """
    keys = list(zip(lies["agent"].tolist(), lies["effect"].tolist(), lies["id"].tolist(), strict=True))
    number = {key: index for index, key in enumerate(dict.fromkeys(keys))}
    lie = np.array([number[key] for key in keys], np.int64)
    count = int(lie.max(initial=-1)) + 1
    first = np.full(count, np.iinfo(np.int64).max)
    rows = np.asarray(lies["observable"], bool)
    np.minimum.at(first, lie[rows], lies["frame"][rows].astype(np.int64))
    since = lies["frame"] >= first[lie]
    hidden = since & withheld & (lies["effect"] == "inserted")
    detected = 2 * np.bincount(lie[hidden], minlength=count) >= np.maximum(np.bincount(lie[since], minlength=count), 1)
    detected[lie[since & suspended]] = True
    observable = first < np.iinfo(np.int64).max
    return {"all": count, "observable": int(observable.sum()), "detected": int((detected & observable).sum())}


def _withheld(run: Run, lies: _Columns) -> tuple[Bools, Bools]:
    """(n,) whether the object of each row is withheld, and whether its agent is suspended; False without trust."""
    none = np.zeros(len(lies["frame"]), bool)
    try:
        agents, objects = from_arrow(run.trust), from_arrow(run.trust_objects)
    except RunFolderError:
        return none, none
    withheld = objects["withheld"].astype(bool)
    match, _ = nearest(Places.of_rows(lies), Places.of_rows(objects, withheld), GATE_M)
    rows = agents["state"] == "suspended"
    suspended = set(zip(agents["frame"][rows].tolist(), agents["agent"][rows].tolist(), strict=True))
    liars = zip(lies["frame"].tolist(), lies["agent"].tolist(), strict=True)
    return np.asarray(match >= 0), np.array([each in suspended for each in liars], bool)


def _false_objects(run: Run, lies: _Columns) -> dict[str, float]:
    """Inserted objects per scored frame in the ego's picture, by whether they are identifiable."""
    summary = run.files.summary
    first, last = scored_frames(summary)
    objects = from_arrow(run.objects.select(_OBJECT_COLUMNS))
    rows = (objects["agent"] == ego(summary)) & (objects["estimator"] == "picture") & (objects["outcome"] == "false")
    rows &= (objects["cause"] == "inserted") & (objects["frame"] >= first) & (objects["frame"] <= last)
    inserted = lies["effect"] == "inserted"
    match, _ = nearest(Places.of_rows(objects, rows), Places.of_rows(lies, inserted), GATE_M)
    identifiable = lies["identifiable"][inserted][match[match >= 0]]
    frames = max(last - first + 1, 1)
    count = int(identifiable.sum())
    return {"identifiable": count / frames, "unidentifiable": (int(rows.sum()) - count) / frames}


def trace(run: Run) -> dict[str, Any] | None:
    """The trust in each agent of a run, as JSON values; None: nobody is judged."""
    agents, end_s = trust_in_agents(run, _DRAWN_STATES, "log_odds")
    if not agents:
        return None
    return {"end_s": round(end_s, 6), "agents": {agent.agent: _agent_trace(agent) for agent in agents}}


def _agent_trace(agent: AgentTrustSeries) -> dict[str, Any]:
    period_s = float(np.diff(agent.time_s).min(initial=_STEP_S))
    every = max(1, round(_STEP_S / period_s)) if period_s > 0.0 else 1
    values = [None if math.isnan(value) else round(value, 2) for value in agent.value[::every].tolist()]
    return {
        "time_s": np.round(agent.time_s[::every], 3).tolist(),
        "log_odds": values,
        "states": {state: _round_spans(spans) for state, spans in agent.states.items()},
        "lies": _round_spans(agent.lies),
        "faults": [[kind, *span] for (kind, *times) in agent.faults for span in _round_spans([(times[0], times[1])])],
    }


def _round_spans(spans: Spans) -> list[list[float]]:
    return [[round(start, 3), round(stop, 3)] for start, stop in spans]
