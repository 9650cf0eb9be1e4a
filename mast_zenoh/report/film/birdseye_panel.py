"""The bird's-eye view as a panel of a film: artists that are made once and moved from frame to frame."""

from __future__ import annotations

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MultipleLocator

from mast_zenoh.arrays.geometry import box_corners
from mast_zenoh.arrays.states import Floats
from mast_zenoh.report.figures.view import Boxes
from mast_zenoh.report.film.agent_marks import AgentMarks
from mast_zenoh.report.film.attacks import Attacks
from mast_zenoh.report.film.framing import Framing, Window
from mast_zenoh.report.film.takes import Take
from mast_zenoh.report.film.theme import Theme
from mast_zenoh.report.trust_facts import withheld_at

#: m, least length and width of drawn boxes, so that pedestrians are visible.
SMALLEST_M = 1.4
#: Outcomes that are marked at the edge if they are outside the window: the numbers below count them.
ERRORS = ("truth missed", "track false")
#: m, the line ahead of a box.
_AHEAD_M = 1.2
#: m, distance of the lines of the grid.
_GRID_M = 20.0
#: Inches: in smaller panels marks are smaller; how much at most.
_LARGE_INCHES, _LEAST_SCALE = 3.4, 0.55
_DASHED = (0, (3.0, 2.0))


class BirdseyePanel:
    """The boxes of an estimate from above.

    changing: the artists that differ from frame to frame; of a panel that follows an agent, the whole axes
    """

    def __init__(self, axes: Axes, take: Take, attacks: Attacks, framing: Framing, theme: Theme) -> None:
        self.axes, self.take, self.attacks, self._framing = axes, take, attacks, framing
        scale = _scale(axes)
        self._draw_ground(theme)
        self.outcomes = {
            outcome: _BoxArtists(axes, colour, outcome, 3 + 0.1 * order, scale)
            for order, (outcome, colour) in enumerate(theme.outcomes.items())
        }
        self.outside = {
            outcome: _points(axes, "s", theme.outcomes[outcome], 5.0 * scale, 0.0, zorder=7.5) for outcome in ERRORS
        }
        for outcome, points in self.outside.items():
            points.set(markerfacecolor=theme.outcomes[outcome], clip_on=False)
        self._withheld = PolyCollection([], facecolors="none", edgecolors=theme.withheld, linewidths=1.2, zorder=3.6)
        self._withheld.set_linestyle(_DASHED)
        axes.add_collection(self._withheld)
        self.inserted = _points(axes, "D", theme.adversary, 11.0 * scale, 1.3 * scale)
        self.removed = _points(axes, "x", theme.adversary, 9.0 * scale, 2.0 * scale)
        self.moved = LineCollection([], colors=theme.adversary, linewidths=1.5 * scale, zorder=4)
        axes.add_collection(self.moved)
        self.agents = AgentMarks(axes, take, theme, scale)
        self._frame = Rectangle((0, 0), 1, 1, transform=axes.transAxes, fill=False, zorder=7)
        self._frame.set(edgecolor=theme.adversary, linewidth=4.0 * scale)
        axes.add_patch(self._frame)
        self._over = axes.text(0.5, 0.5, "this run has ended", transform=axes.transAxes, zorder=8)
        self._over.set(ha="center", va="center", color=theme.ink, fontsize=12, fontweight="bold")
        self._over.set_bbox({"facecolor": theme.ground, "edgecolor": theme.faint, "alpha": 0.9})
        boxes = [artist for each in self.outcomes.values() for artist in each.artists]
        marks = [*self.outside.values(), self._withheld, self.inserted, self.removed, self.moved]
        parts = [*boxes, *marks, *self.agents.artists, self._frame, self._over]
        self.changing: list[Artist] = [axes] if framing.follow else sorted(parts, key=lambda each: each.get_zorder())

    def _draw_ground(self, theme: Theme) -> None:
        axes, window = self.axes, self._framing.fixed
        axes.set_facecolor(theme.ground)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MultipleLocator(_GRID_M))
        axes.tick_params(length=0, labelbottom=False, labelleft=False)
        axes.grid(color=theme.grid, linewidth=0.8)
        axes.set_axisbelow(True)
        for spine in axes.spines.values():
            spine.set_color(theme.building_edge)
        recording = self.take.run.recording
        if recording is not None:
            outlines = list(recording.buildings)
            axes.add_collection(
                PolyCollection(outlines, facecolors=theme.building, edgecolors=theme.building_edge, zorder=1)
            )
        length = _GRID_M / (2 * window.across)
        if length < 0.5:
            line = Line2D(
                [0.98 - length, 0.98], [0.025, 0.025], transform=axes.transAxes, color=theme.faint, zorder=1.5
            )
            axes.add_artist(line)
            axes.text(0.98, 0.032, f"{_GRID_M:g} m", transform=axes.transAxes, ha="right", va="bottom",
                      color=theme.faint, fontsize=8.5, zorder=1.5)  # fmt: skip

    def show(self, frame: int, *, over: bool) -> None:
        """Move the artists to a frame of this panel's run; over: the run has ended before"""
        window = self._framing.window(frame)
        self.axes.set_xlim(window.x - window.across, window.x + window.across)
        self.axes.set_ylim(window.y - window.up, window.y + window.up)
        view = self.take.view(frame)
        for outcome, boxes in view.boxes[self.take.estimate].items():
            self.outcomes[outcome].show(boxes)
            if outcome in ERRORS:
                at = boxes.position[:, :2]
                edge = np.clip(at, *window.corners)
                self.outside[outcome].set_data(*edge[(edge != at).any(axis=1)].T)
        position, size, yaw = withheld_at(view.run, frame)
        shown = self.take.estimate not in ("local", "received")
        self._withheld.set_verts(list(_outlines(Boxes(position, size, yaw))) if shown else [])
        marks = view.marks(self.take.estimate)
        self.inserted.set_data(marks.added[:, 0], marks.added[:, 1])
        self.removed.set_data(marks.removed[:, 0], marks.removed[:, 1])
        self.moved.set_segments(list(_arrows(marks.moved[:, :, :2], window)))
        self.agents.show(frame, window, self.attacks.attacked(frame))
        self._frame.set_visible(self.attacks.on(frame))
        self._over.set_visible(over)


class _BoxArtists:
    """Outlines with a line ahead; errors are filled, and false tracks are crossed out for colour-blind readers."""

    def __init__(self, axes: Axes, colour: str, outcome: str, zorder: float, scale: float) -> None:
        self.crossed = outcome == "track false"
        filled = outcome in ("truth missed", "track false")
        width = (1.3 if outcome == "track matched" else 1.6) * scale
        face = to_rgba(colour, 0.35 if filled else 0.0)
        self.outlines = PolyCollection([], facecolors=[face], edgecolors=colour, linewidths=width, zorder=zorder)
        self.lines = LineCollection([], colors=colour, linewidths=1.1 * scale, zorder=zorder)
        self.artists = (self.outlines, self.lines)
        for artist in self.artists:
            axes.add_collection(artist)

    def show(self, boxes: Boxes) -> None:
        """Draw these boxes."""
        corners = _outlines(boxes)
        self.outlines.set_verts(list(corners))
        ahead = np.stack([np.cos(boxes.yaw), np.sin(boxes.yaw)], axis=1)
        centre, length = boxes.position[:, :2], np.maximum(boxes.size[:, :1], SMALLEST_M)
        lines = [np.stack([centre, centre + ahead * (length / 2 + _AHEAD_M)], axis=1)]
        if self.crossed:
            lines += [corners[:, [0, 2]], corners[:, [1, 3]]]
        self.lines.set_segments(list(np.concatenate(lines)))


def _scale(axes: Axes) -> float:
    """Size of marks over that in a large panel."""
    figure = axes.get_figure()
    assert figure is not None
    inches = min(axes.bbox.width, axes.bbox.height) / figure.dpi
    return min(max(inches / _LARGE_INCHES, _LEAST_SCALE), 1.0)


def _outlines(boxes: Boxes) -> Floats:
    """(n, 4, 2) m, corners from above."""
    corners: Floats = box_corners(boxes.position, np.maximum(boxes.size, SMALLEST_M), boxes.yaw)[:, :4, :2]
    return corners


def _arrows(moved: Floats, window: Window) -> Floats:
    """(3 n, 2, 2) m, the shafts and heads of arrows (n, 2, 2) m."""
    start, end = moved[:, 0], moved[:, 1]
    back = start - end
    length = np.maximum(np.hypot(*back.T), 1e-9)[:, None]
    back = back / length * np.minimum(length, 0.03 * window.half)
    sideways = np.stack([-back[:, 1], back[:, 0]], axis=1) * 0.5
    return np.concatenate([moved, *(np.stack([end + back + each, end], axis=1) for each in (sideways, -sideways))])


def _points(axes: Axes, marker: str, colour: str, size: float, width: float, zorder: float = 4) -> Line2D:
    (line,) = axes.plot([], [], marker, ms=size, mfc="none", mec=colour, mew=width, zorder=zorder)
    return line
