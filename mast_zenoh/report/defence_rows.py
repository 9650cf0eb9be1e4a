"""Data of a matrix of defences: a row per cell, a characteristic and a summary per defence."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from mast_zenoh.arrays.states import Floats
from mast_zenoh.metrics.trust import Roc
from mast_zenoh.report.trust_facts import AgentTrustSeries

NAN = float("nan")
#: How intervals were computed, see `study.defences.intervals`.
BOOTSTRAP, POISSON, BINOMIAL = "bootstrap over trials", "exact Poisson", "exact binomial"

#: Measures of a cell, and their headings. Objects are counted per frame in the ego's picture.
MEASURES = {
    "damage": "missed and false objects added",
    "fn_added": "FN added",
    "fp_added": "FP added",
    "ospa_added_m": "OSPA added (m)",
    "fn_vs_undefended": "FN, minus undefended",
    "fp_vs_undefended": "FP, minus undefended",
    "ospa_vs_undefended_m": "OSPA, minus undefended (m)",
    "fp_identifiable": "false objects inserted, identifiable",
    "fp_unidentifiable": "false objects inserted, not identifiable",
    "identifiable_removed": "identifiable false objects removed (share)",
    "lies_detected": "observable lies detected (share)",
    "median_delay_s": "median delay (s)",
    "honest_suspended_per_hour": "honest agents suspended per hour",
    "faulty_suspended_per_hour": "faulty agents suspended per hour",
    "wrongly_suspended": "runs without lies that suspend an agent (share)",
    "framed": "runs in which an honest agent is framed (share)",
    "framed_by_minority": "framed, liars below the local majority (share)",
    "framed_by_majority": "framed, liars in the local majority (share)",
    "honest_majority": "objects with an honest majority (share)",
}


class Measured(NamedTuple):
    """A number over trials with its 95 % interval. NaN: unknown; infinite: beyond what was watched.

    trials:   number of trials behind it;  left_out: of those without it, because they failed or have no value
    interval: one of BOOTSTRAP, POISSON, BINOMIAL
    """

    value: float = NAN
    low: float = NAN
    high: float = NAN
    trials: int = 0
    left_out: int = 0
    interval: str = ""

    @property
    def known(self) -> bool:
        """Whether there is a value, infinite or not."""
        return not math.isnan(self.value)

    @property
    def differs_from_zero(self) -> bool:
        """Whether the interval does not contain 0."""
        return self.low > 0.0 or self.high < 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Survival:
    """Kaplan-Meier estimate (1958, JASA 53:457) of the share that is not detected yet.

    time_s:     (k,) s, ascending, beginning with 0; the last is the longest time observed
    undetected: (k,) share, 0 to 1, from that time on
    detections, watched: numbers of detections, and of all that were watched
    """

    time_s: Floats
    undetected: Floats
    detections: int
    watched: int

    @property
    def median_s(self) -> float:
        """s until half are detected; NaN if fewer were, as far as they were watched."""
        below = self.undetected <= 0.5
        return float(self.time_s[below.argmax()]) if below.any() else float("nan")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DefenceRow:
    """A defence against one adversary, with its most harmful budget.

    attack:    "" without one;  budget: lies per second of each adversary, None: the attack's own
    budgets:   number of budgets that were tried
    measures:  by name in MEASURES; damage is relative to no defence and no attack, with the same scene and seed
    state_seconds: s by conduct (honest, faulty, lying) and state of trust, over all agents and trials; {}: no trust
    delay:     until liars are suspended, over all trials; None: there was no observable lie, or no trust
    """

    defence: str
    attack: str
    n_adversaries: int
    placement: str
    budget: float | None
    budgets: int
    measures: Mapping[str, Measured]
    state_seconds: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    delay: Survival | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DefenceRoc:
    """How well one defence's suspicion tells liars from honest agents, one score for each agent-run.

    partial_auc: mean share of liars detected below one false alarm per hour;  hours: of all runs together
    """

    defence: str
    roc: Roc
    auc: Measured
    partial_auc: Measured
    hours: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DefenceSummary:
    """What one defence is worth, over all rows of the matrix.

    lies_detected, identifiable_removed: shares, over all runs under attack;  median_delay_s: of all liars
    alarms_per_hour: suspensions of honest agents in runs without an attack, of `frames` frames together
    fn_added, fp_added: objects per frame without an attack
    faults_suspended: share of the runs with faults alone that suspend an agent
    framed_by_minority: share of the runs in which an honest agent is framed by liars below the local majority
    """

    defence: str
    lies_detected: Measured
    identifiable_removed: Measured
    median_delay_s: Measured
    alarms_per_hour: Measured
    frames: int
    fn_added: Measured
    fp_added: Measured
    faults_suspended: Measured
    framed_by_minority: Measured


@dataclass(frozen=True, slots=True, eq=False)
class TrustPanel:
    """The trust of one trial over time.

    agents: those to show;  left_out: number of others;  end_s: s, of the run
    """

    title: str
    agents: Sequence[AgentTrustSeries]
    left_out: int
    end_s: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DefenceMatrix:
    """The cells of a study, and a characteristic and a summary for each defence that judges agents.

    state_shares: by defence, conduct and state of trust, the share of the time with this conduct, over all cells
    panels: the trust of single trials;  unshown: number of pairs of a defence and an adversary without a panel
    """

    rows: Sequence[DefenceRow]
    rocs: Sequence[DefenceRoc]
    delays: Mapping[str, Survival]
    summaries: Sequence[DefenceSummary]
    size: str
    state_shares: Mapping[str, Mapping[str, Mapping[str, Measured]]] = field(default_factory=dict)
    panels: Sequence[TrustPanel] = ()
    unshown: int = 0

    def names(self, key: str) -> list[object]:
        """The values of an attribute in order of appearance, without those of runs without an attack."""
        rows = [row for row in self.rows if row.attack or key == "defence"]
        return list(dict.fromkeys(getattr(row, key) for row in rows))

    def row(self, defence: object, attack: object, n_adversaries: object, placement: object) -> DefenceRow | None:
        """The row of a cell; None if there is none. Without adversaries, it is the same for every attack."""
        for row in self.rows:
            if row.defence == defence and (row.n_adversaries == n_adversaries == 0):
                return row
            if (row.defence, row.attack, row.n_adversaries, row.placement) == (
                defence,
                attack,
                n_adversaries,
                placement,
            ):
                return row
        return None
