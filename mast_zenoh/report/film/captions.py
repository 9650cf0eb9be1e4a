"""What happens in a run, in words: the caption below a film."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping

import numpy as np

from mast_zenoh.report.film.takes import Take
from mast_zenoh.report.playback.conduct import node_absences
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.trust_facts import suspensions


class Captions:
    """The caption of every frame of a film.

    takes: one for each run
    own:   the user's captions by frame, each in place of the run's of this frame alone
    """

    def __init__(self, takes: list[Take], own: Mapping[int, str]) -> None:
        texts: dict[int, list[str]] = {}
        for take in takes:
            label = f" ({take.run.label})" if len(takes) > 1 else ""
            for frame, text in happenings(take):
                shown = takes[0].frame_at(take.seconds(frame))
                texts.setdefault(shown, []).append(text + label)
        merged = {frame: "; ".join(dict.fromkeys(each)) for frame, each in texts.items()} | dict(own)
        self._frames = sorted(merged)
        self._texts = [f"frame {frame}: {merged[frame]}" for frame in self._frames]

    def at(self, frame: int) -> str:
        """The newest caption up to a frame; empty: nothing has happened."""
        place = bisect_right(self._frames, frame)
        return self._texts[place - 1] if place else ""


def happenings(take: Take) -> list[tuple[int, str]]:
    """(frame, words) of interceptions, attacks, faults, absences and suspensions, the earliest first."""
    run = take.run
    found = [*_interceptions(run), *_timeline(take)]
    for node, start, end in node_absences(run):
        found.append((int(start), f"{node} is down"))
        if np.isfinite(end):
            found.append((int(end), f"{node} is back"))
    for each in suspensions(run):
        found.append((take.frame_at(float(each["from_s"])), f"the command centre suspends {each['agent']}"))
        if each["until_s"] is not None and not take.ended(float(each["until_s"])):
            found.append((take.frame_at(float(each["until_s"])), f"the suspension of {each['agent']} is lifted"))
    inside = [(max(frame, take.first), text) for frame, text in found if frame <= take.last]
    return sorted(inside, key=lambda each: each[0])


def _interceptions(run: RunFolder) -> list[tuple[int, str]]:
    verbs = {"intercept": "inserted on", "release": "released from", "heal": "cut off from"}
    return [
        (int(each["frame"]), f"{each['node']} {verbs[each['action']]} {', '.join(each['wires'])}")
        for each in run.run.get("interceptions", ())
        if each["action"] in verbs
    ]


def _timeline(take: Take) -> list[tuple[int, str]]:
    """Planned attacks and faults."""
    result = []
    for each in take.run.timeline:
        attack = each["kind"] == "attack"
        if not take.ended(float(each["at_s"])):
            result.append((take.frame_at(float(each["at_s"])), f"{each['label']} begins"))
        until = each.get("until_s")
        if until is not None and not take.ended(float(until)):
            result.append((take.frame_at(float(until)), f"{each['label']} {'ends' if attack else 'heals'}"))
    return result
