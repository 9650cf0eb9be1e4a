"""From a spoofer's pulses to the brake: how far attacks on a lidar get, link by link.

Every trial under attack is paired with its twin, the same scene, seed and checks without the attack. The links are
measured on the wires and by the evaluator, never reported by the attack.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mast_zenoh.arrays.states import Bools, Detections, Floats
from mast_zenoh.attacks.attack import sensor_of
from mast_zenoh.metrics.assignment import Places, nearest
from mast_zenoh.metrics.causes import KINDS
from mast_zenoh.metrics.estimates import LOCAL, MISSION
from mast_zenoh.metrics.study_results import NAN, Row
from mast_zenoh.run_folder.tables import from_arrow
from mast_zenoh.runs.messages import messages
from mast_zenoh.sensing import to_world
from mast_zenoh.show.findings.words import of_study, paragraph
from mast_zenoh.show.number_text import measured, percent
from mast_zenoh.show.tables.text_table import ResultTables, numbers_of_rows, shown, table_of_rows
from mast_zenoh.study.defences.kinds import Factors, Kind, few_trials
from mast_zenoh.study.trial import TrialOutcome

if TYPE_CHECKING:
    from mast_zenoh.metrics.study_results import Statistic
    from mast_zenoh.runs.run import Run
    from mast_zenoh.show.figures.drawing import RenderedFigure

#: m, from an object that points make, or have lost, to a detection of it.
_GATE_M = 3.0
#: The links of the chain, in their order: what each is called in tables.
LINKS = {
    "landed": "points landed (%)",
    "detected": "detected (%)",
    "tracked": "tracked (%)",
    "fused": "fused (%)",
    "braked": "braked (% of runs)",
}


class SpoofedSensing(Kind):
    """The success of each link by attack, budget, distance and check of detections.

    Its factors: attack, "": none; budget, distance: texts; check, "": none; start_s, s of scene time of the attack
    """

    name = "sensing"
    drawn = ("sensing",)
    recorded = True

    @staticmethod
    def evaluate(run: Run, compromised: Sequence[str]) -> dict[str, Any]:
        """The part `defence` of a trial's metrics, of the frames from the attack's first change on.

        frames:   their number, one each `period_s`;  landed: frames in which points were inserted or removed
        points:   mean number of these points in a landed frame: inserted ones, if there are any
        detected: landed frames in which the victim detects what was inserted, nearer than any true object, or does not
                  detect an object from which points were removed and which it detected before the attack
        tracked, fused: frames in which the ego's own tracks, or its mission estimate, have an error that the attack
                  caused
        """
        effects, objects = from_arrow(run.attacks), from_arrow(run.objects)
        points = (effects["message"] == "points") & (effects["points"] > 0)
        effects = {name: column[points] for name, column in effects.items()}
        landed = np.unique(effects["frame"])
        scored = np.unique(objects["frame"])
        after = scored[scored >= landed.min()] if len(landed) else scored[:0]
        caused = np.isin(objects["cause"], KINDS) & (objects["agent"] == run.ego) & np.isin(objects["frame"], after)
        links = {
            link: len(np.unique(objects["frame"][caused & (objects["estimator"] == estimator)]))
            for link, estimator in (("tracked", LOCAL), ("fused", MISSION))
        }
        inserted = effects["effect"] == "inserted"
        counted = effects["points"][inserted if inserted.any() else ~inserted].sum() / max(len(landed), 1)
        of_frames = {"frames": len(after), "period_s": run.period_s, "landed": len(landed), "points": float(counted)}
        return of_frames | {"detected": _changed_detections(run, effects, objects), **links}

    def measures(self, factors: Factors, outcome: TrialOutcome) -> dict[str, Any]:
        """What the table needs of one trial: shares of frames, points a scan, and what the car did."""
        part, driven = outcome.metrics["defence"], outcome.metrics["driven"]["ego"]
        did = {"needless": driven["needless_brakes"], "collided": float(bool(driven["collisions"]))}
        if not factors["attack"]:
            return did
        frames, landed = outcome.metrics["frames"] - round(factors["start_s"] / part["period_s"]), part["landed"]
        shares = {"landed": landed / frames, "detected": part["detected"] / landed if landed else 0.0}
        of_frames = part["frames"]
        shares |= {link: part[link] / of_frames if of_frames else 0.0 for link in ("tracked", "fused")}
        return did | {"points": part["points"], **{link: min(share, 1.0) for link, share in shares.items()}}

    def table(self) -> list[Row]:
        """A row for each attack, budget, distance and check."""
        return [self._row(factors) for factors in self.trials if factors["attack"]]

    def _row(self, factors: Factors) -> Row:
        twin = factors.but(attack="", budget="", distance="")
        needless, collided = (self.values(factors, name) - self.values(twin, name) for name in ("needless", "collided"))
        worse = np.where(np.isnan(needless), NAN, (needless > 0.0) | (collided > 0.0))
        bounds = (0.0, 1.0)
        numbers: dict[str, Statistic] = {"points": self.mean(self.values(factors, "points"), (0.0, np.inf))}
        numbers |= {link: self.mean(self.values(factors, link), bounds) for link in LINKS if link != "braked"}
        numbers["braked"] = self.mean(worse, bounds)
        of = {name: factors[name] for name in ("attack", "budget", "distance")} | {"check": factors["check"] or "none"}
        return Row(of, int(np.sum(~np.isnan(worse))), numbers)

    def tables(self, table: Sequence[Row]) -> ResultTables:
        """The CSV has a row for each attack, budget, distance, check and measure."""
        sentences = conclusion(table)
        columns = {"points a scan": shown("points", measured)}
        columns |= {heading: shown(link, percent) for link, heading in LINKS.items()}
        links = table_of_rows("Links of the chain", paragraph("sensing_about"), table, columns, texts=4)
        return ResultTables(
            "Attacks on lidars",
            " ".join([f"{self.size}.", *sentences]),
            self.size,
            [links],
            numbers_of_rows(table),
            [links],
            note=few_trials(row["landed"] for row in table),
            headline=sentences[0].removesuffix(".") if sentences else "",
            reading=sentences[1:],
        )

    def figures(self, table: Sequence[Row]) -> Mapping[str, RenderedFigure]:
        from mast_zenoh.show.figures.drawing import render  # drawing libraries are slow to load
        from mast_zenoh.show.figures.facets import Axis, facet

        named = [
            Row(row.of | {"attack": "{attack}, {budget}\n{distance}".format(**row.of)}, row.trials, row.numbers)
            for row in table
            if row.trials
        ]
        axes = [Axis(link, heading, 100.0) for link, heading in LINKS.items()]
        height = 0.8 + 0.45 * len({row.of["attack"] for row in named})
        figure = facet(named, "attack", axes, "check", size=(2.8, height))
        caption = paragraph("figure_sensing", size=self.size)
        return {self.name: render(self.name, figure, " ".join(conclusion(table)), caption, printed=True)}


def conclusion(table: Sequence[Row]) -> list[str]:
    """Sentences: which attack gets farthest, where chains break, and what checks of detections change."""
    played = [row for row in table if row.trials]
    undefended = [row for row in played if row.of["check"] == "none"]
    by_check: dict[str, list[tuple[Row, Row]]] = defaultdict(list)
    for row in undefended:
        for other in played:
            if other.of["check"] != "none" and other.of == row.of | {"check": other.of["check"]}:
                by_check[str(other.of["check"])].append((row, other))
    farthest = max(undefended, key=lambda row: (row["braked"].value, row["fused"].value), default=None)
    broken = [(row, link) for row in undefended if (link := _broken(row))]
    return of_study("sensing", farthest=farthest, broken=broken, by_check=by_check, links=LINKS, of=len(undefended))


def _broken(row: Row) -> str:
    """The first link of an attack that succeeds in less than half; empty: all do in half and more."""
    return next((link for link in LINKS if row[link].value < 0.5), "")


def _changed_detections(run: Run, effects: Mapping[str, Any], objects: Mapping[str, Any]) -> int:
    """In how many frames the victim detects what was inserted, or lacks an object that it detected before the attack.

    effects: those on points;  objects: true ones and tracks, by frame
    """
    if not len(effects["frame"]):
        return 0
    by_frame = _detections(run, str(effects["wire"][0]))
    frames = np.array([frame for frame, positions in by_frame.items() for _ in positions], np.int64)
    detections = Places(frames, np.concatenate([np.zeros((0, 3)), *by_frame.values()]))
    true = (objects["kind"] == "truth") & (objects["estimator"] == LOCAL) & (objects["agent"] == run.ego)
    truth, ids = Places.of_rows(objects, true), objects["id"][true]
    detected = _are_near(truth, detections)
    last = max((frame for frame in by_frame if frame < effects["frame"].min()), default=-1)
    known = ids[(truth.group == last) & detected]
    removed = Places.of_rows(effects, effects["effect"] == "removed", "before_")
    lost = np.isin(ids, known) & ~detected & _are_near(truth, removed)
    inserted = Places.of_rows(effects, effects["effect"] == "inserted", "after_")
    to_inserted, to_truth = (nearest(detections, places, _GATE_M)[1] for places in (inserted, truth))
    return len(np.union1d(truth.group[lost], detections.group[to_inserted < to_truth]))


def _are_near(places: Places, others: Places) -> Bools:
    return np.asarray(nearest(places, others, _GATE_M)[0] >= 0)


def _detections(run: Run, wire: str) -> dict[int, Floats]:
    """By frame, the positions (n, 3) m, world frame, of what was detected in the scans of a wire."""
    subject = wire.split("/")[1]
    bodies: dict[str, dict[int, Any]] = {"pose": {}, "detections": {}}
    for message in messages(run.path, f"agent/{subject}/*", taps=True):
        if message.type in bodies and message.wire == f"agent/{subject}/{message.type}":
            bodies[message.type].setdefault(message.frame, message.body)
    return {
        frame: to_world(Detections.from_columns(body), *sensor_of(body, pose)).position
        for frame, body in bodies["detections"].items()
        if (pose := bodies["pose"].get(frame)) is not None
    }
