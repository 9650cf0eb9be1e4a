"""The trust of a run by frame and agent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.metrics.scores import Table

#: Columns of one value per agent, and of one value per object, as in a `trust` message.
_AGENT = ("mean", "log_odds", "fault_turn", "fault_delay", "fault_loss")
_OBJECT = ("trust", "expected", "confirming", "contradicting", "withheld")


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
            names, *values = (
                np.asarray(update.columns[name]).tolist() for name in ("agents", "state", "log_odds", "reason")
            )
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
    """The columns of trust_objects.parquet: a row per frame and object that the centre tracks."""
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
