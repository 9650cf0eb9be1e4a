"""What one panel shows: an estimate of an agent in a run, frame by frame."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import ConfigurationError, RunFolderError, nearest
from mast_zenoh.report.figures.view import Boxes, FrameView, has_boxes, view_of
from mast_zenoh.report.files import Table, rows
from mast_zenoh.report.film.look import SHOWN, TRUTH
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.viewer.palette import OUTCOME_COLOURS

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


class Counts(NamedTuple):
    """Scores of an estimate in a frame; rmse_m: m, NaN without a pair."""

    missed: int
    false: int
    matched: int
    rmse_m: float


class Take:
    """An estimate of one agent of a run.

    run: as seen by the agent;  estimate: one of SHOWN;  title: of the panel;  times: (f,) s, of the frames
    Raises ConfigurationError for an estimate that the run does not have, RunFolderError for a run without boxes.
    """

    def __init__(self, run: RunFolder, estimate: str, title: str = "") -> None:
        if run.objects is None or not len(run.objects["frame"]):
            reasons = " ".join(run.missing) or "objects.parquet holds no boxes of this agent."
            raise RunFolderError(
                f"{run.path}: nothing to draw: {reasons} `mast report {run.path}` measures a recorded run that has none"
            )
        known = [name for name in SHOWN if (name == TRUTH and run.recording is not None) or has_boxes(run, name)]
        if estimate not in known:
            raise ConfigurationError(f"{run.path}: no estimate {estimate!r} of {run.ego}{nearest(estimate, known)}")
        frames = run.objects["frame"]
        self.first, self.last = int(frames.min()), int(frames.max())
        own = rows(run.objects, run.objects["estimator"] == run.original(estimate))
        self.run, self.estimate, self.title = replace(run, objects=own), estimate, title or TITLES[estimate]
        seconds = run.seconds(np.arange(self.last + 1))
        regular = np.arange(self.last + 1) * run.period_s
        self.times: Floats = np.asarray(regular if seconds is None else seconds, np.float64)
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

    def _view(self, frame: int) -> FrameView:
        """The boxes and manipulations of a frame."""
        view = view_of(self.run, frame, [self.estimate])
        recording = self.run.recording
        if self.estimate == TRUTH and recording is not None:
            truth = recording.truth_at(min(frame, len(recording) - 1))
            nothing = Boxes(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
            boxes = dict.fromkeys(OUTCOME_COLOURS, nothing)
            boxes["truth matched"] = Boxes(truth.position, truth.size, truth.yaw)
            view = replace(view, boxes={TRUTH: boxes})
        return view

    def agent_positions(self, frame: int) -> Floats:
        """(a, 2) m, where the agents are; none without a scene."""
        recording = self.run.recording
        if recording is None:
            return np.zeros((0, 2))
        return np.asarray(recording.agent_position[min(frame, len(recording) - 1), :, :2], np.float64)

    @cached_property
    def _counts(self) -> Table | None:
        table = self.run.counts_of(self.estimate)
        return self.run.counts_of(self.run.original(self.estimate)) if table is None else table

    def counts(self, frame: int) -> Counts | None:
        """The scores of a frame; None: it has none."""
        table = self._counts
        row = -1 if table is None else int(np.searchsorted(table["frame"], frame))
        if table is None or row >= len(table["frame"]) or table["frame"][row] != frame:
            return None
        missed, false, matched = (int(table[name][row]) for name in ("fn", "fp", "tp"))
        return Counts(missed, false, matched, float(table["rmse_m"][row]))

    def series(self) -> tuple[Floats, Floats, Floats] | None:
        """(times (n,) s, missed (n,), false (n,)) of all scored frames; None: there are none."""
        table = self._counts
        if table is None:
            return None
        times = self.times[np.minimum(table["frame"].astype(np.int64), self.last)]
        missed, false = (table[name].astype(np.float64) for name in ("fn", "fp"))
        return times, missed, false
