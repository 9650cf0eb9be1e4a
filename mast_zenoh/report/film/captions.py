"""What happens in a run, in words: the caption below a film."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping

from mast_zenoh.report.film.takes import Take
from mast_zenoh.report.playback import events
from mast_zenoh.report.playback.conduct import spans


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
    happened = events.happenings(take.run, spans(take.run, take.times), take.times)
    happened.sort(key=lambda each: (each.frame, each.kind != "interception", each.text))
    return [(max(each.frame, take.first), each.text) for each in happened if each.frame <= take.last]
