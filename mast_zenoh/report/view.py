"""What the pictures of one frame show: the ego's boxes by outcome, and what the adversaries did in that frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mast_zenoh.errors import RunFolderError
from mast_zenoh.report.runfolder import RunFolder, rows
from mast_zenoh.report.style import OUTCOME_COLOURS
from mast_zenoh.states import Bools, Floats, Ints

#: Metres around the ego within which pictures look for something to show.
_REACH = 105.0


@dataclass(frozen=True, eq=False)
class Boxes:
    """n upright boxes, world frame: position (n, 3) m of the centre, size (n, 3) m l w h, yaw (n,) rad."""

    position: Floats
    size: Floats
    yaw: Floats

    def __len__(self) -> int:
        return len(self.yaw)


@dataclass(frozen=True, eq=False)
class FrameView:
    """One frame of one run in the ego's eyes.

    boxes:   by estimator (`local`, `picture`), then by outcome (the keys of OUTCOME_COLOURS)
    added:   (n, 3) m, where adversaries inserted an object
    removed: (n, 3) m, where they took one away
    moved:   (n, 2, 3) m, from where to where they moved one
    """

    run: RunFolder
    frame: int
    boxes: dict[str, dict[str, Boxes]]
    added: Floats
    removed: Floats
    moved: Floats

    @property
    def time_label(self) -> str:
        """`t = 7.3 s (frame 73)`, or the frame alone where the scene is absent."""
        seconds = self.run.seconds(np.array([self.frame]))
        return f"frame {self.frame}" if seconds is None else f"t = {seconds[0]:.1f} s (frame {self.frame})"


def frame_view(run: RunFolder, frame: int) -> FrameView | None:
    """What there is to see in a frame; None when the run left no objects of that frame."""
    if run.objects is None or not np.any(run.objects["frame"] == frame):
        return None
    table = rows(run.objects, run.objects["frame"] == frame)
    boxes: dict[str, dict[str, Boxes]] = {}
    for estimator in ("local", "picture"):
        boxes[estimator] = {}
        for outcome in OUTCOME_COLOURS:
            kind, _, result = outcome.rpartition(" ")
            mask = (table["estimator"] == estimator) & (table["outcome"] == result)
            if kind:
                mask &= table["kind"] == kind
            some = rows(table, mask)
            boxes[estimator][outcome] = Boxes(
                np.stack([some["x"], some["y"], some["z"]], axis=1).astype(np.float64),
                np.stack([some["l"], some["w"], some["h"]], axis=1).astype(np.float64),
                some["yaw"].astype(np.float64),
            )
    attacks = run.attacks

    def places(effect: str, when: str) -> Floats:
        if attacks is None:
            return np.zeros((0, 3))
        some = rows(attacks, (attacks["frame"] == frame) & (attacks["effect"] == effect))
        return np.stack([some[f"{when}_{axis}"] for axis in "xyz"], axis=1).astype(np.float64)

    moved = np.stack([places("moved", "before"), places("moved", "after")], axis=1)
    return FrameView(run, frame, boxes, places("inserted", "after"), places("removed", "before"), moved)


def ego_position(run: RunFolder, frame: int) -> Floats | None:
    """(3,) m, where the ego is; None: the scene is absent or the frame is not in it."""
    if run.recording is None or run.ego not in run.recording.agent_names or not 0 <= frame < len(run.recording):
        return None
    return np.asarray(run.recording.agent_position[frame, run.recording.agent_names.index(run.ego)], np.float64)


def window(views: Sequence[FrameView]) -> tuple[float, float, float]:
    """(x, y, half the width) in m of one square that shows what all `views` have near their ego."""
    seen = [
        boxes.position[:, :2] for view in views for of in view.boxes.values() for boxes in of.values() if len(boxes)
    ]
    ego = ego_position(views[0].run, views[0].frame)
    recording = views[0].run.recording
    if recording is not None and views[0].frame < len(recording):
        seen.append(recording.agent_position[views[0].frame, :, :2])
    points = np.concatenate([*seen, np.zeros((0, 2))])
    centre = ego[:2] if ego is not None else points.mean(axis=0)
    points = points[np.hypot(*(points - centre).T) <= _REACH]
    if not len(points):
        return float(centre[0]), float(centre[1]), 50.0
    low, high = points.min(axis=0), points.max(axis=0)
    middle = (low + high) / 2
    half = max(float((high - low).max()) / 2 + 7.0, 40.0)
    return float(middle[0]), float(middle[1]), half


def clipped(view: FrameView, window: tuple[float, float, float]) -> FrameView:
    """The view without the adversaries' doings outside a window."""
    x, y, half = window

    def inside(places: Floats) -> Bools:
        return np.asarray(np.abs(places[..., :2] - [x, y]).max(axis=-1) <= half)

    moved = view.moved[inside(view.moved).any(axis=-1)]
    added, removed = view.added[inside(view.added)], view.removed[inside(view.removed)]
    return replace(view, added=added, removed=removed, moved=moved)


def _errors(run: RunFolder, estimator: str) -> tuple[Ints, Floats] | None:
    """Frames (n,) and the ego's FN + FP (n,) in each of them."""
    counts = run.counts_of(estimator)
    if counts is None:
        return None
    return counts["frame"].astype(np.int64), np.asarray(counts["fn"] + counts["fp"], np.float64)


def choose_frame(run: RunFolder, baseline: RunFolder | None = None) -> int | None:
    """The frame to show, by rule; None when the run left no counts.

    Where an adversary changed something: among the frames since its first change, the one with the most FN + FP
    in the ego's picture, less those of `baseline` in the same frame if it is given; the earliest of equals. Where
    nobody did: the frame in which the picture spares the ego the most errors (FN + FP of its own tracks less those
    of the picture).
    """
    picture = _errors(run, "picture")
    if picture is None:
        return None
    frames, effect = picture
    if run.attack_frames is not None:
        other = _errors(baseline, "picture") if baseline is not None else None
        sign, since = 1.0, run.attack_frames[0]
    else:
        other, sign, since = _errors(run, "local"), -1.0, int(frames[0])
    if other is not None:
        _, here, there = np.intersect1d(frames, other[0], return_indices=True)
        frames, effect = frames[here], effect[here] - other[1][there]
    eligible = frames >= since
    if not eligible.any():
        return int(frames[-1]) if len(frames) else None
    return int(frames[eligible][np.argmax(sign * effect[eligible])])


def choose_common_frame(runs: Sequence[RunFolder], baseline: RunFolder) -> int | None:
    """The one frame to show of several runs: that of `choose_frame` for the run which differs most from `baseline`."""
    best: tuple[float, int] | None = None
    ours = _errors(baseline, "picture")
    for run in runs:
        frame, errors = choose_frame(run, baseline), _errors(run, "picture")
        if run is baseline or run.attack_frames is None or frame is None or errors is None or ours is None:
            continue
        at_baseline = ours[1][ours[0] == frame]
        effect = float(errors[1][errors[0] == frame][0] - (at_baseline[0] if len(at_baseline) else 0.0))
        if best is None or effect > best[0]:
            best = effect, frame
    return best[1] if best else choose_frame(baseline)


def check_frame(run: RunFolder, frame: int) -> int:
    """`frame`, or RunFolderError if the run has no such frame."""
    counts = run.counts_of("picture")
    known = counts["frame"] if counts is not None else (run.objects["frame"] if run.objects is not None else None)
    if known is not None and frame not in known:
        raise RunFolderError(f"{run.path}: frame {frame} was asked for, expected one of {known.min()} to {known.max()}")
    return frame
