"""A frame from above: boxes, buildings, agents and manipulations. Figures draw one frame; films move the marks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.text import Annotation
from matplotlib.ticker import MultipleLocator

from mast_zenoh.arrays.boxes import Boxes
from mast_zenoh.arrays.geometry import box_corners, heading
from mast_zenoh.arrays.states import Floats
from mast_zenoh.metrics.estimates import OWN
from mast_zenoh.runs.events import node_absences, states_at, withheld_at
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.interposers import attacked_at, interposers
from mast_zenoh.runs.run import Run
from mast_zenoh.runs.spoofers import spoofers
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing.sensors import LidarSensor
from mast_zenoh.show.figures.style import Theme, plain
from mast_zenoh.show.figures.view import Window
from mast_zenoh.show.palette import TROUBLES

#: m, distance of the lines of the grid.
GRID_M = 20.0
#: m, minimum length and width of drawn boxes, so that pedestrians are visible; the line ahead of a box.
SMALLEST_M, _AHEAD_M = 1.4, 1.2
#: Drawing order of the lowest marks: sensors' limits are above ground and buildings, and below all else.
LOWEST_MARK = 2.0
#: Outcomes that are filled, and marked at the edge if they are outside the window.
ERRORS = ("truth missed", "track false")
#: Line style of withheld objects.
DASHED = (0, (3.0, 2.0))
#: Inches: in smaller panels marks and lines are smaller; how much at most.
_LARGE_INCHES, _LEAST_SCALE = 3.4, 0.55


def scale_of(axes: Axes) -> float:
    """Size of marks over that in a large panel."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    inches = min(axes.bbox.width, axes.bbox.height) / figure.dpi
    return min(max(inches / _LARGE_INCHES, _LEAST_SCALE), 1.0)


def outlines(boxes: Boxes) -> Floats:
    """(n, 4, 2) m, corners from above."""
    corners: Floats = box_corners(boxes.position, np.maximum(boxes.size, SMALLEST_M), boxes.yaw)[:, :4, :2]
    return corners


def face(outcome: str, colour: str) -> tuple[float, float, float, float]:
    """RGBA, the inside of boxes: errors are filled."""
    return to_rgba(colour, 0.35 if outcome in ERRORS else 0.0)


def points(axes: Axes, marker: str, colour: str, size: float, width: float, zorder: float) -> Line2D:
    """Hollow marks that are not anywhere yet."""
    (line,) = axes.plot([], [], marker, ms=size, mfc="none", mec=colour, mew=width, zorder=zorder)
    return line


class BoxArtists:
    """Outlines of boxes with a line ahead; false tracks are crossed out, for colour-blind readers.

    outcome: of the boxes, empty: of a scene;  scale: of lines
    """

    def __init__(self, axes: Axes, colour: str, zorder: float, outcome: str = "", scale: float = 1.0) -> None:
        self.crossed = outcome == "track false"
        width = {"": 1.2, "track matched": 1.3}.get(outcome, 1.6) * scale
        faces = [face(outcome, colour)]
        self.outlines = PolyCollection([], facecolors=faces, edgecolors=colour, linewidths=width, zorder=zorder)
        self.lines = LineCollection([], colors=colour, linewidths=1.1 * scale, zorder=zorder)
        for artist in (self.outlines, self.lines):
            axes.add_collection(artist)

    def show(self, boxes: Boxes) -> None:
        """Draw these boxes."""
        corners = outlines(boxes)
        self.outlines.set_verts(list(corners))
        ahead = np.stack([np.cos(boxes.yaw), np.sin(boxes.yaw)], axis=1)
        centre, length = boxes.position[:, :2], np.maximum(boxes.size[:, :1], SMALLEST_M)
        lines = [np.stack([centre, centre + ahead * (length / 2 + _AHEAD_M)], axis=1)]
        if self.crossed:
            lines += [corners[:, [0, 2]], corners[:, [1, 3]]]
        self.lines.set_segments(list(np.concatenate(lines)))


#: Of a sensor's outline: its points, how opaque it is, and the number of agents above which it is fainter.
_POINTS, _OPACITY, _MANY = 97, 0.35, 6


class AgentLook(NamedTuple):
    """How an agent is drawn. colour: of its mark;  name: of its name;  label: its name and, below, its state"""

    colour: str
    name: str
    label: str


class AgentMarks:
    """A triangle (roadside) or a circle (vehicle) with a name for each agent, and the limits of its sensor.

    scale: of marks and letters
    """

    def __init__(self, axes: Axes, recording: Recording, theme: Theme, scale: float) -> None:
        self._recording, self._theme = recording, theme
        self._ranges = LineCollection([], linewidths=0.9 * scale, zorder=LOWEST_MARK)
        axes.add_collection(self._ranges)
        self.marks: list[Line2D] = []
        self.names: list[Annotation] = []
        for agent in recording.agents:
            marker = "^" if agent.kind == "static" else "o"
            self.marks.append(points(axes, marker, theme.agent, 8.5 * scale, 1.5 * scale, zorder=5))
            name = axes.annotate("", (0, 0), (0, 0), textcoords="offset points", zorder=6)
            name.set(fontsize=max(9.5 * scale, 6.5), linespacing=1.0, clip_on=True)
            name.set_bbox({"facecolor": theme.ground, "edgecolor": "none", "alpha": 0.5, "pad": 0.4})
            self.names.append(name)

    def show(self, frame: int, window: Window, looks: Mapping[str, AgentLook]) -> None:
        """Move the marks to a frame."""
        recording = self._recording
        place = recording.nearest(frame)
        occupied: list[tuple[float, float, float, float]] = []
        sectors, colours = [], []
        poses = recording.agent_position[place], recording.agent_rotation[place]
        shown = zip(recording.agents, self.marks, self.names, *poses, strict=True)
        for agent, mark, name, position, rotation in shown:
            look, turn = looks[agent.name], float(heading(rotation @ agent.sensor.mount_rotation))
            sectors.append(_sector(position, turn, agent.sensor))
            colours.append(to_rgba(look.colour, _OPACITY * min(1.0, _MANY / len(recording.agents))))
            inside = window.contains(position)
            mark.set_visible(inside)
            name.set_visible(inside)
            mark.set_data([position[0]], [position[1]])
            mark.set(markeredgecolor=look.colour, markerfacecolor=look.colour if agent.kind == "static" else "none")
            if inside:
                name.set(text=plain(look.label), color=look.name)
                name.set_fontweight("bold" if look.name == self._theme.adversary else "normal")
                _place_name(name, position, turn, window, occupied)
        self._ranges.set_segments(sectors)
        self._ranges.set_color(colours)


def _sector(position: Floats, turn: float, sensor: LidarSensor) -> Floats:
    """(k, 2) m, the outline of what a sensor covers."""
    start, end = np.radians([sensor.azimuth_min_deg, sensor.azimuth_max_deg])
    bearings = turn + np.linspace(start, end, _POINTS)
    arc = position[:2] + sensor.max_range_m * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    if end - start > np.radians(359.0):
        return arc
    return np.concatenate([position[None, :2], arc, position[None, :2]])


def _place_name(
    name: Annotation, at: Floats, turn: float, window: Window, occupied: list[tuple[float, float, float, float]]
) -> None:
    """Put a name beside a position: behind the agent, away from the traffic that it observes, if there is room.

    turn: rad, where it looks;  occupied: boxes of earlier names (left, right, bottom, top), m; its own is appended
    """
    half, lines = window.half, name.get_text().split("\n")
    width, height, gap = 0.045 * max(map(len, lines)) * half, (0.02 + 0.07 * len(lines)) * half, 0.03 * half
    behind = -np.array([np.cos(turn), np.sin(turn)])
    # Near the edge of the window, the other side is better.
    inside = np.abs(at[:2] + behind * 0.25 * half - (window.x, window.y)) < (window.across, window.up)
    right, above = (bool(side) for side in np.where(inside, behind, -behind) > 0)
    for sides in ((right, above), (right, not above), (not right, above), (not right, not above)):
        left = at[0] + gap if sides[0] else at[0] - gap - width
        low = at[1] + gap if sides[1] else at[1] - gap - height
        box = (left - gap, left + width + gap, low, low + height)
        if not any(box[0] < t[1] and t[0] < box[1] and box[2] < t[3] and t[2] < box[3] for t in occupied):
            occupied.append(box)
            right, above = sides
            break
    name.xy = (float(at[0]), float(at[1]))
    name.xyann = (7 if right else -7, 4 if above else -4)
    name.set(ha="left" if right else "right", va="bottom" if above else "top")


def draw_ground(axes: Axes, recording: Recording | None, theme: Theme) -> None:
    """Draw the ground with its grid, and the buildings of a scene."""
    axes.set_facecolor(theme.ground)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(GRID_M))
    axes.tick_params(colors=theme.faint, labelsize=9, length=3)
    axes.grid(color=theme.grid, linewidth=0.8)
    axes.set_axisbelow(True)
    for spine in axes.spines.values():
        spine.set_color(theme.building_edge)
    if recording is not None:
        walls, edges = list(recording.buildings), theme.building_edge
        axes.add_collection(PolyCollection(walls, facecolors=theme.building, edgecolors=edges, zorder=1))


class BirdseyePanel:
    """The boxes of an estimate of a run from above, with agents and what adversaries did."""

    def __init__(self, axes: Axes, run: Run, estimate: str, theme: Theme) -> None:
        self.axes, self._estimate, self._theme = axes, estimate, theme
        self._interposers, self._absences = interposers(run), node_absences(run)
        scale = scale_of(axes)
        draw_ground(axes, run.files.scene, theme)
        self.outcomes = {
            outcome: BoxArtists(axes, colour, 3 + 0.1 * order, outcome, scale)
            for order, (outcome, colour) in enumerate(theme.outcomes.items())
        }
        self.outside = {name: points(axes, "s", theme.outcomes[name], 5.0 * scale, 0.0, zorder=7.5) for name in ERRORS}
        for outcome, squares in self.outside.items():
            squares.set(markerfacecolor=theme.outcomes[outcome], clip_on=False)
        self._withheld = PolyCollection([], facecolors="none", edgecolors=theme.withheld, linewidths=1.2, zorder=3.6)
        self._withheld.set_linestyle(DASHED)
        # Larger than most boxes and below them, so that marks hide nothing.
        self.inserted = points(axes, "D", theme.adversary, 14.0 * scale, 1.2 * scale, zorder=2.5)
        self.removed = points(axes, "x", theme.adversary, 16.0 * scale, 1.4 * scale, zorder=2.5)
        self.moved = LineCollection([], colors=theme.adversary, linewidths=1.5 * scale, zorder=2.5)
        self.spoofers = points(axes, "s", theme.adversary, 6.0 * scale, 0.0, zorder=5.5)
        self.spoofers.set(markerfacecolor=theme.adversary)
        for collection in (self._withheld, self.moved):
            axes.add_collection(collection)
        recording = run.files.scene
        self.agents = None if recording is None else AgentMarks(axes, recording, theme, scale)

    def show(self, frame: Frame, window: Window) -> None:
        """Move everything to a frame of the run."""
        window.apply(self.axes)
        for outcome, boxes in frame.boxes[self._estimate].items():
            self.outcomes[outcome].show(boxes)
            if outcome in ERRORS:
                at = boxes.position[:, :2]
                edge = np.clip(at, *window.corners)
                self.outside[outcome].set_data(*edge[(edge != at).any(axis=1)].T)
        withheld = Boxes.join(()) if self._estimate in OWN else withheld_at(frame.run, frame.index)
        self._withheld.set_verts(list(outlines(withheld)))
        marks = frame.marks(self._estimate)
        self.inserted.set_data(*marks.added[:, :2].T)
        self.removed.set_data(*marks.removed[:, :2].T)
        self.moved.set_segments(list(_arrows(marks.moved[:, :, :2], window)))
        places = list(spoofers(frame.run, np.array([frame.index])).values())
        self.spoofers.set_data(*np.concatenate([np.zeros((0, 3)), *places]).T[:2])
        if self.agents is not None:
            self.agents.show(frame.index, window, self._looks(frame))

    def _looks(self, frame: Frame) -> dict[str, AgentLook]:
        """How the agents are drawn: their states, and on whose wires adversaries sit."""
        theme, states = self._theme, states_at(frame.run, frame.index)
        attacked = attacked_at(self._interposers, frame.index)
        down = {node for node, start, end in self._absences if start <= frame.index < end}
        looks = {}
        assert frame.run.files.scene is not None
        for name in frame.run.files.scene.agent_names:
            state = states.get(name, "")
            adversary = theme.adversary if name in attacked else ""
            colour = theme.faint if name in down else theme.states[state] if state else adversary or theme.agent
            trouble = "down" if name in down else state if state in TROUBLES else ""
            looks[name] = AgentLook(colour, adversary or colour, f"{name}\n{trouble}" if trouble else name)
        return looks


def _arrows(moved: Floats, window: Window) -> Floats:
    """(3 n, 2, 2) m, the shafts and heads of arrows (n, 2, 2) m."""
    start, end = moved[:, 0], moved[:, 1]
    back = start - end
    length = np.maximum(np.hypot(*back.T), 1e-9)[:, None]
    back = back / length * np.minimum(length, 0.03 * window.half)
    sideways = np.stack([-back[:, 1], back[:, 0]], axis=1) * 0.5
    return np.concatenate([moved, *(np.stack([end + back + each, end], axis=1) for each in (sideways, -sideways))])
