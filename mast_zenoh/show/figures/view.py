"""Data of the pictures of a frame: the ego's boxes by outcome, and manipulations.

Which part of a scene a picture shows.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.errors import RunFolderError
from mast_zenoh.runs.files import are_in
from mast_zenoh.runs.frame import Frame, ego_position, frame_at, has_boxes
from mast_zenoh.runs.run import Run
from mast_zenoh.show.findings.changes import OBJECT_M2, SWITCH, scored

#: The estimates that pictures show, side by side.
PANELS = ("local", "picture", "mission")
#: Estimates that replace one of PANELS when the frame is chosen by them.
_IN_PLACE_OF = {"received": "local", "picture_received": "picture", "picture_on_arrival": "picture"}


def frame_view(run: Run, frame: int, chosen_by: str = "picture") -> Frame | None:
    """The view of a frame; None if the run has no objects of that frame.

    chosen_by: the estimate by whose errors the frame was chosen; it is shown if it has boxes
    """
    if run.files.objects is None or not np.any(run.files.objects["frame"] == frame):
        return None
    replaced = _IN_PLACE_OF.get(chosen_by) if has_boxes(run, chosen_by) else None
    estimates = (chosen_by if name == replaced else name for name in PANELS)
    return frame_at(run, frame, [name for name in estimates if name != "mission" or has_boxes(run, name)])


def settled(run: Run, frames: Ints) -> Bools:
    """(n,) bool: scored frames in which the effects of interposers are settled, and of which the run has boxes."""
    return scored(run, frames) & ~np.isin(frames, list(run.unsettled_frames)) & are_in(run.files.sample, frames)


def _weighted_errors(run: Run, estimate: str) -> tuple[Ints, Floats] | None:
    """(frames (n,), weighted sum of all the ego's errors in each (n,)).

    Weights are the same as in `changes`.
    """
    counts = run.counts_of(estimate)
    if counts is None:
        return None
    squared = np.nan_to_num(counts["rmse_m"].astype(np.float64)) ** 2 * counts["tp"]
    wrong = counts["fn"] + counts["fp"] + SWITCH * counts["id_switches"]
    return counts["frame"].astype(np.int64), np.asarray(wrong + squared / OBJECT_M2, np.float64)


def choose_frame(run: Run, reference: Run | None = None, estimate: str = "picture") -> int | None:
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


def choose_common_frame(runs: Sequence[Run], baseline: Run, estimate: str = "picture") -> int | None:
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


def check_frame(run: Run, frame: int) -> int:
    """Return `frame`; raises RunFolderError if the run has no such frame."""
    counts = run.counts_of("picture")
    known = (
        counts["frame"]
        if counts is not None
        else (run.files.objects["frame"] if run.files.objects is not None else None)
    )
    if known is not None and frame not in known:
        raise RunFolderError(f"{run.path}: found frame {frame}, expected one of {known.min()} to {known.max()}")
    return frame


#: m: agents and objects farther than this from the ego do not matter.
_MATTERS_M = 105.0
#: m: free space around what matters; half of the shorter side, at least.
_MARGIN_M, _LEAST_HALF_M = 8.0, 20.0


class Window(NamedTuple):
    """A rectangle of the scene, m. x, y: its centre;  across, up: half of its width and height"""

    x: float
    y: float
    across: float
    up: float

    @classmethod
    def of(cls, centre: Sequence[float] | Floats, half: float, aspect: float = 1.0) -> Window:
        """A window of a shape. centre: x and y, m;  half: m, of the shorter side;  aspect: width by height"""
        return cls(float(centre[0]), float(centre[1]), half * max(aspect, 1.0), half / min(aspect, 1.0))

    @classmethod
    def around(cls, places: Floats, aspect: float = 1.0) -> Window:
        """The window that shows all places (n, 2) m with free space around them."""
        low, high = (places.min(axis=0), places.max(axis=0)) if len(places) else np.zeros((2, 2))
        across, up = (high - low) / 2 + _MARGIN_M
        half = max(across / max(aspect, 1.0), up * min(aspect, 1.0), _LEAST_HALF_M)
        return cls.of((low + high) / 2, half, aspect)

    def apply(self, axes: Axes) -> None:
        """Show this part of the scene on axes."""
        axes.set(xlim=(self.x - self.across, self.x + self.across), ylim=(self.y - self.up, self.y + self.up))

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


def window_of(frames: Iterable[Frame], aspect: float = 1.0, outliers: float = 0.0, *, follow: bool = False) -> Window:
    """The window of all frames: it shows the agents, boxes and manipulations around the ego.

    aspect:   its width by its height
    outliers: share of the boxes and manipulations on either side that may lie outside
    follow:   with the ego in the middle; x and y are relative to it
    """
    always, mostly = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for frame in frames:
        scene, ego = frame.run.files.scene, ego_position(frame.run, frame.index)
        if scene is not None and len(scene):
            always.append(_near(scene.agent_position[scene.nearest(frame.index)], ego, relative=follow))
        for estimate, by_outcome in frame.boxes.items():
            marks, positions = frame.marks(estimate), [boxes.position for boxes in by_outcome.values()]
            mostly.append(_near(np.concatenate([*positions, marks.added, marks.removed]), ego, relative=follow))
    inner = np.sort(np.concatenate(mostly), axis=0)  # by x and by y
    cut = int(len(inner) * outliers)
    places = np.concatenate([*always, inner[cut : len(inner) - cut]])
    return Window.around(np.concatenate([places, -places]) if follow else places, aspect)


def _near(places: Floats, ego: Floats | None, *, relative: bool) -> Floats:
    """(k, 2) m, those of the places (n, 3) m that matter. ego: (3,) m, None: all matter;  relative: to the ego"""
    if ego is None:
        return places[:, :2]
    offsets = (places - ego)[:, :2]
    near = np.hypot(*offsets.T) <= _MATTERS_M
    return np.asarray(offsets[near] if relative else places[near, :2])
