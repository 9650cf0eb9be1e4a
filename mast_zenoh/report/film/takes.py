"""What one panel shows: an estimate of an agent in a run, frame by frame, and which part of the scene."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import ConfigurationError, RunFolderError, nearest
from mast_zenoh.metrics.estimates import TRUTH
from mast_zenoh.report.film.look import SHOWN, WindowChoice
from mast_zenoh.runs import events
from mast_zenoh.runs.driven import braking_events
from mast_zenoh.runs.evaluated import Score
from mast_zenoh.runs.events import spans
from mast_zenoh.runs.files import Table, rows
from mast_zenoh.runs.frame import Frame, ego_position, frame_at, has_boxes
from mast_zenoh.runs.interposers import interposers
from mast_zenoh.runs.run import Run

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


#: Frames of a long run whose boxes are in memory.
_WINDOW = 250


class Take:
    """An estimate of one agent of a run.

    run: as seen by the agent;  estimate: one of SHOWN;  title: of the panel;  times: (f,) s, of the frames
    Raises ConfigurationError for an estimate that the run does not have, RunFolderError for a run without boxes.
    """

    def __init__(self, run: Run, estimate: str, title: str = "") -> None:
        if run.files.objects is None or not len(run.files.objects["frame"]):
            reasons = " ".join(run.files.missing) or "objects.parquet holds no boxes of this agent."
            raise RunFolderError(
                f"{run.path}: nothing to draw: {reasons} `mast report {run.path}` measures a recorded run that has none"
            )
        known = [name for name in SHOWN if (name == TRUTH and run.files.scene is not None) or has_boxes(run, name)]
        if estimate not in known:
            raise ConfigurationError(f"{run.path}: no estimate {estimate!r} of {run.ego}{nearest(estimate, known)}")
        frames = run.files.objects["frame"]
        if (
            run.files.sample.step > 1 and run.files.counts is not None
        ):  # there are boxes of all frames, which are read later
            frames = run.files.counts["frame"]
        self.first, self.last = int(frames.min()), int(frames.max())
        self.run, self.estimate = self._own(run, estimate), estimate
        self.title = title or run.worded(TITLES[estimate])
        self.times = run.times(np.arange(self.last + 1))
        # A film asks for the frames again and again: to choose its window and colours, and to draw.
        self.view = lru_cache(maxsize=4096)(self._view)
        self._window = lru_cache(maxsize=2)(
            lambda place: self._own(run.within(place * _WINDOW, (place + 1) * _WINDOW), estimate)
        )

    def _own(self, run: Run, estimate: str) -> Run:
        """A run with the boxes of one estimate alone."""
        objects = run.files.objects and rows(
            run.files.objects, run.files.objects["estimator"] == run.original(estimate)
        )
        return run.with_(objects=objects)

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
        run = self.run if self.run.files.sample.step == 1 else self._window(frame // _WINDOW)
        return frame_at(run, frame, [self.estimate])

    def agent_positions(self, frame: int) -> Floats:
        """(a, 2) m, where the agents are; none without a scene."""
        recording = self.run.files.scene
        if recording is None:
            return np.zeros((0, 2))
        return np.asarray(recording.agent_position[min(frame, len(recording) - 1), :, :2], np.float64)

    @cached_property
    def _counts(self) -> Table | None:
        table = self.run.counts_of(self.estimate)
        return self.run.counts_of(self.run.original(self.estimate)) if table is None else table

    def score(self, frame: int) -> Score | None:
        """The scores of a frame; None: it has none."""
        table = self._counts
        row = -1 if table is None else int(np.searchsorted(table["frame"], frame))
        if table is None or row >= len(table["frame"]) or table["frame"][row] != frame:
            return None
        return Score.of(table, row)

    def series(self) -> tuple[Floats, Floats, Floats] | None:
        """(times (n,) s, missed (n,), false (n,)) of all scored frames; None: there are none."""
        table = self._counts
        if table is None:
            return None
        times = self.times[np.minimum(table["frame"].astype(np.int64), self.last)]
        missed, false = (table[name].astype(np.float64) for name in ("fn", "fp"))
        return times, missed, false


#: s: an attack that changes nothing for so long is over.
_PAUSE_S = 1.0
#: Adversaries or agents that are named; more are counted.
_NAMED = 2


class Attacks:
    """The attacks of a run.

    spans: first frame and the frame after the last of each period with changes by adversaries
    """

    def __init__(self, run: Run) -> None:
        self._effects = run.manipulations
        frames = (
            np.unique(run.manipulations["frame"]).astype(np.int64)
            if run.manipulations is not None
            else np.zeros(0, np.int64)
        )
        breaks = np.flatnonzero(np.diff(frames) * run.period_s > _PAUSE_S)
        parts = np.split(frames, breaks + 1) if len(frames) else []
        self.spans = [(int(part[0]), int(part[-1]) + 1) for part in parts]
        self._interposers = [each for each in interposers(run) if not each.is_link]

    def on(self, frame: int) -> bool:
        """Whether an attack is on in a frame."""
        return any(start <= frame < end for start, end in self.spans)

    def attacked(self, frame: int) -> set[str]:
        """The agents on whose wires an adversary sits in a frame."""
        present = [
            each
            for each in self._interposers
            if (each.live is None or each.live <= frame) and (each.released is None or frame < each.released)
        ]
        return {agent for each in present for agent in (*each.agents, *each.before)}

    @property
    def possible(self) -> bool:
        """Whether any adversary is ever on a wire."""
        return bool(self._interposers)

    def sentence(self, frame: int) -> str:
        """What is done in a frame, in words."""
        if self._effects is None:
            return "attacks were not measured" if self.possible else "no attack"
        if not self.on(frame):
            waiting = self.attacked(frame)
            return (
                f"no attack; adversary on the wires of {_names(sorted(waiting), 'agents')}" if waiting else "no attack"
            )
        here = rows(self._effects, self._effects["frame"] == frame)
        changes = Counter(here["effect"].astype(str).tolist())
        names = sorted(set(here["interposer"].astype(str).tolist()))
        what = ", ".join(f"{count} {effect}" for effect, count in sorted(changes.items()))
        return f"attack by {_names(names, 'adversaries')}: {what}" if names else "attack: nothing changed in this frame"


def _names(names: list[str], noun: str) -> str:
    return ", ".join(names) if len(names) <= _NAMED else f"{len(names)} {noun}"


class Captions:
    """The caption of every frame of a film.

    takes: one for each run
    own:   the user's captions by frame, each in place of the run's of this frame alone
    """

    def __init__(self, takes: list[Take], own: Mapping[int, str]) -> None:
        texts: dict[int, list[str]] = {}
        for take in takes:
            label = f" ({take.run.name})" if len(takes) > 1 else ""
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
    """(frame, words) of interceptions, attacks, faults, absences, states of trust and brakes, the earliest first."""
    # A caption is one line: it has no room for the reasons.
    periods = [
        period | {"begins": period["label"]} if period["kind"] == "undecided" else period
        for period in spans(take.run, take.times)
    ]
    happened = events.happenings(take.run, periods, take.times) + braking_events(take.run, take.times, reasons=False)
    happened.sort(key=lambda each: (each.frame, each.kind != "interception", each.text))
    return [(max(each.frame, take.first), each.text) for each in happened if each.frame <= take.last]


#: m: agents and objects farther than this from the agent do not matter.
_MATTERS_M = 105.0
#: Share of the objects on either side that may lie outside.
_OUTLIERS = 0.04
#: m: free space around what matters; half of the shorter side, at least.
_MARGIN_M, _LEAST_HALF_M = 8.0, 20.0


class Window(NamedTuple):
    """A rectangle of the scene, m. x, y: its centre;  across, up: half of its width and height"""

    x: float
    y: float
    across: float
    up: float

    @property
    def half(self) -> float:
        """m, half of the shorter side."""
        return min(self.across, self.up)

    @property
    def corners(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """m, the lower left corner and the upper right one."""
        return (self.x - self.across, self.y - self.up), (self.x + self.across, self.y + self.up)

    def contains(self, position: Floats) -> bool:
        """Whether a position (2,) or (3,) m is inside."""
        return bool(abs(position[0] - self.x) <= self.across and abs(position[1] - self.y) <= self.up)


@dataclass(frozen=True)
class Framing:
    """The window of every frame; the same size in all of them.

    fixed:  in the middle of the film's window, or relative to the followed agent
    follow: the take whose agent is followed
    """

    fixed: Window
    follow: Take | None = None

    def window(self, frame: int) -> Window:
        """The window in a frame."""
        at = None if self.follow is None else ego_position(self.follow.run, frame)
        return self.fixed if at is None else self.fixed._replace(x=float(at[0]), y=float(at[1]))


def framing(choice: WindowChoice, takes: Sequence[Take], frames: Sequence[int], aspect: float) -> Framing:
    """The window that a user chose for panels of one shape.

    frames: of the first take, all that the film shows;  aspect: width by height of a panel
    """
    across, up = (aspect, 1.0) if aspect >= 1.0 else (1.0, 1.0 / aspect)
    if choice.centre is not None and choice.half is not None:
        return Framing(Window(*choice.centre, choice.half * across, choice.half * up))
    always, mostly = _places(takes, frames, relative=choice.follow)
    if choice.follow:
        sides = np.array([_limits(np.abs(always[:, axis]), np.abs(mostly[:, axis]))[1] for axis in (0, 1)])
        middle = np.zeros(2)
    else:
        limits = np.array([_limits(always[:, axis], mostly[:, axis]) for axis in (0, 1)])
        middle, sides = limits.mean(axis=1), np.diff(limits, axis=1)[:, 0] / 2
    needed = (sides + _MARGIN_M) / [across, up]
    half = choice.half or max(float(needed.max()), _LEAST_HALF_M)
    fixed = Window(float(middle[0]), float(middle[1]), half * across, half * up)
    return Framing(fixed, takes[0] if choice.follow else None)


def _places(takes: Sequence[Take], frames: Sequence[int], *, relative: bool) -> tuple[Floats, Floats]:
    """(a, 2) m, where agents are, and (n, 2) m, where boxes and manipulations are; of those that matter.

    relative: to the agent
    """
    always, mostly = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for take in takes:
        for frame in frames:
            shown = take.frame_at(takes[0].seconds(frame))
            own = ego_position(take.run, shown)
            view = take.view(shown)
            marks = view.marks(take.estimate)
            boxes = [each.position[:, :2] for each in view.boxes[take.estimate].values()]
            for places, result in (
                (take.agent_positions(shown), always),
                (np.concatenate([*boxes, marks.added[:, :2], marks.removed[:, :2]]), mostly),
            ):
                if own is not None:
                    places = places[np.hypot(*(places - own[:2]).T) <= _MATTERS_M]
                result.append(places - own[:2] if relative and own is not None else places)
    return np.concatenate(always), np.concatenate(mostly)


def _limits(always: Floats, mostly: Floats) -> tuple[float, float]:
    """Between which all of `always` are, and all but few of `mostly`; (0, 0) without any."""
    ordered = np.sort(mostly)
    cut = int(len(ordered) * _OUTLIERS)
    inner = np.concatenate([always, ordered[cut : len(ordered) - cut]])
    return (float(inner.min()), float(inner.max())) if len(inner) else (0.0, 0.0)
