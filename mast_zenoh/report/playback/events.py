"""The events of a run in words, for the list of the page and the captions of films."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.report.files import rows
from mast_zenoh.report.playback.boxes import BoxTable
from mast_zenoh.report.playback.conduct import node_absences
from mast_zenoh.report.runfolder import RunFolder

#: Manipulations with a place, as verbs.
_VERBS = {"inserted": "inserts", "removed": "removes", "moved": "moves"}


class Event(NamedTuple):
    """Something that happened.

    frame: when;  kind: attack, fault, interception, suspension or effect;  text: in words
    x, y:  m, where, if it has a place
    """

    frame: int
    kind: str
    text: str
    x: float | None = None
    y: float | None = None


def events(run: RunFolder, boxes: BoxTable, periods: list[dict[str, Any]], times: Floats) -> list[dict[str, Any]]:
    """All events, the earliest first.

    periods: from `conduct.spans`;  times: (f,) s, of the frames
    """
    everything = [*happenings(run, periods, times), *_first_changes(run), *_first_successes(run, boxes)]
    inside = [each for each in dict.fromkeys(everything) if 0 <= each.frame < len(times)]
    inside.sort(key=lambda each: (each.frame, each.kind, each.text))
    return [{name: value for name, value in each._asdict().items() if value is not None} for each in inside]


def happenings(run: RunFolder, periods: list[dict[str, Any]], times: Floats) -> list[Event]:
    """Beginnings and ends of periods and of nodes' absences, in any order; periods, times: as for `events`."""
    result = []
    for each in periods:
        for at, words in ((each["from_s"], each["begins"]), (each["until_s"], each["ends"])):
            frame = int(np.searchsorted(times, at - 1e-6))
            if words and frame < len(times):
                result.append(Event(frame, each["kind"], words))
    for node, start, end in node_absences(run):
        result.append(Event(int(start), "fault", f"{node} is down"))
        if end < len(times):
            result.append(Event(int(end), "fault", f"{node} is back"))
    return result


def _first_changes(run: RunFolder) -> list[Event]:
    """The first manipulation of each kind by each adversary."""
    table, result = run.attacks, []
    if table is None:
        return []
    for name in np.unique(table["interposer"].astype(str)).tolist():
        for effect in np.unique(table["effect"][table["interposer"] == name].astype(str)).tolist():
            own = rows(table, (table["interposer"] == name) & (table["effect"] == effect))
            first = int(np.argmin(own["frame"]))
            when = "before" if effect == "removed" else "after"
            x, y = (float(own[f"{when}_{axis}"][first]) for axis in "xy")
            place = (round(x, 2), round(y, 2)) if effect in _VERBS and np.isfinite([x, y]).all() else (None, None)
            action = (
                f"{_VERBS[effect]} its first object" if effect in _VERBS else f"changes its first message ({effect})"
            )
            result.append(Event(int(own["frame"][first]), "effect", f"{name} {action}", *place))
    return result


def _first_successes(run: RunFolder, boxes: BoxTable) -> list[Event]:
    """The first error of each kind in the ego's copy of the picture that is due to each adversary."""
    result = []
    for estimate, words in (("picture", "the picture"), ("mission", f"{run.ego} with the picture")):
        row = next((i for i, view in enumerate(boxes.views) if view == (run.ego, estimate)), None)
        if row is None:
            continue
        for number, meaning in enumerate(boxes.meanings, 1):
            if not meaning.by or meaning.outcome not in ("false", "missed"):
                continue
            places = np.flatnonzero((boxes.codes[row] == number) & (boxes.truth == (meaning.outcome == "missed")))
            if not len(places):
                continue
            first = places[np.argmin(boxes.frame[places])]
            what = "shows a false object" if meaning.outcome == "false" else "misses an object"
            text = f"{words} {what} because of {meaning.by} ({meaning.cause})"
            x, y = (round(float(value), 2) for value in boxes.geometry[first, :2])
            result.append(Event(int(boxes.frame[first]), "effect", text, x, y))
    return result
