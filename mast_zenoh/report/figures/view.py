"""Data of the pictures of a frame: the ego's boxes by outcome, and manipulations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.errors import RunFolderError
from mast_zenoh.report.files import Table, rows
from mast_zenoh.report.narrative.changes import OBJECT_M2, SWITCH, scored
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.viewer.palette import OUTCOME_COLOURS

#: The estimates that pictures show, side by side.
PANELS = ("local", "picture", "mission")
#: Estimates that replace one of PANELS when the frame is chosen by them.
_IN_PLACE_OF = {"received": "local", "picture_received": "picture", "picture_on_arrival": "picture"}
#: m, maximum distance from the ego of objects that set the window.
_MAX_DISTANCE_M = 105.0


@dataclass(frozen=True, eq=False)
class Boxes:
    """n upright boxes in the world frame.

    position: (n, 3) m, of the centre; size: (n, 3) m, length, width, height; yaw: (n,) rad
    """

    position: Floats
    size: Floats
    yaw: Floats

    def __len__(self) -> int:
        return len(self.yaw)


class Marks(NamedTuple):
    """Manipulations in a frame, m, world frame.

    added:   (n, 3) where they inserted an object;  removed: (n, 3) where they took one away
    moved:   (n, 2, 3) from where to where they moved one
    """

    added: Floats
    removed: Floats
    moved: Floats

    @classmethod
    def of(cls, effects: Table) -> Marks:
        """Create marks from rows of attacks.parquet."""

        def places(effect: str, when: str) -> Floats:
            selected = rows(effects, effects["effect"] == effect)
            return np.stack([selected[f"{when}_{axis}"] for axis in "xyz"], axis=1).astype(np.float64)

        moved = np.stack([places("moved", "before"), places("moved", "after")], axis=1)
        return cls(places("inserted", "after"), places("removed", "before"), moved)

    @classmethod
    def none(cls) -> Marks:
        """No manipulations."""
        return cls(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2, 3)))

    def inside(self, window: tuple[float, float, float]) -> Marks:
        """The marks inside a window; see `window`."""
        x, y, half = window

        def within(places: Floats) -> Bools:
            return np.asarray(np.abs(places[..., :2] - [x, y]).max(axis=-1) <= half)

        moved = self.moved[within(self.moved).any(axis=-1)]
        return Marks(self.added[within(self.added)], self.removed[within(self.removed)], moved)

    def joined(self, other: Marks) -> Marks:
        """The union of two sets of marks."""
        return Marks(*(np.concatenate([own, others]) for own, others in zip(self, other, strict=True)))


@dataclass(frozen=True, eq=False)
class FrameView:
    """One frame of one run, as the ego estimates it.

    boxes:  by estimator (`local`, `picture`, and `mission` where it has boxes; the picture as received or on arrival
            in place of the one sent, where the frame is chosen by that), then by outcome (the keys of OUTCOME_COLOURS)
    before: manipulations in transit to the command centre, visible in the picture and all later estimates
    behind: manipulations of the picture in transit to the ego
    """

    run: RunFolder
    frame: int
    boxes: dict[str, dict[str, Boxes]]
    before: Marks
    behind: Marks

    def marks(self, estimate: str) -> Marks:
        """The manipulations in this frame that an estimate can show."""
        if estimate == "local":
            return Marks.none()
        behind = estimate in ("mission", "picture_received", "picture_on_arrival")
        return self.before.joined(self.behind) if behind else self.before

    @property
    def time_label(self) -> str:
        """`t = 7.3 s (frame 73)`, or the frame alone where the scene is absent."""
        seconds = self.run.seconds(np.array([self.frame]))
        return f"frame {self.frame}" if seconds is None else f"t = {seconds[0]:.1f} s (frame {self.frame})"


def has_boxes(run: RunFolder, estimate: str) -> bool:
    """Whether pictures can show an estimate."""
    return run.objects is not None and bool(np.any(run.objects["estimator"] == run.original(estimate)))


def frame_view(run: RunFolder, frame: int, chosen_by: str = "picture") -> FrameView | None:
    """The view of a frame; None if the run has no objects of that frame.

    chosen_by: the estimate by whose errors the frame was chosen; it is shown if it has boxes
    """
    if run.objects is None or not np.any(run.objects["frame"] == frame):
        return None
    replaced = _IN_PLACE_OF.get(chosen_by) if has_boxes(run, chosen_by) else None
    estimates = (chosen_by if name == replaced else name for name in PANELS)
    return view_of(run, frame, [name for name in estimates if name != "mission" or has_boxes(run, name)])


def view_of(run: RunFolder, frame: int, estimates: Sequence[str]) -> FrameView:
    """The view of a frame with these estimates; without boxes where the run has none."""
    boxes = {}
    if run.objects is not None:
        table = rows(run.objects, run.objects["frame"] == frame)
        for estimate in estimates:
            estimate_rows = rows(table, table["estimator"] == run.original(estimate))
            boxes[estimate] = {outcome: _boxes(estimate_rows, outcome) for outcome in OUTCOME_COLOURS}
    before, behind = Marks.none(), Marks.none()
    if run.attacks is not None:
        here = rows(run.attacks, run.attacks["frame"] == frame)
        downlink, subscriber = downlinks(here)
        for_ego = np.isin(subscriber, ("", run.ego or ""))
        before, behind = Marks.of(rows(here, ~downlink)), Marks.of(rows(here, downlink & for_ego))
    return FrameView(run, frame, boxes, before, behind)


def downlinks(effects: Table) -> tuple[Bools, NDArray[np.str_]]:
    """(n,) bool, whether effects are on the picture in transit; (n,) the agent on whose leg they are, empty: all."""
    if "message" not in effects or "before_subscriber" not in effects:
        rows_ = len(effects["frame"])
        return np.zeros(rows_, bool), np.full(rows_, "")
    return np.asarray(effects["message"] == "picture"), effects["before_subscriber"].astype(str)


def _boxes(table: Table, outcome: str) -> Boxes:
    kind, _, result = outcome.rpartition(" ")
    mask = table["outcome"] == result
    selected = rows(table, mask & (table["kind"] == kind) if kind else mask)
    return Boxes(
        np.stack([selected["x"], selected["y"], selected["z"]], axis=1).astype(np.float64),
        np.stack([selected["l"], selected["w"], selected["h"]], axis=1).astype(np.float64),
        selected["yaw"].astype(np.float64),
    )


def ego_position(run: RunFolder, frame: int) -> Floats | None:
    """(3,) m, where the ego is; None: the scene is absent or the frame is not in it."""
    if run.recording is None or run.ego not in run.recording.agent_names or not 0 <= frame < len(run.recording):
        return None
    return np.asarray(run.recording.agent_position[frame, run.recording.agent_names.index(run.ego)], np.float64)


def window(views: Sequence[FrameView]) -> tuple[float, float, float]:
    """(x, y, half the width) in m of a square with the ego's surroundings."""
    positions = [
        boxes.position[:, :2]
        for view in views
        for by_outcome in view.boxes.values()
        for boxes in by_outcome.values()
        if len(boxes)
    ]
    ego = ego_position(views[0].run, views[0].frame)
    recording = views[0].run.recording
    if recording is not None and views[0].frame < len(recording):
        positions.append(recording.agent_position[views[0].frame, :, :2])
    points = np.concatenate([*positions, np.zeros((0, 2))])
    centre = ego[:2] if ego is not None else points.mean(axis=0)
    points = points[np.hypot(*(points - centre).T) <= _MAX_DISTANCE_M]
    if not len(points):
        return float(centre[0]), float(centre[1]), 50.0
    low, high = points.min(axis=0), points.max(axis=0)
    middle = (low + high) / 2
    half = max(float((high - low).max()) / 2 + 7.0, 40.0)
    return float(middle[0]), float(middle[1]), half


def clipped(view: FrameView, window: tuple[float, float, float]) -> FrameView:
    """The view without manipulations outside a window."""
    return replace(view, before=view.before.inside(window), behind=view.behind.inside(window))


def settled(run: RunFolder, frames: Ints) -> Bools:
    """(n,) bool: scored frames in which the effects of interposers are settled."""
    return scored(run, frames) & ~np.isin(frames, list(run.unsettled_frames))


def _weighted_errors(run: RunFolder, estimate: str) -> tuple[Ints, Floats] | None:
    """(frames (n,), weighted sum of all the ego's errors in each (n,)).

    Weights are the same as in `changes`.
    """
    counts = run.counts_of(estimate)
    if counts is None:
        return None
    squared = np.nan_to_num(counts["rmse_m"].astype(np.float64)) ** 2 * counts["tp"]
    wrong = counts["fn"] + counts["fp"] + SWITCH * counts["id_switches"]
    return counts["frame"].astype(np.int64), np.asarray(wrong + squared / OBJECT_M2, np.float64)


def choose_frame(run: RunFolder, reference: RunFolder | None = None, estimate: str = "picture") -> int | None:
    """Choose the frame to show; None if no frame is both scored and settled.

    With a reference: the frame in which the errors of `estimate` exceed those of the reference by most. Without one, in
    an attacked run: the one with the most errors; in others, the one in which the picture spares the ego the most. Only
    frames since the first change by an adversary count, where there are any; the earliest of equals wins. Errors are
    missed and false objects, displacements and identity switches.
    """
    run_errors = _weighted_errors(run, estimate)
    if run_errors is None:
        return None
    frames, cost = run_errors
    allowed = settled(run, frames)
    attacked = (
        allowed & (frames >= run.attack_frames[0]) if run.attack_frames is not None else np.zeros(len(frames), bool)
    )
    if reference is not None:
        reference_errors, sign = _weighted_errors(reference, estimate), 1.0
    else:
        reference_errors, sign = (None, 1.0) if attacked.any() else (_weighted_errors(run, "local"), -1.0)
    allowed = attacked if attacked.any() else allowed
    if reference_errors is not None:
        _, here, there = np.intersect1d(frames, reference_errors[0], return_indices=True)
        frames, cost, allowed = frames[here], cost[here] - reference_errors[1][there], allowed[here]
    return int(frames[allowed][np.argmax(sign * cost[allowed])]) if allowed.any() else None


def choose_common_frame(runs: Sequence[RunFolder], baseline: RunFolder, estimate: str = "picture") -> int | None:
    """Choose the frame of several runs: the one with the largest difference from `baseline`."""
    best: tuple[float, int] | None = None
    baseline_errors = _weighted_errors(baseline, estimate)
    for run in runs:
        frame, costs = choose_frame(run, baseline, estimate), _weighted_errors(run, estimate)
        if run is baseline or run.attack_frames is None or frame is None or costs is None or baseline_errors is None:
            continue
        at_baseline = baseline_errors[1][baseline_errors[0] == frame]
        effect = float(costs[1][costs[0] == frame][0] - (at_baseline[0] if len(at_baseline) else 0.0))
        if best is None or effect > best[0]:
            best = effect, frame
    return best[1] if best else choose_frame(baseline)


def check_frame(run: RunFolder, frame: int) -> int:
    """Return `frame`; raises RunFolderError if the run has no such frame."""
    counts = run.counts_of("picture")
    known = counts["frame"] if counts is not None else (run.objects["frame"] if run.objects is not None else None)
    if known is not None and frame not in known:
        raise RunFolderError(f"{run.path}: found frame {frame}, expected one of {known.min()} to {known.max()}")
    return frame
