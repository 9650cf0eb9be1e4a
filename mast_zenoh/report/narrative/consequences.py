"""The worst that happened to driven cars: how the headlines of runs with drivers begin."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from mast_zenoh.report.comparison import WAY_M, Reference
from mast_zenoh.report.narrative.changes import capital, count, join_names
from mast_zenoh.runs.run import Run

#: Cars that a headline names; more are counted.
_MOST_CARS = 3


class Drive(NamedTuple):
    """What happened to one car: objects that it hit, needless brakes, and its way in m."""

    hits: int
    needless: int
    way_m: float


def drives(run: Run) -> dict[str, Drive]:
    """What happened to each driven car; without those whose entry in metrics.json is damaged."""
    cars = run.files.summary.get("driven")
    result = {}
    for car, happened in cars.items() if isinstance(cars, Mapping) else ():
        if isinstance(happened, Mapping):
            hits, needless, way = (happened.get(key) for key in ("collisions", "needless_brakes", "progress_m"))
            if isinstance(hits, list) and isinstance(needless, int) and isinstance(way, (int, float)):
                result[car] = Drive(len(hits), needless, float(way))
    return result


def consequence(run: Run, reference: Reference | None = None) -> str:
    """Collisions of driven cars, else needless brakes and changed ways, without a full stop; empty: nothing such.

    reference: the run that it is compared with, such as its unattacked twin
    """
    own = drives(run)
    others = drives(reference.run) if reference is not None else {}
    hits, other_events = {}, {}
    for car, drive in own.items():
        subject = "the ego" if car == run.ego == "ego" else car
        other, name = others.get(car), reference.name if reference is not None else ""
        if drive.hits or (other is not None and other.hits):
            in_other = "" if other is None else f" ({name}: {_objects(other.hits, 'none')})"
            hits[car] = f"{subject} hits {_objects(drive.hits, 'nothing')}{in_other}"
        elif text := _brakes_and_way(drive, other, name):
            other_events[car] = f"{subject} {text}"
    texts = hits or other_events
    ego_first = [texts[car] for car in sorted(texts, key=lambda car: car != run.ego)]
    text = join_names(ego_first, _MOST_CARS)
    return capital(text) if text.startswith("the ego ") else text  # names of cars stay as they are


def worst(runs: Mapping[str, Run], reference: Reference) -> str:
    """Of several runs with drivers, the one whose cars hit most, else brake needlessly most, else lose most way.

    A sentence without a full stop; empty: nothing happened to any car.
    """

    def harm(label: str) -> tuple[int, int, float]:
        own, others = drives(runs[label]), drives(reference.run)
        lost_m = sum(others[car].way_m - drive.way_m for car, drive in own.items() if car in others)
        return sum(each.hits for each in own.values()), sum(each.needless for each in own.values()), lost_m

    texts = {label: text for label, run in runs.items() if (text := consequence(run, reference))}
    if not texts:
        return ""
    label = max(texts, key=harm)
    return f"{label}: {texts[label][0].lower()}{texts[label][1:]}"


def _brakes_and_way(drive: Drive, other: Drive | None, name: str) -> str:
    """`brakes needlessly once (unattacked: never) and drives 29 m instead of 93 m`."""
    in_other = f" ({name}: {_times(other.needless)})" if other is not None else ""
    parts = [f"brakes needlessly {_times(drive.needless)}{in_other}"] * bool(drive.needless)
    if other is not None and abs(drive.way_m - other.way_m) > WAY_M:
        whose = "" if parts else f" ({name})"
        parts.append(f"drives {drive.way_m:.0f} m instead of {other.way_m:.0f} m{whose}")
    return " and ".join(parts)


def _objects(number: int, none: str) -> str:
    return f"{count(number)} object{'' if number == 1 else 's'}" if number else none


def _times(number: int) -> str:
    return ("never", "once", "twice")[number] if 0 <= number < 3 else f"{count(number)} times"
