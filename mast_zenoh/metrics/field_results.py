"""The results of the matrix of published methods: harm by scene, processor time, breakdown, published figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mast_zenoh.metrics.study_results import DefenceMatrix, Measured, Row

#: Measures of a cell, and their headings.
FIELD_MEASURES = {
    "harm": "missed and false objects, minus undefended",
    "attacked": "runs with a lie (share)",
    "honest_suspended": "runs that suspend an honest agent (share)",
    "cpu_ms": "processor time (ms per frame)",
    "cpu_ratio": "processor time, relative to undefended",
}
#: Our numbers next to published figures, and their headings.
QUANTITIES = {
    "lies_detected": "observable lies detected (share)",
    "harm_removed": "removed of what attacks add (share)",
    "honest_suspended_time": "time in which honest agents are suspended (share)",
    "median_delay_s": "median time to suspension (s)",
    "targets_suspended": "agents attacked that are suspended (share)",
    "fn_added_alone": "missed objects added per frame without an attack",
    "fp_added": "false objects added per frame",
    "damage": "missed and false objects added per frame",
    "ospa_vs_undefended_m": "OSPA, minus undefended (m)",
    "cpu_growth": "processor time, relative to the other attacks",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldBreakdown:
    """With how many adversaries a defence breaks, as in the study `breakdown`.

    scene:  its title; "" for all scenes together;  agents: in it, 0 if scenes differ
    broken: share of broken trials of all attacks, by number of adversaries
    point:  number of adversaries at which half of them are broken, interpolated; infinite: more than were tried. If
            only one number was tried, it is that one, as an upper bound, and has no interval
    weakest: the attack with the smallest point, "" if none is reached;  weakest_at: that point
    """

    scene: str
    defence: str
    agents: int
    broken: Mapping[int, Measured]
    point: Measured
    weakest: str
    weakest_at: float

    @property
    def most(self) -> int:
        """The greatest number of adversaries that was tried."""
        return max(self.broken, default=0)

    @property
    def only(self) -> int:
        """The number of adversaries that was tried, if it is the only one; otherwise 0."""
        return self.most if len(self.broken.keys() - {0}) == 1 else 0


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedNumber:
    """One of our numbers next to a published figure.

    quantity: name in QUANTITIES;  attacks: those of the runs that it is from, none: of runs without an attack
    """

    quantity: str
    defence: str
    attacks: Sequence[str]
    value: Measured


@dataclass(frozen=True, slots=True)
class Published:
    """A published figure of a method, or a method without one, and ours.

    method: our stage or attack;  source: citation
    figure: of the paper, "" if none is known;  basis: how figure and method are known
    quantities: names in QUANTITIES, nearest to the figure;  why: ours differs
    defences, attacks: names in the matrix, of which one is the method; (): all
    """

    method: str
    source: str
    figure: str
    basis: str
    quantities: tuple[str, ...]
    why: str
    defences: tuple[str, ...] = ()
    attacks: tuple[str, ...] = ()
    ours: Sequence[PublishedNumber] = ()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FieldMatrix:
    """The matrix, with what only `mast study matrix` has.

    scenes: titles of the kinds of scene, in order
    rows:   the cells of the matrix, in one kind of scene or in all (`scene` is its title, or "" for all together):
            damage:   missed and false objects added per frame, compared with no attack and no defence
            by_attack: compared with the same defence without an attack
            harm:     compared with no defence under this attack
            attacked: share of the runs in which the adversaries lied; unknown without any
            honest_suspended: share of the runs that suspend an agent while it is honest, whether anybody lied or not
            cpu_ms:   of a run, per frame
            cpu_ratio: geometric mean of the ratios to the undefended runs of one scene and seed
    summaries: what a defence is worth, besides the summaries of the matrix:
            harm_removed: share of what all attacks add to the same picture without them that the defence takes away, in
                      runs in which they took place; negative: they add more with it
            cpu_ratio_alone, cpu_ratio_attacked: relative to no defence
    """

    matrix: DefenceMatrix
    scenes: Sequence[str]
    rows: Sequence[Row]
    breakdowns: Sequence[FieldBreakdown]
    summaries: Sequence[Row]
    published: Sequence[Published]

    def row(self, scene: str, defence: str, attack: str, n_adversaries: int, placement: str) -> Row:
        """The row of a cell; raises KeyError if there is none."""
        key = (scene, defence, attack, n_adversaries, placement)
        for row in self.rows:
            if tuple(row.of.values()) == key:
                return row
        raise KeyError(key)
