"""Data of the studies of limits: delays until a displaced object is noticed, and where a defence breaks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mast_zenoh.report.defence_rows import Measured


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftRow:
    """Displaced objects of one offset or drift, in view of a number of honest agents.

    viewers:  "2", "2 or more"; "" for whole runs: s from the first lie to the suspension, regardless of viewers
    episodes, detected, trials: numbers of displaced objects, of suspensions among them, and of runs with any
    delay_s:  median until the suspension (Kaplan-Meier)
    floor_s:  of the least delay that is possible with as many witnesses;  ratio: median delay in floors
    offset_m: median offset reached before the suspension;  floor_m: offset at the floor
    within:   share of the `judged` runs in which the liar was suspended within the limit
    noticed:  the same from all episodes (Kaplan-Meier), shorter ones included; unknown if all end before the limit
    """

    label: str
    offset_m: float
    rate_mps: float | None
    viewers: str
    episodes: int
    detected: int
    trials: int
    delay_s: Measured
    floor_s: float
    ratio: Measured
    offset_reached_m: Measured
    floor_m: float
    judged: int
    within: Measured
    noticed: Measured


@dataclass(frozen=True, slots=True)
class DriftTable:
    """All rows; limit_s: of the share detected in time;  size: seeds and scenes."""

    rows: Sequence[DriftRow]
    limit_s: float
    size: str


@dataclass(frozen=True, slots=True, kw_only=True)
class BreakdownRow:
    """Trials of one number of liars among a number of agents.

    broken:    share of trials in which the defence broke: `worse`, the picture is worse than the ego alone, or
               `honest_first`, an honest agent is suspended before any liar, and not without liars
    honest_suspended: mean share of the honest agents that are suspended at any time
    honest_majority:  share of objects that more honest agents see than liars
    """

    attack: str
    agents: int
    liars: int
    trials: int
    broken: Measured
    worse: Measured
    honest_first: Measured
    honest_suspended: float
    honest_majority: float

    @property
    def share(self) -> float:
        """Share of liars among all agents."""
        return self.liars / self.agents


@dataclass(frozen=True, slots=True, kw_only=True)
class BreakdownPoint:
    """Shares of liars, infinite if not reached with up to `most` (a share, too).

    point: smallest at which half of the trials are broken;  bound: at which half of the objects have no honest majority
    difference: point minus bound
    """

    attack: str
    agents: int
    point: Measured
    bound: Measured
    difference: Measured
    most: float


@dataclass(frozen=True, slots=True)
class BreakdownTable:
    """All rows, and the points by (attack, agents);  size: seeds and scenes."""

    rows: Sequence[BreakdownRow]
    points: Mapping[tuple[str, int], BreakdownPoint]
    size: str
