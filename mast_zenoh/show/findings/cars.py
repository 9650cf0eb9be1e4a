"""What happened to driven cars."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mast_zenoh.run_folder.finding import Finding
from mast_zenoh.runs.driven import happened_to
from mast_zenoh.runs.run import Run
from mast_zenoh.show.comparison import WAY_M, Reference

#: Cars, and of each car collisions and brakes, that have findings; the table and the time axis have all.
_MOST = 3


def drives(run: Run) -> dict[str, Mapping[str, Any]]:
    """What happened to each driven car, the ego first; without those whose entry in metrics.json is damaged."""
    cars = run.files.summary.get("driven")
    known = [
        (car, drive)
        for car, drive in (cars.items() if isinstance(cars, Mapping) else ())
        if isinstance(drive, Mapping)
        and isinstance(drive.get("collisions"), list)
        and isinstance(drive.get("needless_brakes"), int)
        and isinstance(drive.get("progress_m"), (int, float))
    ]
    return dict(sorted(known, key=lambda each: each[0] != run.ego))


def worst(run: Run, reference: Reference | None = None) -> list[Finding]:
    """Collisions of driven cars, else needless brakes and changed ways; none if nothing such happened.

    reference: the run that it is compared with, such as its unattacked twin
    """
    hits, others = list[Finding](), list[Finding]()
    for each in counts(run, reference):
        if each.what == "hits" and (each.value or each.other):
            hits.append(each)
        differs = each.other is not None and abs((each.value or 0.0) - each.other) > WAY_M
        if (each.what == "needless" and each.value) or (each.what == "way" and differs):
            others.append(each)
    every = hits or others
    rest = tuple(dict.fromkeys(name for each in every[_MOST:] for name in each.who))
    return [*every[:_MOST], *[Finding("car", rest, "others", len(rest))] * bool(rest)]


def of_cars(run: Run, reference: Reference | None = None) -> list[Finding]:
    """Collisions, brakes that are needless or due to an adversary, and the way.

    Of more than _MOST cars, only the ego and those that hit something have findings.

    reference: the run that it is compared with
    """
    cars, result = drives(run), list[Finding]()
    notable = [car for car, drive in cars.items() if car == run.ego or drive["collisions"] or len(cars) <= _MOST]
    for car in notable[:_MOST]:
        happened = happened_to(run, car)
        result += [each for each in happened if each.kind == "collision"][:_MOST]
        brakes = [each for each in happened if each.kind == "brake" and (each.what or each.cause[1:])]
        brakes.sort(key=lambda brake: -(brake.value or 0.0))
        result += brakes[:_MOST]
        shown = [
            each for each in counts(run, reference) if each.who == (car,) and each.what not in ("hits", "needless")
        ]
        result += [each for each in shown if each.value or each.other or each.what == "way"]
        if len(brakes) > _MOST:
            result.append(Finding("car", (car,), "more", len(brakes) - _MOST))
    return result


def counts(run: Run, reference: Reference | None) -> list[Finding]:
    """The numbers of each car, beside those of the reference if that drives it too."""
    others = drives(reference.run) if reference is not None else {}
    result = []
    for car, drive in drives(run).items():
        other, than = others.get(car), reference.name if reference is not None and car in others else ""
        for what, key, unit in (
            ("hits", "collisions", ""),
            ("needless", "needless_brakes", ""),
            ("omits", "missed_brakes", ""),
            ("way", "progress_m", "m"),
            ("stands", "standing_s", "s"),
        ):
            value, before = _number(drive.get(key)), None if other is None else _number(other.get(key))
            result.append(Finding("car", (car,), what, value, before, unit, than=than))
    return result


def _number(value: Any) -> float:
    return float(len(value) if isinstance(value, list) else value or 0)
