"""The part `integrity` of metrics.json."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.metrics.trust.conduct import CONDUCT, FAULTY, HONEST, Conduct
from mast_zenoh.metrics.trust.history import TrustHistory

_HOUR_S = 3600.0


def summary(
    history: TrustHistory,
    conduct: Conduct,
    agents: Sequence[str],
    times_s: Floats,
    period_s: float,
    states: Sequence[str],
) -> dict[str, Any]:
    """Agents' conduct next to the trust that they had, and false alarms of the run.

    history, conduct: of (f,) frames and a `agents`;  times_s: (f,) s;  period_s: s
    states: names of the states, among them "suspended"
    """
    kind, suspended = conduct.kind, np.asarray(history.state == list(states).index("suspended"))
    of_agents = {
        agent: _of_agent(history, conduct, kind[:, index], suspended[:, index], index, times_s, period_s, states)
        for index, agent in enumerate(agents)
    }
    hours = len(times_s) * period_s / _HOUR_S
    alarms = sum(agent["false_alarms"] for agent in of_agents.values())
    confusion = {
        name: {state: round(sum(agent["seconds"][name][state] for agent in of_agents.values()), 6) for state in states}
        for name in CONDUCT
    }
    return {
        "agents": of_agents,
        "seconds": confusion,
        "honest_suspended": [name for name, agent in of_agents.items() if agent["false_alarms"]],
        "false_alarms": alarms,
        "hours": hours,
        "false_alarms_per_hour": alarms / hours if hours else None,
    }


def _of_agent(
    history: TrustHistory,
    conduct: Conduct,
    kind: np.ndarray,
    suspended: Bools,
    index: int,
    times_s: Floats,
    period_s: float,
    states: Sequence[str],
) -> dict[str, Any]:
    lies, faults = conduct.lies[:, index], conduct.faults[:, index]
    suspicion = -history.log_odds[:, index]
    judged = suspicion[np.isfinite(suspicion)]
    starts, ends = _spells(suspended)
    suspensions = [
        {
            "from_s": _at(times_s, start),
            "until_s": _at(times_s, end) if end < len(times_s) else None,
            "reason": str(history.reason[start, index]),
            "conduct": CONDUCT[kind[start]],
        }
        for start, end in zip(starts, ends, strict=True)
    ]
    first_lie_s = _first(lies, times_s)
    delay_s, observed_s = detection_delay(suspended, times_s, first_lie_s)
    return {
        "lied": bool(lies.any()),
        "first_lie_s": first_lie_s,
        "lies_s": round(int(lies.sum()) * period_s, 6),
        "faulty": bool(faults.any()),
        "first_fault_s": _first(faults, times_s),
        "faults_s": round(int(faults.sum()) * period_s, 6),
        "suspended_after_s": delay_s,
        "observed_s": observed_s,
        "suspensions": suspensions,
        "false_alarms": sum(CONDUCT[HONEST] == each["conduct"] for each in suspensions),
        "fault_alarms": sum(CONDUCT[FAULTY] == each["conduct"] for each in suspensions),
        "seconds": {
            name: {
                state: round(int(((kind == code) & (history.state[:, index] == number)).sum()) * period_s, 6)
                for number, state in enumerate(states)
            }
            for code, name in enumerate(CONDUCT)
        },
        "suspicion": {
            "max": float(judged.max()) if len(judged) else None,
            "mean": float(judged.mean()) if len(judged) else None,
        },
    }


def detection_delay(suspended: Bools, times_s: Floats, lie_s: float | None) -> tuple[float | None, float | None]:
    """Time s from a lie to the first frame in which its agent is suspended, and time s for which it was watched.

    suspended, times_s: (f,);  lie_s: s, None: no lie

    (None, t): not suspended in the t s from the lie to the end of the run, a censored delay. (None, None): no lie.
    An agent that was suspended already has a delay of 0.
    """
    if lie_s is None:
        return None, None
    after = times_s >= lie_s
    detected = after & suspended
    end_s = float(times_s[-1])
    if not detected.any():
        return None, round(end_s - lie_s, 9)
    delay_s = round(_at(times_s, int(detected.argmax())) - lie_s, 9)
    return delay_s, delay_s


def _first(events: Bools, times_s: Floats) -> float | None:
    return _at(times_s, int(events.argmax())) if events.any() else None


def _at(times_s: Floats, row: int) -> float:
    return round(float(times_s[row]), 9)


def _spells(active: Bools) -> tuple[list[int], list[int]]:
    """First rows, and rows after the last, of the periods in which something holds."""
    edges = np.diff(active.astype(np.int8), prepend=0, append=0)
    return np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist()
