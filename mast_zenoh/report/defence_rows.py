"""Data of a matrix of defences: a row per cell, a characteristic per defence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from mast_zenoh.arrays.states import Floats
from mast_zenoh.metrics.trust import Roc
from mast_zenoh.report.tables.study_rows import Estimate

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
    "lies_detected": "observable lies detected (share)",
    "honest_suspended_per_hour": "honest agents suspended per hour",
    "faulty_suspended_per_hour": "faulty agents suspended per hour",
    "honest_majority": "objects with an honest majority (share)",
}


@dataclass(frozen=True, slots=True, eq=False)
class DelayCurve:
    """Share of liars not suspended yet, over the time from their first observable lie (Kaplan-Meier).

    time_s, undetected: (k,) steps; median_s: NaN if fewer than half were suspended
    """

    time_s: Floats
    undetected: Floats
    median_s: float
    detections: int
    watched: int


@dataclass(frozen=True, slots=True, eq=False)
class DefenceRow:
    """A defence against one adversary, with its most harmful budget.

    attack:    "" without one;  budget: lies per second of each adversary, None: the attack's own
    budgets:   number of budgets that were tried
    estimates: by name in MEASURES; damage is relative to no defence and no attack, with the same scene and seed
    confusion: s by conduct (honest, faulty, lying) and state of trust, over all agents and trials; {}: no trust
    delay:     until liars are suspended, over all trials; None: there was no observable lie, or no trust
    """

    defence: str
    attack: str
    n_adversaries: int
    placement: str
    budget: float | None
    budgets: int
    estimates: Mapping[str, Estimate]
    confusion: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    delay: DelayCurve | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DefenceRoc:
    """How well one defence's suspicion tells liars from honest agents, one score for each agent-run.

    partial_auc: mean share of liars detected below one false alarm per hour;  hours: of all runs together
    """

    defence: str
    roc: Roc
    auc: float
    partial_auc: float
    hours: float


@dataclass(frozen=True, slots=True, eq=False)
class DefenceMatrix:
    """The cells of a study, and a characteristic for each defence that judges agents."""

    rows: Sequence[DefenceRow]
    rocs: Sequence[DefenceRoc]
    delays: Mapping[str, DelayCurve]
    size: str

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
