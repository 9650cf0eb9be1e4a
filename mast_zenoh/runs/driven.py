"""Driven cars in what shows a run: their course, that of the unattacked twin, and why they braked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mast_zenoh.driving.braking import BRAKING_MPS2
from mast_zenoh.launch.twin import FOLDER, NAME
from mast_zenoh.run_folder.finding import Finding, sentence
from mast_zenoh.runs.events import Happening
from mast_zenoh.runs.files import RunFiles, Table, rows
from mast_zenoh.runs.run import Run

#: What a car does in a frame: it does not brake, it brakes, it does so although the truth gives no reason.
ROLLS, BRAKES, NEEDLESSLY = range(3)


def cars_of(run: Run) -> list[str]:
    """The driven cars whose course is known, the main agent first."""
    names = list(dict.fromkeys(run.files.driven["agent"].tolist())) if run.files.driven is not None else []
    return sorted(names, key=lambda name: name != run.ego)


def course_of(run: Run, car: str = "") -> Table | None:
    """The rows of driven.parquet of one car, by default the first of `cars_of`; None: there are none."""
    names = cars_of(run)
    chosen = car or next(iter(names), "")
    if run.files.driven is None or chosen not in names:
        return None
    return rows(run.files.driven, run.files.driven["agent"] == chosen)


def brakes_of(run: Run, car: str) -> list[dict[str, Any]]:
    """The brakes of a car, as in metrics.json; without those that are damaged."""
    return [each for each in _entries(run, car, "brakes") if _is_brake(each)]


def _entries(run: Run, car: str, name: str) -> list[Any]:
    """A list in the part of metrics.json about a car; empty if it is damaged."""
    part: Any = run.files.summary
    for key in ("driven", car, name):
        part = part.get(key) if isinstance(part, Mapping) else None
    return part if isinstance(part, list) else []


def _is_brake(brake: Any) -> bool:
    if not isinstance(brake, Mapping) or not isinstance(brake.get("cause"), Mapping):
        return False
    numbers = [brake.get(name) for name in ("from_s", "until_s", "hardest_mps2")]
    return all(isinstance(number, float) for number in numbers) and {"kind", "object", "adversary"} <= {*brake["cause"]}


def braking_of(run: Run, car: str, times_s: np.ndarray) -> np.ndarray:
    """What a car does at some times (n,) s: ROLLS (also in interruptions of a brake), BRAKES or NEEDLESSLY, (n,)."""
    result = np.full(len(times_s), ROLLS)
    course = course_of(run, car)
    if course is None:
        return result
    row = course["time_s"].searchsorted(times_s + 1e-6, "right") - 1
    slows = (row >= 0) & (course["acceleration_mps2"][row] < -BRAKING_MPS2)
    for brake in brakes_of(run, car):
        during = (times_s >= brake["from_s"] - 1e-6) & (times_s < brake["until_s"] - 1e-6)
        result[during & slows] = NEEDLESSLY if brake.get("needless") else BRAKES
    return result


def twin_course(run: Run, car: str) -> Table | None:
    """The course of a car in the unattacked twin of a run; None: it has none, or the car is not driven there."""
    twin = RunFiles(run.path / FOLDER)
    if twin.record.get("name") != NAME or twin.driven is None:
        return None
    course = rows(twin.driven, twin.driven["agent"] == car)
    return course if len(course["frame"]) else None


def happened_to(run: Run, car: str) -> list[Finding]:
    """Collisions of a car and its brakes, each with the object; the brakes with the kind of their cause."""
    found = []
    for hit in _entries(run, car, "collisions"):
        if isinstance(hit, Mapping) and type(hit.get("frame")) is int:
            what, when = "hidden" if hit.get("hidden") else "", (hit["frame"] * run.period_s,) * 2
            who = (car, str(hit.get("object")))
            found.append(Finding("collision", who, what, hit.get("speed_mps"), unit="m/s", when=when))
    return found + [_braked(car, brake) for brake in brakes_of(run, car)]


def _braked(car: str, brake: Mapping[str, Any]) -> Finding:
    """A brake of a car, from metrics.json."""
    needless, of = bool(brake.get("needless")), brake["cause"]
    known = brake.get("on_truth_mps2") if needless and of["kind"] == "real" else None
    who = (car,) if of["object"] is None else (car, str(of["object"]))
    what, when = "needless" if needless else "", (brake["from_s"], brake["until_s"])
    cause = (str(of["kind"]), *[str(of["adversary"])] * bool(of["adversary"]))
    return Finding("brake", who, what, brake["hardest_mps2"], known, "m/s²", when=when, cause=cause)


def braking_events(run: Run, times: np.ndarray, *, brief: bool = False) -> list[Happening]:
    """Brakes and collisions of driven cars. times: (f,) s, of the frames; brief: without reasons"""
    events = []
    for car in cars_of(run):
        course = course_of(run, car)
        assert course is not None
        for each in happened_to(run, car):
            assert each.when is not None
            frame = round(each.when[0] / run.period_s)
            if each.kind == "brake":
                frame = int(np.searchsorted(times, each.when[0] - 1e-6))
            told = replace(each, when=None, other=None, cause=() if brief else each.cause)
            if frame < len(times) or each.kind == "brake":
                events.append(Happening(frame, each.kind, sentence(told), *_place(course, frame)))
    return events


def _place(course: Table, frame: int) -> tuple[float, float]:
    row = min(int(np.searchsorted(course["frame"], frame)), len(course["frame"]) - 1)
    return round(float(course["x"][row]), 2), round(float(course["y"][row]), 2)
