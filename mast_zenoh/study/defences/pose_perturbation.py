"""The closed loop of PosePert beside ours: a vehicle on a road is perceived up to a metre aside, and the ego reacts.

Every trial under attack is paired with its twin, the same road, seed and defence without the attack. As there, only
roads count on which the twin is safe: in a cut-in it is never slower than CLEAN_KMH; behind a leader it does not
collide, and its time to collision is never below CRITICAL_S.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.metrics.estimates import MISSION
from mast_zenoh.metrics.study_results import NAN, Row, Statistic
from mast_zenoh.run_folder.tables import from_arrow
from mast_zenoh.scenes.generated.road import BEGINS_S, TARGET
from mast_zenoh.show.findings.words import of_study, paragraph
from mast_zenoh.show.number_text import DASH, measured, percent
from mast_zenoh.show.tables.text_table import ResultTables, TextTable, numbers_of_rows, shown, table_of_rows
from mast_zenoh.study import statistics
from mast_zenoh.study.defences.kinds import Factors, Kind, few_trials
from mast_zenoh.study.numbers import CRITICAL_S
from mast_zenoh.study.trial import TrialKey, TrialOutcome

if TYPE_CHECKING:
    from mast_zenoh.runs.run import Run
    from mast_zenoh.show.figures.drawing import RenderedFigure

#: km/h: the ego of a safe twin is never slower than the first; an attacked one brakes needlessly if its least speed is
#: lower than that of its twin by the second or more. Source: zqzqz/PosePert 4c58d7f, carla_demo/mvp_carla/config.py.
CLEAN_KMH, SLOWER_KMH = 22.0, 4.0
#: m, from the target to the object of the picture that stands for it.
_GATE_M = 2.0
#: By case: the name of its attack, and the measure of its harm.
CASES = {"cut_in": ("phantom cut-in", "slowed"), "leader": ("suppressed leader", "critical")}
#: Of a case: measure, its value in the paper and in the authors' own repetition, and one or two numbers of ours.
#: Source: arXiv 2605.01301, and zqzqz/PosePert 3c95189.
PUBLISHED = (
    ("cut_in", "roads with needless braking (%)", "50", "25 (3 of 12)", ("slowed",)),
    ("cut_in", "realised shift (m)", DASH, "0.68 to 0.77 if it brakes, else 0.35 to 0.51", ("shift_m",)),
    ("leader", f"roads with TTC < {CRITICAL_S} s (%)", "40", "30 (of 30: 40, 30, 20)", ("critical",)),
    ("leader", "collisions (% of roads)", "10", "0 (of 30)", ("collided",)),
    ("leader", "least TTC without and with it (s)", "2.6, < 1.5", "3.20, 2.07", ("ttc_before_s", "ttc_after_s")),
    ("leader", "realised shift (m)", DASH, DASH, ("shift_m",)),
)


class PosePerturbation(Kind):
    """Harm, realised shift and alarms by attack and defence.

    Its factors: case, of the road; frames, for which the attack lasts, 0: no attack; step_m, m by which the shift grows
    in each; start_s, s of scene time at which it begins; defence, "": none
    """

    name = "posepert"
    drawn = ("posepert",)

    @staticmethod
    def evaluate(run: Run, compromised: Sequence[str]) -> dict[str, Any]:
        """The part `defence` of a trial's metrics.

        times_s:     s of scene time of each scored frame;  kmh: km/h, of the ego
        shift_m:     m, by which the mission estimate has the target farther from the middle of the ego's lane than it
                     is; None: it has none
        alarm:       whether a track of the target is contradicted, the target is withheld, or an agent is suspended
        """
        table = from_arrow(run.objects)
        of_ego = (table["agent"] == "ego") & (table["estimator"] == MISSION)
        target = of_ego & (table["kind"] == "truth") & (table["id"] == TARGET)
        track = of_ego & (table["kind"] == "track") & (table["outcome"] == "matched") & (table["match_id"] == TARGET)
        place = {int(table["frame"][row]): (table["x"][row], table["y"][row]) for row in np.flatnonzero(target)}
        believed = {int(table["frame"][row]): table["y"][row] for row in np.flatnonzero(track)}
        alarms: set[int] = set()
        if run.defence:
            agents, objects = from_arrow(run.trust), from_arrow(run.trust_objects)
            alarms |= set(agents["frame"][agents["state"] == "suspended"].tolist())
            for row in np.flatnonzero(objects["withheld"].astype(bool) | (objects["contradicting"] > 0)):
                x, y = place.get(int(objects["frame"][row]), (math.inf, math.inf))
                if math.hypot(objects["x"][row] - x, objects["y"][row] - y) <= _GATE_M:
                    alarms.add(int(objects["frame"][row]))
        driven = from_arrow(run.driven)
        frames = [frame for frame in driven["frame"].tolist() if frame in place]
        rows = np.isin(driven["frame"], frames)
        asides = [(believed.get(frame), place[frame][1]) for frame in frames]
        shifts = [None if to is None else round(float((to - aside) * np.sign(aside)), 4) for to, aside in asides]
        return {
            "times_s": np.round(driven["time_s"][rows], 6).tolist(),
            "kmh": np.round(3.6 * driven["speed_mps"][rows], 4).tolist(),
            "shift_m": shifts,
            "alarm": [frame in alarms for frame in frames],
        }

    def measures(self, factors: Factors, outcome: TrialOutcome) -> dict[str, Any]:
        """What the table needs of one trial:

        collided, min_ttc_s: of the run, infinite: nothing was ahead;  slowest_kmh: km/h, least speed from BEGINS_S on
        shift_m: by frame, toward the ego's lane or away from it, as the attack wants it;  times_s, alarm: by frame
        """
        part, driven = outcome.metrics["defence"], outcome.metrics["driven"]["ego"]
        times, sign = np.array(part["times_s"]), -1.0 if factors["case"] == "cut_in" else 1.0
        ttc_s = driven["min_ttc_s"]
        return {
            "collided": float(bool(driven["collisions"])),
            "min_ttc_s": math.inf if ttc_s is None else ttc_s,
            "slowest_kmh": float(np.min(np.array(part["kmh"])[times >= BEGINS_S], initial=math.inf)),
            "shift_m": sign * np.array(part["shift_m"], np.float64),
            "times_s": times,
            "alarm": np.array(part["alarm"], np.float64),
        }

    def _during(self, factors: Factors, attack: Factors, name: str) -> dict[TrialKey, Floats]:
        """A measure in the frames of an attack, and half a second more, by trial."""
        begin_s, end_s = attack["start_s"], attack["start_s"] + 0.1 * attack["frames"] + 0.5
        return {
            key: each[name][(each["times_s"] >= begin_s - 0.05) & (each["times_s"] < end_s)]
            for key, each in self.trials.get(factors, {}).items()
            if each
        }

    def table(self) -> list[Row]:
        """A row for each attack and defence."""
        return [self._row(factors) for factors in self.trials if factors["frames"]]

    def _row(self, factors: Factors) -> Row:
        twin = factors.but(frames=0, step_m=0.0)
        slowest, ttc, collided = (
            (self.values(twin, name), self.values(factors, name)) for name in ("slowest_kmh", "min_ttc_s", "collided")
        )
        safe = slowest[0] >= CLEAN_KMH if factors["case"] == "cut_in" else (ttc[0] >= CRITICAL_S) & (collided[0] == 0.0)
        safe &= ~np.isnan(ttc[1])
        numbers = {
            "slowed": self._share(slowest[1] <= slowest[0] - SLOWER_KMH, safe),
            "critical": self._share((ttc[1] < CRITICAL_S) | (collided[1] > 0.0), safe),
            "collided": self._share(collided[1] > 0.0, safe),
            "ttc_before_s": _median(ttc[0][safe]),
            "ttc_after_s": _median(ttc[1][safe]),
        }
        away = [self._during(each, factors, "shift_m") for each in (twin, factors)]
        shift = [
            np.nanmax(away[1][key] - away[0][key], initial=-math.inf) if key in away[0] and key in away[1] else NAN
            for key in self.order
        ]
        known = safe & np.isfinite(shift)
        numbers["shift_m"] = self.mean(np.where(known, shift, NAN))
        for name, each in (("false_alarms", twin), ("alarms", factors)):
            alarms = self._during(each, factors, "alarm")
            share = [float(alarms[key].mean()) if key in alarms else NAN for key in self.order]
            numbers[name] = self.mean(np.where(safe, share, NAN), (0.0, 1.0))
        numbers["harm"] = numbers[CASES[factors["case"]][1]]
        attack = f"{CASES[factors['case']][0]}, {factors['frames']} frames, {factors['step_m']:g} m each"
        of = {"attack": attack, "defence": factors["defence"] or "none"}
        return Row(of | {"case": factors["case"]}, int(safe.sum()), numbers)

    def _share(self, happened: Bools, safe: Bools) -> Statistic:
        """The share of safe trials in which something happened; its interval is that of so many seeds or scenes."""
        if not safe.any():
            return Statistic()
        units = int(statistics.units(safe, len(self.scenes)).any(axis=0).sum())
        share = float((happened & safe).sum() / safe.sum())
        return statistics.share_of_trials(share * units, units)._replace(trials=int(safe.sum()))

    def tables(self, table: Sequence[Row]) -> ResultTables:
        """The CSV has a row for each attack, defence and measure."""
        sentences = conclusion(table)
        compared = _compared(table)
        titled = [Row({name: row.of[name] for name in ("attack", "defence")}, row.trials, row.numbers) for row in table]
        by_defence = table_of_rows("By defence", paragraph("posepert_defences"), titled, _BY_DEFENCE, texts=2)
        return ResultTables(
            "PosePert",
            " ".join([f"{self.size}.", *sentences, paragraph("posepert_about")]),
            self.size,
            [compared, by_defence],
            numbers_of_rows(titled),
            [compared],
            note=few_trials(row["shift_m"] for row in table),
            headline=sentences[0].removesuffix(".") if sentences else "",
            reading=sentences[1:],
        )

    def figures(self, table: Sequence[Row]) -> Mapping[str, RenderedFigure]:
        from mast_zenoh.show.figures.drawing import render  # drawing libraries are slow to load
        from mast_zenoh.show.figures.facets import Axis, facet

        axes = [
            Axis("harm", "unsafe roads (%)", 100.0),
            Axis("shift_m", "realised shift (m)"),
            Axis("alarms", "frames with an alarm (%)", 100.0),
        ]
        figure = facet([row for row in table if row.trials], "defence", axes, "attack")
        caption = paragraph("figure_posepert", size=self.size)
        return {self.name: render(self.name, figure, " ".join(conclusion(table)), caption, printed=True)}


def _median(values: Floats) -> Statistic:
    """The median over trials of the least time to collision, s; infinite: nothing was ahead in half of them."""
    return statistics.pooled(lambda rows: float(np.median(values[rows])), len(values))


_BY_DEFENCE = {
    "safe roads": lambda row: str(row.trials),
    "unsafe (%)": shown("harm", percent),
    "collisions (%)": shown("collided", percent),
    "least TTC (s)": shown("ttc_after_s"),
    "realised shift (m)": shown("shift_m"),
    "false alarms (%)": shown("false_alarms", percent),
    "alarms under attack (%)": shown("alarms", percent),
}


def _compared(table: Sequence[Row]) -> TextTable:
    """The paper, its authors' repetition, and our results without a defence."""
    lines = []
    for case, what, paper, repeated, names in PUBLISHED:
        for row in table:
            if row.of["case"] == case and row.of["defence"] == "none":
                write = percent if "%" in what else measured
                ours = ", ".join(write(row[name]) for name in names)
                lines.append([str(row.of["attack"]), what, paper, repeated, ours.replace("\n", " ")])
    headings = ["attack", "measure", "paper", "repetition", "ours"]
    return TextTable("Theirs and ours", paragraph("posepert_compared"), headings, lines, texts=2)


def conclusion(table: Sequence[Row]) -> list[str]:
    """Sentences: what the attacks do without a defence, beside the paper's numbers; and what the defences change."""
    played = [row for row in table if row.trials]
    undefended = [row for row in played if row.of["defence"] == "none"]
    return of_study("posepert", undefended=undefended, defended=[row for row in played if row not in undefended])
