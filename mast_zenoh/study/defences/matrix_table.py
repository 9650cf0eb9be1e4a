"""What a matrix of defences is, from which its tables and figures are made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mast_zenoh.metrics.study_results import Row
from mast_zenoh.metrics.trust import Roc, TrustPanel
from mast_zenoh.study.statistics import Survival

#: Measures of a cell, and their headings. Objects are counted per frame in the ego's picture.
DEFENCE_MEASURES = {
    "damage": "missed and false objects added",
    "fn_added": "FN added",
    "fp_added": "FP added",
    "ospa_added_m": "OSPA added (m)",
    "fn_vs_undefended": "FN, minus undefended",
    "fp_vs_undefended": "FP, minus undefended",
    "ospa_vs_undefended_m": "OSPA, minus undefended (m)",
    "fp_identifiable": "false objects inserted, identifiable",
    "fp_unidentifiable": "false objects inserted, not identifiable",
    "attacked": "runs with a lie (share)",
    "identifiable_removed": "identifiable false objects removed (share)",
    "lies_detected": "observable lies detected (share)",
    "median_delay_s": "median delay (s)",
    "honest_suspended_per_hour": "honest agents suspended per hour",
    "faulty_suspended_per_hour": "faulty agents suspended per hour",
    "wrongly_suspended": "runs without lies that suspend an agent (share)",
    "framed": "runs with a lie in which an honest agent is framed (share)",
    "framed_by_minority": "framed, liars below the local majority (share)",
    "framed_by_majority": "framed, liars in the local majority (share)",
    "honest_majority": "objects with an honest majority (share)",
    "liars_watched": "liars with an observable lie",
    "liars_suspended": "of these suspended",
    "suspended_before": "suspended before",
}


@dataclass(frozen=True, slots=True)
class Published:
    """A published figure of a method, or a method without one.

    method: our stage or attack;  source: citation
    figure: of the paper, "" if none is known;  basis: how figure and method are known
    quantities: names in `scoreboard.QUANTITIES`, nearest to the figure;  why: ours differs
    defences, attacks: names in the matrix, of which one is the method; (): all
    """

    method: str
    source: str
    basis: str
    quantities: tuple[str, ...]
    why: str
    figure: str = ""
    defences: tuple[str, ...] = ()
    attacks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MatrixTable:
    """The cells of a study, a summary and curves for each defence that judges agents, and single trials.

    rows: a defence against one adversary, with its most harmful budget: the numbers of DEFENCE_MEASURES (damage is
           relative to no defence and no attack, with the same scene and seed), s by conduct and state of trust
           (`seconds faulty suspended`), over all agents and trials, and the user's metrics of the ego's picture (`own
           NAME`), with their differences from no defence and no attack. They are of: attack, "" without one; budget:
           lies per second of each adversary, None: the attack's own; budgets: number of budgets that were tried
    summaries: what a defence is worth, over all rows: shares of DEFENCE_MEASURES over all runs under attack;
           alarms_per_hour: suspensions of honest agents in runs without an attack, of `frames` frames together;
           fn_added, fp_added: objects per frame without an attack; faults_suspended: share of the runs with faults
           alone that suspend an agent; auc, partial_auc, hours: of its suspicion, one score for each agent-run, whole,
           and the mean share of liars detected below one false alarm per hour; of `mast study matrix` also
           harm_removed: share of what all attacks add to the same picture without them that the defence takes away, in
           runs in which they took place; negative: they add more with it;
           cpu_ratio_alone, cpu_ratio_attacked: processor time relative to no defence
    rocs:  by defence, how well its suspicion tells liars from honest agents
    delays: by defence, the share of liars not suspended yet
    states: of defence and conduct, the share of the time with this conduct in each state of trust, over all cells
    panels: the trust of single trials;  unshown: number of pairs of a defence and an adversary without a panel
    not_suspending: defences that judge agents and suspended nobody in any run; they have no delays

    What follows only `mast study matrix` has:
    scenes:   titles of the kinds of scene, in order
    by_scene: the cells in one kind of scene or in all (`scene` is its title, or "" for all together):
            damage:   missed and false objects added per frame, compared with no attack and no defence
            by_attack: compared with the same defence without an attack
            harm:     compared with no defence under this attack
            attacked: share of the runs in which the adversaries lied; unknown without any
            honest_suspended: share of the runs that suspend an agent while it is honest, whether anybody lied or not
            cpu_ms:   of a run, per frame
            cpu_ratio: geometric mean of the ratios to the undefended runs of one scene and seed
    breakdowns: with how many adversaries a defence breaks, see `FieldMatrix._breakdown`
    published: the figures of methods that were played, with ours: of a defence and attacks
    """

    rows: Sequence[Row]
    summaries: Sequence[Row]
    size: str
    rocs: Mapping[str, Roc] = field(default_factory=dict)
    delays: Mapping[str, Survival] = field(default_factory=dict)
    states: Sequence[Row] = ()
    panels: Sequence[TrustPanel] = ()
    unshown: int = 0
    not_suspending: Sequence[str] = ()
    scenes: Sequence[str] = ()
    by_scene: Sequence[Row] = ()
    breakdowns: Sequence[Row] = ()
    published: Sequence[tuple[Published, Sequence[Row]]] = ()

    def names(self, key: str) -> list[Any]:
        """The values of a name in order of appearance, without those of runs without an attack."""
        return list(dict.fromkeys(row.of[key] for row in self.rows if row.of["attack"] or key == "defence"))

    def row(self, defence: object, attack: object, n_adversaries: object, placement: object) -> Row | None:
        """The row of a cell; None if there is none. Without adversaries, it is the same for every attack."""
        for row in self.rows:
            quiet = row.of["n_adversaries"] == n_adversaries == 0
            place = row.of["attack"], row.of["n_adversaries"], row.of["placement"]
            if row.of["defence"] == defence and (quiet or place == (attack, n_adversaries, placement)):
                return row
        return None
