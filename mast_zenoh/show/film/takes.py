"""What one panel shows: an estimate of an agent in a run, frame by frame, with attacks and captions.

What a film or still shows and how it looks: options as users write them, checked.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_right
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from mast_zenoh.errors import ConfigurationError, RunFolderError, nearest
from mast_zenoh.metrics.estimates import ESTIMATES, TRUTH
from mast_zenoh.run_folder.finding import Finding
from mast_zenoh.runs import events
from mast_zenoh.runs.driven import braking_events
from mast_zenoh.runs.evaluated import Score
from mast_zenoh.runs.events import spans
from mast_zenoh.runs.files import rows
from mast_zenoh.runs.frame import Frame, frame_at, has_boxes
from mast_zenoh.runs.interposers import attacked_at, interposers
from mast_zenoh.runs.run import Run
from mast_zenoh.show.figures.style import THEMES, Theme

#: What panels are titled.
TITLES = {
    "local": "own tracks",
    "received": "own tracks, as received",
    "picture": "the common picture",
    "picture_received": "the picture as received",
    "picture_on_arrival": "the picture on arrival",
    "mission": "own tracks and picture",
    TRUTH: "all objects of the scene",
}


class Take:
    """An estimate of one agent of a run.

    run: as seen by the agent;  estimate: one of SHOWN;  title: of the panel, with the name of a run of several
    times: (f,) s, of the frames
    Raises ConfigurationError for an estimate that the run does not have, RunFolderError for a run without boxes.
    """

    def __init__(self, run: Run, estimate: str, name: str = "") -> None:
        if run.files.objects is None or not len(run.files.objects["frame"]):
            reasons = " ".join(run.files.missing) or "objects.parquet holds no boxes of this agent."
            raise RunFolderError(
                f"{run.path}: nothing to draw: {reasons} `mast report {run.path}` measures a recorded run that has none"
            )
        known = [name for name in SHOWN if (name == TRUTH and run.files.scene is not None) or has_boxes(run, name)]
        if estimate not in known:
            raise ConfigurationError(f"{run.path}: no estimate {estimate!r} of {run.ego}{nearest(estimate, known)}")
        frames = run.files.objects["frame"]
        if run.files.sample.step > 1 and run.files.counts is not None:  # boxes of all frames are read later
            frames = run.files.counts["frame"]
        self.first, self.last = int(frames.min()), int(frames.max())
        own = rows(run.files.objects, run.files.objects["estimator"] == run.original(estimate))
        self.run, self.estimate = run.with_(objects=own), estimate
        self.title = (f"{name}: " if name else "") + run.worded(TITLES[estimate])
        self.times = run.times(np.arange(self.last + 1))
        # A film asks for the frames again and again: to choose its window and colours, and to draw.
        self.view = lru_cache(maxsize=4096)(self._view)

    def seconds(self, frame: int) -> float:
        """Time of a frame, s since the first."""
        return float(self.times[min(frame, self.last)])

    def frame_at(self, seconds: float) -> int:
        """The frame at a time, or else the first or last."""
        frame = int(np.searchsorted(self.times, seconds + self.run.period_s / 2, side="right")) - 1
        return min(max(frame, self.first), self.last)

    def ended(self, seconds: float) -> bool:
        """Whether the run is over at a time."""
        return seconds > float(self.times[-1]) + self.run.period_s / 2

    def _view(self, frame: int) -> Frame:
        """The boxes and manipulations of a frame."""
        return frame_at(self.run.around(frame), frame, [self.estimate])

    @cached_property
    def attacks(self) -> Attacks:
        """The attacks of the run."""
        return Attacks(self.run)

    @cached_property
    def scores(self) -> dict[int, Score]:
        """By frame."""
        counts = self.run.counts_of(self.estimate) or self.run.counts_of(self.run.original(self.estimate))
        return {frame: Score.of(counts, row) for row, frame in enumerate(counts["frame"].tolist())} if counts else {}


#: s: an attack that changes nothing for so long is over.
_PAUSE_S = 1.0


class Attacks:
    """The attacks of a run.

    spans: first frame and the frame after the last of each period with changes by adversaries
    """

    def __init__(self, run: Run) -> None:
        self._effects = run.manipulations
        frames = np.unique([] if self._effects is None else self._effects["frame"])
        parts = np.split(frames, np.flatnonzero(np.diff(frames) * run.period_s > _PAUSE_S) + 1)
        self.spans = [(int(part[0]), int(part[-1]) + 1) for part in parts if len(part)]
        self._interposers = interposers(run)

    def on(self, frame: int) -> bool:
        """Whether an attack is on in a frame."""
        return any(start <= frame < end for start, end in self.spans)

    @property
    def possible(self) -> bool:
        """Whether any adversary is ever on a wire."""
        return not all(each.is_link for each in self._interposers)

    def at(self, frame: int) -> Finding:
        """What is done in a frame."""
        if self._effects is None:
            return Finding("attacked", what="not measured" if self.possible else "off")
        if not self.on(frame):
            return Finding("attacked", tuple(sorted(attacked_at(self._interposers, frame))), "off")
        here = rows(self._effects, self._effects["frame"] == frame)
        effect, names = here["effect"].astype(str), tuple(sorted(set(here["interposer"].astype(str).tolist())))
        scans = (effect == "reframed") & (here["message"] == "points")
        did = [Finding("effect", what=what, value=n) for what, n in sorted(Counter(effect[~scans].tolist()).items())]
        changed = (here["points"] > 0) if "points" in here else np.zeros(len(effect), bool)
        for what in np.unique(effect[changed]).tolist():
            number = int(here["points"][changed & (effect == what)].sum())
            did.append(Finding("effect", what=what, value=number, unit="points"))
        if scans.any() and not changed.any():
            did.append(Finding("effect", what="changed", value=int(scans.sum()), unit="scans"))
        return Finding("attacked", names, "on", parts=tuple(did))


class Captions:
    """The caption of every frame of a film.

    takes: one for each run
    own:   the user's captions by frame, each in place of the run's of this frame alone
    """

    def __init__(self, takes: list[Take], own: Mapping[int, str]) -> None:
        texts: dict[int, list[str]] = {}
        for take in takes:
            label = f" ({take.run.name})" if len(takes) > 1 else ""
            for frame, text in caption_events(take):
                shown = takes[0].frame_at(take.seconds(frame))
                texts.setdefault(shown, []).append(text + label)
        merged = {frame: "; ".join(dict.fromkeys(each)) for frame, each in texts.items()} | dict(own)
        self._frames = sorted(merged)
        self._texts = [f"frame {frame}: {merged[frame]}" for frame in self._frames]

    def at(self, frame: int) -> str:
        """The newest caption up to a frame; empty: nothing has happened."""
        place = bisect_right(self._frames, frame)
        return self._texts[place - 1] if place else ""


def caption_events(take: Take) -> list[tuple[int, str]]:
    """(frame, words) of interceptions, attacks, faults, absences, states of trust and brakes, the earliest first."""
    # A caption is one line: it has no room for the reasons.
    periods = [
        period | {"begins": period["label"]} if period["kind"] == "undecided" else period
        for period in spans(take.run, take.times)
    ]
    happened = events.happenings(take.run, periods, take.times) + braking_events(take.run, take.times, brief=True)
    happened.sort(key=lambda each: (each.frame, each.kind != "interception", each.text))
    return [(max(each.frame, take.first), each.text) for each in happened if each.frame <= take.last]


#: What panels can show.
SHOWN = (*ESTIMATES, TRUTH)
#: px, default widths and heights by number of panels, one or two, without camera views.
_SIZES = {1: (800, 760), 2: (1280, 760)}
_PER_INCH = {"in": 1.0, "cm": 2.54, "mm": 25.4}
_LEAST_PX, _MOST_PX = 240, 8192


class WindowChoice(NamedTuple):
    """Which part of the scene a panel shows.

    follow: keep the agent in the middle;  centre: m, of a fixed window, None: what matters
    half: m, half of the shorter side, None: what matters
    """

    follow: bool = False
    centre: tuple[float, float] | None = None
    half: float | None = None


@dataclass(frozen=True)
class Look:
    """Options of `mast animate` and `mast snapshot` (docs/how-to-export.md#films-and-figures).

    agent:     whose estimates are shown; None: the main agent
    estimates: one or two of SHOWN, side by side; None: what the agent's driver believes, without one the picture
    camera:    with the agent's camera view below each bird's-eye view
    window:    `fit`, `follow`, `follow:HALF` or `X,Y,HALF`, m
    theme:     dark or light
    size:      `WIDTHxHEIGHT` with px (the default), in, cm or mm; None: depends on the number of panels
    dpi:       pixels per inch; text has a fixed size in points, so more dpi means larger text in a film of one size
    plain:     panels and legend alone: no title, numbers, strips or caption
    title:     in place of the run's name and the agent
    captions:  `FRAME:TEXT`, in place of the run's own caption of this frame; shown until the next caption, of the run
               or of the user
    """

    agent: str | None = None
    estimates: Sequence[str] | None = None
    camera: bool = False
    window: str = "fit"
    theme: str = "dark"
    size: str | None = None
    dpi: int = 100
    plain: bool = False
    title: str | None = None
    captions: Sequence[str] = ()

    def check(self, panels: int) -> None:
        """Raise ConfigurationError for an invalid option; panels: their number."""
        for estimate in self.estimates or ():
            if estimate not in SHOWN:
                raise ConfigurationError(f"unknown estimate {estimate!r}: expected one of {', '.join(SHOWN)}"
                                         f"{_similar(estimate, SHOWN)}")  # fmt: skip
        if panels not in _SIZES:
            raise ConfigurationError(f"found {panels} panels, expected one or two: mast view shows three")
        if self.theme not in THEMES:
            raise ConfigurationError(f"unknown theme {self.theme!r}: expected one of {', '.join(THEMES)}")
        if not 20 <= self.dpi <= 1200:
            raise ConfigurationError(f"dpi: found {self.dpi}, expected 20 to 1200 pixels per inch")
        self.window_choice()
        self.pixels(panels)
        self.own_captions()

    @property
    def colours(self) -> Theme:
        """The theme."""
        return THEMES[self.theme]

    def pixels(self, panels: int) -> tuple[int, int]:
        """Width and height in px, both even, as video encoders need them; raises ConfigurationError."""
        if self.size is None:
            width, height = _SIZES[panels]
            return width, height + (int(width / panels * 0.25) // 2 * 2 if self.camera else 0)
        match = re.fullmatch(r"(\d+(?:\.\d+)?)x(\d+(?:\.\d+)?)(px|in|cm|mm)?", self.size.strip())
        if match is None:
            raise ConfigurationError(f"size: found {self.size!r}, expected WIDTHxHEIGHT, such as 1280x720 or 18x10cm")
        pixels = self.dpi / _PER_INCH[match[3]] if match[3] in _PER_INCH else 1.0
        width, height = (2 * round(float(length) * pixels / 2) for length in match.group(1, 2))
        if min(width, height) < _LEAST_PX or max(width, height) > _MOST_PX:
            raise ConfigurationError(
                f"size: found {self.size!r}, which is {width} by {height} px at {self.dpi} dpi: "
                f"expected {_LEAST_PX} to {_MOST_PX} px"
            )
        return width, height

    def window_choice(self) -> WindowChoice:
        """The window; raises ConfigurationError."""
        kind, _, half = self.window.partition(":")
        follow = kind == "follow"
        if self.window in ("fit", "follow"):
            return WindowChoice(follow)
        with suppress(ValueError):
            x, y, reach = (0.0, 0.0, float(half)) if follow else map(float, self.window.split(","))
            if math.isfinite(x + y + reach) and reach > 0:
                return WindowChoice(follow, None if follow else (x, y), reach)
        raise ConfigurationError(
            f"window: found {self.window!r}, expected fit, follow, follow:HALF or X,Y,HALF with HALF above 0, in m"
        )

    def own_captions(self) -> dict[int, str]:
        """The user's captions by frame; raises ConfigurationError."""
        result = {}
        for caption in self.captions:
            frame, separator, text = caption.partition(":")
            if not separator or not frame.strip().isdecimal():
                raise ConfigurationError(f"caption: found {caption!r}, expected FRAME:TEXT, such as 60:here it begins")
            result[int(frame)] = text.strip()
        return result


def _similar(name: str, known: Sequence[str]) -> str:
    hint = nearest(name, known)
    return hint if "did you mean" in hint else ""
