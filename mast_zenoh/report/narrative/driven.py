"""What happened to driven cars, in words."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

from mast_zenoh.report.comparison import Reference
from mast_zenoh.report.narrative.changes import join_names, plural
from mast_zenoh.runs.driven import reason_of
from mast_zenoh.runs.run import Run

#: m, of way, and s, of standing: a smaller difference between a run and its twin is not said.
_WAY_M, _STANDING_S = 1.0, 0.2
#: Brakes and collisions that are named; more are counted.
_MOST_NAMED = 3
#: Of further brakes, those of which strength and time are told.
_MOST_LISTED = 10
#: Cars that are described in full; of more, those that matter least are summed up.
_MOST_CARS = 3


def car_sentences(run: Run, reference: Reference | None = None) -> list[str]:
    """For each driven car, its collisions, its notable brakes and why, and how far it came; without full stops.

    Of more than _MOST_CARS cars, those other than the ego that hit nothing are summed up in one sentence.

    reference: the run that it is compared with, such as its unattacked twin
    """
    others: Mapping[str, Any] = reference.run.files.summary.get("driven", {}) if reference is not None else {}
    name = reference.name if reference is not None else ""
    cars: Mapping[str, Any] = run.files.summary.get("driven", {})
    full = list(cars)
    if len(full) > _MOST_CARS:
        notable = [car for car in cars if car == run.ego or cars[car]["collisions"]]
        full = sorted(notable, key=lambda car: car != run.ego)[:_MOST_CARS]
    sentences = []
    for car in full:
        happened, other = cars[car], others.get(car)
        subject = "The ego" if car == run.ego == "ego" else car
        texts = (*_collisions(happened), *_brakes(happened), _progress(happened, other, name))
        sentences += [f"{subject} {text}" for text in texts]
        if other is not None and len(other["collisions"]) != len(happened["collisions"]):
            sentences.append(f"{name}: {plural(len(other['collisions']), 'collision')}")
    if len(full) < len(cars):
        sentences.append(_sums([cars[car] for car in cars if car not in full], "other car" if full else "car"))
    return sentences


def _sums(cars: Sequence[Mapping[str, Any]], noun: str) -> str:
    """What happened to several cars together."""
    way = sum(happened["progress_m"] for happened in cars)
    needless = sum(happened["needless_brakes"] for happened in cars)
    hits = sum(len(happened["collisions"]) for happened in cars)
    drive, brake, hit = ("drives", "brakes", "hits") if len(cars) == 1 else ("drive", "brake", "hit")
    braking = f", {brake} needlessly {plural(needless, 'time')}" if needless else ""
    ending = f" and {hit} {plural(hits, 'object') if hits else 'nothing'}"
    return f"{plural(len(cars), noun)} {drive} {way:,.0f} m{braking}{ending}"


def _collisions(happened: Mapping[str, Any]) -> list[str]:
    """What the car hit."""
    hits = happened["collisions"]
    named = [
        f"object {hit['object']} in frame {hit['frame']} ({hit['speed_mps']:.1f} m/s between them"
        + (", hidden from its driver)" if hit["hidden"] else ")")
        for hit in hits
    ]
    return [f"hits {join_names(named, _MOST_NAMED)}"] if named else []


def _brakes(happened: Mapping[str, Any]) -> list[str]:
    """The brakes that are needless or due to an adversary, the hardest first."""
    notable = [brake for brake in happened["brakes"] if brake["needless"] or brake["cause"]["adversary"]]
    notable.sort(key=lambda brake: -brake["hardest_mps2"])
    texts: list[str] = []
    others: dict[tuple[str, str | None], list[str]] = defaultdict(list)
    for number, brake in enumerate(notable):
        how = "brakes needlessly" if brake["needless"] else "brakes"
        strength = f"{brake['hardest_mps2']:.1f} m/s² at {brake['from_s']:.1f} s"
        if number < _MOST_NAMED:
            texts.append(f"{how} with {strength} {reason_of(brake)}{_on_truth(brake)}")
        else:
            others[how, brake["cause"]["adversary"]].append(strength)
    for (how, adversary), strengths in others.items():
        because = f" because of {adversary}" if adversary else ""
        times = join_names(strengths, _MOST_LISTED)
        texts.append(f"{how} {plural(len(strengths), 'more time')}{because}: {times}")
    if missed := happened["missed_brakes"]:
        texts.append(f"fails to brake in {plural(missed, 'emergency').replace('ys', 'ies')}")
    return texts


def _on_truth(brake: Mapping[str, Any]) -> str:
    """What its driver does on the truth, if a needless brake is for what is there."""
    braking = brake.get("on_truth_mps2")
    tells = brake["needless"] and brake["cause"]["kind"] == "real" and isinstance(braking, float)
    return f", with {braking:.1f} m/s² had it known the truth" if tells else ""


def _progress(happened: Mapping[str, Any], other: Mapping[str, Any] | None, name: str) -> str:
    """How far the car came, and for how long it stood."""
    way, standing = happened["progress_m"], happened["standing_s"]
    if other is None:
        return f"drives {way:.0f} m and stands for {standing:.1f} s"
    before, stood = other["progress_m"], other["standing_s"]
    changed_way, changed_standing = abs(way - before) >= _WAY_M, abs(standing - stood) >= _STANDING_S
    far = f"drives {way:.0f} m" + (f" instead of {before:.0f} m" if changed_way else "")
    long = f" and stands for {standing:.1f} s instead of {stood:.1f} s" if changed_standing else ""
    return f"{far}{long} ({name})" if changed_way or changed_standing else f"{far}, as {name}"
