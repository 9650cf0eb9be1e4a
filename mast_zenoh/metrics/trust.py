"""What a command centre's trust in agents and objects is worth, compared with how they behaved.

Pure: arrays in, arrays and plain dicts out. See docs/explanation-metrics-and-causes.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.scores import Table

#: How an agent behaves. An agent that is both faulty and lying is lying.
CONDUCT = ("honest", "faulty", "lying")
HONEST, FAULTY, LYING = range(3)

#: A fault of an agent: its type, and its beginning and end in s of scene time (None: the end of the run).
Fault = tuple[str, float, float | None]


@dataclass(frozen=True, slots=True, eq=False)
class Conduct:
    """How a agents behaved over f frames.

    lies:   (f, a) whether an adversary changed what the agent sent about this frame
    faults: (f, a) whether a fault acted on the agent
    lasting_frames: frames for which a lie or a fault counts after its own, because tracks outlive their objects
    """

    lies: Bools
    faults: Bools
    lasting_frames: int = 0

    @property
    def kind(self) -> NDArray[np.int64]:
        """(f, a) index into CONDUCT."""
        faulty, lying = lasting(self.faults, self.lasting_frames), lasting(self.lies, self.lasting_frames)
        return np.where(lying, LYING, np.where(faulty, FAULTY, HONEST))


def lasting(events: Bools, frames: int) -> Bools:
    """(f, a) whether an event happened in a frame or in the `frames` before it.

    events: (f, a)
    """
    index = np.arange(len(events))[:, None]
    latest = np.maximum.accumulate(np.where(events, index, -1 - frames - len(events)), axis=0)
    return np.asarray(index - latest <= frames)


def fault_frames(faults: Mapping[str, Sequence[Fault]], agents: Sequence[str], times_s: Floats) -> Bools:
    """(f, a) whether any fault acted on an agent.

    faults: by agent; times_s: (f,) s of each frame
    """
    result = np.zeros((len(times_s), len(agents)), bool)
    for index, agent in enumerate(agents):
        for _, at_s, until_s in faults.get(agent, ()):
            result[:, index] |= (times_s >= at_s) & (times_s < (np.inf if until_s is None else until_s))
    return result


#: Columns of one value per agent, and of one value per object, as in a `trust` message.
_AGENT = ("mean", "log_odds", "fault_turn", "fault_delay", "fault_loss")
_OBJECT = ("trust", "expected", "confirming", "contradicting", "withheld")


#: Columns of a `trust` message that tell the history of trust in agents.
AGENT_COLUMNS = ("agents", "state", "log_odds", "reason")


class TrustUpdate(NamedTuple):
    """A `trust` message.

    frame: its frame; columns: see `messages.schemas`
    """

    frame: int
    columns: Mapping[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class TrustHistory:
    """Trust in a agents over f frames.

    state:    (f, a) uint8, index into the names of states; 0 before the first message about an agent, then the last one
    log_odds: (f, a) that the agent is honest; NaN without a message about it
    reason:   (f, a) of the state, "" if there is none
    """

    state: NDArray[np.uint8]
    log_odds: Floats
    reason: NDArray[Any]

    @classmethod
    def of(cls, updates: Sequence[TrustUpdate], agents: Sequence[str], frames: Ints) -> TrustHistory:
        """The history that messages tell; those about other frames or agents are left out.

        frames: (f,) ascending
        """
        shape = len(frames), len(agents)
        column = {name: index for index, name in enumerate(agents)}
        row = {frame: index for index, frame in enumerate(frames.tolist())}
        state, reason = np.zeros(shape, np.uint8), np.full(shape, "", object)
        log_odds = np.full(shape, np.nan)
        for update in updates:
            if (at := row.get(update.frame)) is None:
                continue
            names, *values = (np.asarray(update.columns[name]).tolist() for name in AGENT_COLUMNS)
            for name, *of_name in zip(names, *values, strict=True):
                if (of_agent := column.get(str(name))) is not None:
                    state[at, of_agent], log_odds[at, of_agent], reason[at, of_agent] = of_name
        known = np.isfinite(log_odds)
        # Row of the latest message about each agent; frames before the first one keep the initial values.
        latest = np.maximum.accumulate(np.where(known, np.arange(shape[0])[:, None], -1), axis=0)
        before, every = latest < 0, np.arange(shape[1])
        return cls(
            np.where(before, np.uint8(0), state[latest, every]).astype(np.uint8),
            log_odds,
            np.where(before, "", reason[latest, every]),
        )


def agent_table(updates: Sequence[TrustUpdate], times_ns: Mapping[int, int], states: Sequence[str]) -> Table:
    """The columns of trust.parquet: a row per frame and agent.

    times_ns: by frame; states: their names

    Columns:
    frame: number of the frame, from 0
    time_s: of scene time
    agent: who is judged; with `/relay`, what it relays
    mean: 0 to 1, how far it is trusted
    log_odds: that it is honest
    state: `unknown`, `trusted`, `faulty`, `suspended` or `undecided`
    reason: why
    fault_offset_x, fault_offset_y: m, estimated error of its position
    fault_turn: rad, of its heading
    fault_delay: s, of its time
    fault_loss: 0 to 1, share of the frames in which nothing arrived from it
    """
    rows = _counts(updates, "mean")
    offset = _joined(updates, "fault_offset", (2,))
    state = _joined(updates, "state", ()).astype(np.int64)
    columns = {name: _joined(updates, name, ()) for name in _AGENT}
    return {
        "frame": rows,
        "time_s": _seconds(rows, times_ns),
        "agent": _text(updates, "agents"),
        "mean": columns["mean"],
        "log_odds": columns["log_odds"],
        "state": np.array([*states, ""], object)[state],
        "reason": _text(updates, "reason"),
        "fault_offset_x": offset[:, 0],
        "fault_offset_y": offset[:, 1],
        **{name: columns[name] for name in _AGENT[2:]},
    }


def object_table(updates: Sequence[TrustUpdate], times_ns: Mapping[int, int]) -> Table:
    """The columns of trust_objects.parquet: a row per frame and object that the centre tracks.

    Columns:
    frame: number of the frame, from 0
    time_s: of scene time
    id: of the object
    x, y, z: m, centre in the world
    l, w, h: m, length, width, height
    yaw: rad, heading, counter-clockwise from east
    trust: 0 to 1, that it exists
    expected, confirming, contradicting: number of agents that should see it, report it, and see through it
    withheld: whether it is left out of the picture
    """
    rows = _counts(updates, "id")
    position, size = _joined(updates, "position", (3,)), _joined(updates, "size", (3,))
    columns = {name: _joined(updates, name, ()) for name in ("id", "yaw", *_OBJECT)}
    return {
        "frame": rows,
        "time_s": _seconds(rows, times_ns),
        "id": columns["id"].astype(np.int64),
        **{axis: position[:, index] for index, axis in enumerate("xyz")},
        **{axis: size[:, index] for index, axis in enumerate("lwh")},
        "yaw": columns["yaw"],
        "trust": columns["trust"],
        **{name: columns[name].astype(np.int64) for name in ("expected", "confirming", "contradicting")},
        "withheld": columns["withheld"].astype(np.bool_),
    }


def _counts(updates: Sequence[TrustUpdate], column: str) -> Ints:
    """The frame of each row of a column, over all messages."""
    frames = np.array([update.frame for update in updates], np.int64)
    return np.repeat(frames, [len(update.columns[column]) for update in updates])


def _joined(updates: Sequence[TrustUpdate], column: str, shape: tuple[int, ...]) -> NDArray[Any]:
    return np.concatenate([np.zeros((0, *shape)), *(update.columns[column] for update in updates)])


def _text(updates: Sequence[TrustUpdate], column: str) -> NDArray[Any]:
    return np.array([str(value) for update in updates for value in update.columns[column]], object)


def _seconds(frames: Ints, times_ns: Mapping[int, int]) -> Floats:
    return np.array([times_ns.get(frame, np.nan) for frame in frames.tolist()], np.float64) * 1e-9


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
    states: names of the states, among them "suspended" and "undecided"

    Keys:
    agents: by agent, what it did and how it was judged
    seconds: by conduct (`honest`, `faulty`, `lying`) and state, summed over agents
    honest_suspended: agents that were suspended while honest
    false_alarms: how often that was
    hours: of scene time
    false_alarms_per_hour: for all agents together
    relays: of agents that relay pictures, the same for what they relay
    withheld: objects per scored frame that are withheld: `true` ones, within 2 m of one that an agent sees, and `false`
    """
    kind = conduct.kind
    of_agents = {
        agent: _of_agent(history, conduct, kind[:, index], index, times_s, period_s, states)
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
    index: int,
    times_s: Floats,
    period_s: float,
    states: Sequence[str],
) -> dict[str, Any]:
    """What one agent did, and how it was judged. index: of the agent; kind: (f,) rows of CONDUCT

    Keys:
    lied, first_lie_s, lies_s: whether and when it first lied; time with a lie
    faulty, first_fault_s, faults_s: the same of faults
    faults: types of its faults
    suspended_after_s: from the first lie to the suspension; None: never, or it was suspended already
    observed_s: for how long that was watched, also if it was never suspended; None: no lie to detect
    suspensions, undecided: periods: `from_s`, `until_s` (None: the end), `reason`, and `conduct` at the beginning
    false_alarms, fault_alarms: number of suspensions that began while it was honest, and while it was faulty
    seconds: by conduct (`honest`, `faulty`, `lying`) and state, time of the run
    suspicion: `max` and `mean` of the negative log_odds
    """
    lies, faults = conduct.lies[:, index], conduct.faults[:, index]
    suspicion = -history.log_odds[:, index]
    judged = suspicion[np.isfinite(suspicion)]
    suspended, undecided = (
        np.asarray(history.state[:, index] == list(states).index(state)) for state in ("suspended", "undecided")
    )
    suspensions, doubts = (
        [
            {
                "from_s": _at(times_s, start),
                "until_s": _at(times_s, end) if end < len(times_s) else None,
                "reason": str(history.reason[start, index]),
                "conduct": CONDUCT[kind[start]],
            }
            for start, end in zip(*_spells(in_state), strict=True)
        ]
        for in_state in (suspended, undecided)
    )
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
        "undecided": doubts,
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

    (None, t): not suspended in the t s from the lie to the end of the run, a censored delay. (None, None): no lie, or
    the agent was suspended already when it told it: that detects nothing.
    """
    if lie_s is None:
        return None, None
    after = times_s >= lie_s
    if suspended[~after][-1:].any() and suspended[after][:1].any():
        return None, None
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


@dataclass(frozen=True, slots=True, eq=False)
class Roc:
    """What each threshold detects, from the strictest to the most lenient.

    threshold:       (k,) alarms are scores of at least this; the first is inf, which nothing reaches
    false_positives: (k,) int64, number of honest ones above it
    true_positives:  (k,) int64, number of liars above it
    honest, liars:   numbers of both
    """

    threshold: Floats
    false_positives: np.ndarray
    true_positives: np.ndarray
    honest: int
    liars: int

    @property
    def false_positive_rate(self) -> Floats:
        """(k,) 0 to 1; NaN if nobody is honest."""
        return _share(self.false_positives, self.honest)

    @property
    def true_positive_rate(self) -> Floats:
        """(k,) 0 to 1; NaN if nobody lies."""
        return _share(self.true_positives, self.liars)


def roc(scores: ArrayLike, labels: ArrayLike) -> Roc:
    """The characteristic of scores, one for each agent-run.

    scores: (n,) greater is more suspicious; NaN: the agent was never judged, as if the score were -inf
    labels: (n,) bool, whether the agent lied

    Equal scores share a threshold. Raises ValueError unless both have the same length.
    """
    score = np.asarray(scores, np.float64).ravel()
    lied = np.asarray(labels, bool).ravel()
    if len(score) != len(lied):
        raise ValueError(f"labels: found {len(lied)}, expected {len(score)}, one for each score")
    score = np.where(np.isnan(score), -np.inf, score)
    order = np.argsort(-score, kind="stable")
    score, lied = score[order], lied[order]
    last = np.flatnonzero(np.append(score[1:] != score[:-1], True)) if len(score) else np.zeros(0, np.int64)
    return Roc(
        np.concatenate([[np.inf], score[last]]),
        np.concatenate([[0], np.cumsum(~lied)[last]]).astype(np.int64),
        np.concatenate([[0], np.cumsum(lied)[last]]).astype(np.int64),
        int((~lied).sum()),
        int(lied.sum()),
    )


def auc(scores: ArrayLike, labels: ArrayLike) -> float:
    """Area under the characteristic: how often a liar scores above an honest agent; ties count half.

    The parameters are those of `roc`. NaN if nobody lies or nobody is honest.
    """
    curve = roc(scores, labels)
    if not (curve.honest and curve.liars):
        return float("nan")
    return float(np.trapezoid(curve.true_positive_rate, curve.false_positive_rate))


def partial_auc(scores: ArrayLike, labels: ArrayLike, hours: float, max_rate_per_hour: float) -> float:
    """Mean share of liars detected at false-alarm rates from 0 to `max_rate_per_hour`, 0 to 1.

    hours: of all runs together, of the whole system: an honest agent above a threshold is one false alarm in these
    The other parameters are those of `roc`.

    Without data for a rate, the share at the next lower measured rate counts: nothing is interpolated, because a rate
    below one alarm in `hours` was not observed. NaN if nobody lies. Raises ValueError unless hours and rate are
    positive.
    """
    if not (hours > 0.0 and max_rate_per_hour > 0.0):
        raise ValueError(f"hours, max_rate_per_hour: found {hours}, {max_rate_per_hour}, expected more than 0")
    curve = roc(scores, labels)
    if not curve.liars:
        return float("nan")
    rate, share = curve.false_positives / hours, curve.true_positive_rate
    begins = np.minimum(rate, max_rate_per_hour)
    ends = np.append(begins[1:], max_rate_per_hour)
    return float(((ends - begins) * share).sum() / max_rate_per_hour)


def _share(counts: Sequence[int] | np.ndarray, total: int) -> Floats:
    return np.asarray(counts, np.float64) / total if total else np.full(len(counts), np.nan)


#: Periods in s: beginning and end.
Spans = list[tuple[float, float]]


@dataclass(frozen=True, slots=True, eq=False)
class AgentTrustSeries:
    """The trust in one agent over time, next to its conduct.

    time_s: (n,) s;  value: (n,) mean or log-odds
    states: by name of a state, when it was in it
    lies:   when it lied;  faults: type, beginning and end of its faults
    """

    agent: str
    time_s: Floats
    value: Floats
    states: Mapping[str, Spans]
    lies: Spans
    faults: Sequence[tuple[str, float, float]]


@dataclass(frozen=True, slots=True, eq=False)
class TrustPanel:
    """The trust of one trial over time.

    agents: those to show;  left_out: number of others;  end_s: s, of the run
    """

    title: str
    agents: Sequence[AgentTrustSeries]
    left_out: int
    end_s: float
