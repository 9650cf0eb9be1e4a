"""The panels of a film: the bird's-eye view with the agents, the camera view, and the errors over time."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.text import Annotation
from matplotlib.ticker import MaxNLocator, MultipleLocator, NullLocator

from mast_zenoh.arrays.geometry import heading
from mast_zenoh.arrays.states import Floats
from mast_zenoh.launch.twin import NAME
from mast_zenoh.report.figures.birdseye import BoxArtists, outlines, place_name, side_behind, withheld_style
from mast_zenoh.report.figures.camera import draw_camera, ego_eye
from mast_zenoh.report.figures.style import plain
from mast_zenoh.report.film.look import Theme
from mast_zenoh.report.film.takes import Attacks, Framing, Take, Window
from mast_zenoh.runs.driven import NEEDLESSLY, ROLLS, braking_of, cars_of, course_of, twin_course
from mast_zenoh.runs.events import node_absences, spans, states_at, withheld_at
from mast_zenoh.runs.files import Table
from mast_zenoh.sensing.sensors import LidarSensor
from mast_zenoh.viewer.palette import TROUBLES

#: Of a sensor's outline: its points, how opaque it is, and the number of agents above which it is fainter.
_POINTS, _OPACITY, _MANY = 49, 0.35, 6


class AgentMarks:
    """A triangle (roadside) or a circle (vehicle) with a name for each agent, and the limits of its sensor.

    scale: of marks and letters
    """

    def __init__(self, axes: Axes, take: Take, theme: Theme, scale: float) -> None:
        self._recording, self._run, self._theme = take.run.files.scene, take.run, theme
        self._absences = node_absences(take.run)
        agents = self._recording.agents if self._recording is not None else ()
        self._ranges = LineCollection([], linewidths=0.9 * scale, zorder=2)
        axes.add_collection(self._ranges)
        self.marks: list[Line2D] = []
        self.names: list[Annotation] = []
        for agent in agents:
            marker = "^" if agent.kind == "static" else "o"
            self.marks += axes.plot([], [], marker, ms=8.5 * scale, mew=1.5 * scale, zorder=5)
            name = axes.annotate("", (0, 0), (0, 0), textcoords="offset points", zorder=6)
            name.set(fontsize=max(9.5 * scale, 6.5), linespacing=1.0, clip_on=True)
            name.set_bbox({"facecolor": theme.ground, "edgecolor": "none", "alpha": 0.65, "pad": 0.6})
            self.names.append(name)
        self.artists: list[Artist] = [self._ranges, *self.marks, *self.names]

    def show(self, frame: int, window: Window, attacked: set[str]) -> None:
        """Move the marks to a frame; attacked: agents with an adversary on a wire"""
        recording = self._recording
        if recording is None:
            return
        place = min(frame, len(recording) - 1)
        states = states_at(self._run, frame)
        down = {node for node, start, end in self._absences if start <= frame < end}
        occupied: list[tuple[float, float, float, float]] = []
        outlines, colours = [], []
        for index, agent in enumerate(recording.agents):
            position = recording.agent_position[place, index]
            turn = float(heading(recording.agent_rotation[place, index] @ agent.sensor.mount_rotation))
            adversary = self._theme.adversary if agent.name in attacked else None
            state = states.get(agent.name, "")
            colour = self._theme.states[state] if state else adversary or self._theme.agent
            colour = self._theme.faint if agent.name in down else colour
            mark, name = self.marks[index], self.names[index]
            inside = window.contains(position)
            mark.set_visible(inside)
            name.set_visible(inside)
            mark.set_data([position[0]], [position[1]])
            mark.set(markeredgecolor=colour, markerfacecolor=colour if agent.kind == "static" else "none")
            outlines.append(_sector(position, turn, agent.sensor))
            colours.append(to_rgba(colour, _OPACITY * min(1.0, _MANY / len(recording.agents))))
            if not inside:
                continue
            trouble = "down" if agent.name in down else state if state in TROUBLES else ""
            label = f"{agent.name}\n{trouble}" if trouble else agent.name
            name.set(text=plain(label), color=adversary or colour, fontweight="bold" if adversary else "normal")
            reach = window.across, window.up  # the side depends on nothing but the frame
            preferred = side_behind(position, turn, window.half, (window.x, window.y), reach)
            place_name(name, position, window.half, occupied, preferred)
        self._ranges.set_segments(outlines)
        self._ranges.set_color(colours)


#: m: from the middle of a car to its rear lights, and their width. Share of the window: at least.
_REAR_M, _WIDE_M, _LEAST_SHARE = 2.3, 1.9, 0.03


class DriveMarks:
    """The driven cars: rear lights when they brake, speed and acceleration, and the ways of their unattacked twins.

    scale: of marks and letters
    """

    def __init__(self, axes: Axes, take: Take, theme: Theme, scale: float) -> None:
        self._take, self._theme = take, theme
        self._courses = [(car, course_of(take.run, car)) for car in cars_of(take.run)]
        self._twins = [twin_course(take.run, car) for car, _ in self._courses]
        self._lights = LineCollection([], linewidths=4.0 * scale, zorder=6.5, capstyle="butt")
        axes.add_collection(self._lights)
        dashed: dict[str, Any] = {
            "color": theme.faint,
            "linewidth": 1.3 * scale,
            "linestyle": (0, (4, 3)),
            "zorder": 2.4,
        }
        ways = [axes.plot(twin["x"], twin["y"], **dashed)[0] for twin in self._twins if twin is not None]
        self._ghosts = _points(axes, "o", theme.faint, 8.5 * scale, 1.4 * scale, zorder=4.9)
        self._text = axes.text(0.015, 0.985, "", transform=axes.transAxes, ha="left", va="top", zorder=8)
        self._text.set(color=theme.ink, fontsize=max(9.5 * scale, 6.5), linespacing=1.25)
        self._text.set_bbox({"facecolor": theme.ground, "edgecolor": "none", "alpha": 0.7, "pad": 1.5})
        self.artists: list[Artist] = [*ways, self._lights, self._ghosts, self._text] if self._courses else []

    @property
    def text(self) -> str:
        """What it says of this frame."""
        return self._text.get_text()

    @property
    def lights(self) -> int:
        """Number of cars that brake in this frame."""
        return len(self._lights.get_segments())

    def show(self, frame: int, window: Window) -> None:
        """Move the marks to a frame."""
        now = np.array([self._take.seconds(frame)])
        lights, colours, lines, ghosts = [], [], [], []
        for (car, course), twin in zip(self._courses, self._twins, strict=True):
            if course is None:
                continue
            row = _row_of(course, frame)
            place = np.array([course["x"][row], course["y"][row]])
            line = f"{car} {course['speed_mps'][row]:.1f} m/s"
            state = int(braking_of(self._take.run, car, now)[0])
            if state != ROLLS:
                lights.append(_rear(place, float(course["heading"][row]), _LEAST_SHARE * window.half))
                colours.append(self._theme.outcomes["track false"] if state == NEEDLESSLY else self._theme.fault)
                line += f", {'brakes needlessly' if state == NEEDLESSLY else 'brakes'}"
                line += f" {-float(course['acceleration_mps2'][row]):.1f} m/s²"
            lines.append(line)
            if twin is not None:
                ghosts.append((twin["x"][_row_of(twin, frame)], twin["y"][_row_of(twin, frame)]))
                lines.append(f"{NAME} {twin['speed_mps'][_row_of(twin, frame)]:.1f} m/s (broken line)")
        self._lights.set_segments(lights)
        self._lights.set_color(colours)
        self._ghosts.set_data(*np.array(ghosts).reshape(-1, 2).T)
        self._text.set_text(plain("\n".join(lines)))


def _row_of(course: Table, frame: int) -> int:
    """The row of a frame, or of the last one before it."""
    return max(int(np.searchsorted(course["frame"], frame, side="right")) - 1, 0)


def _rear(place: Floats, heading: float, least: float) -> Floats:
    """(2, 2) m, a line across the rear of a car. least: m, its distance from the middle, and half its length"""
    ahead = np.array([np.cos(heading), np.sin(heading)])
    left = np.array([-ahead[1], ahead[0]]) * max(_WIDE_M / 2.0, least)
    back = place - ahead * max(_REAR_M, least)
    return np.stack([back - left, back + left])


def _sector(position: Floats, turn: float, sensor: LidarSensor) -> Floats:
    """(k, 2) m, the outline of what a sensor covers."""
    start, end = np.radians([sensor.azimuth_min_deg, sensor.azimuth_max_deg])
    bearings = turn + np.linspace(start, end, _POINTS)
    arc = position[:2] + sensor.max_range_m * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    if end - start > np.radians(359.0):
        return arc
    return np.concatenate([position[None, :2], arc, position[None, :2]])


#: Outcomes that are marked at the edge if they are outside the window: the numbers below count them.
ERRORS = ("truth missed", "track false")
#: m, distance of the lines of the grid.
_GRID_M = 20.0
#: Inches: in smaller panels marks are smaller; how much at most.
_LARGE_INCHES, _LEAST_SCALE = 3.4, 0.55


class BirdseyePanel:
    """The boxes of an estimate from above.

    changing: the artists that differ from frame to frame; of a panel that follows an agent, the whole axes
    """

    def __init__(self, axes: Axes, take: Take, attacks: Attacks, framing: Framing, theme: Theme) -> None:
        self.axes, self.take, self.attacks, self._framing = axes, take, attacks, framing
        scale = _scale(axes)
        self._draw_ground(theme)
        self.outcomes = {
            outcome: BoxArtists(axes, colour, 3 + 0.1 * order, outcome, scale)
            for order, (outcome, colour) in enumerate(theme.outcomes.items())
        }
        self.outside = {
            outcome: _points(axes, "s", theme.outcomes[outcome], 5.0 * scale, 0.0, zorder=7.5) for outcome in ERRORS
        }
        for outcome, points in self.outside.items():
            points.set(markerfacecolor=theme.outcomes[outcome], clip_on=False)
        self._withheld = PolyCollection([], **withheld_style(theme.withheld), zorder=3.6)
        axes.add_collection(self._withheld)
        self.inserted = _points(axes, "D", theme.adversary, 11.0 * scale, 1.3 * scale)
        self.removed = _points(axes, "x", theme.adversary, 9.0 * scale, 2.0 * scale)
        self.moved = LineCollection([], colors=theme.adversary, linewidths=1.5 * scale, zorder=4)
        axes.add_collection(self.moved)
        self.agents = AgentMarks(axes, take, theme, scale)
        self.drives = DriveMarks(axes, take, theme, scale)
        self._frame = Rectangle((0, 0), 1, 1, transform=axes.transAxes, fill=False, zorder=7)
        self._frame.set(edgecolor=theme.adversary, linewidth=4.0 * scale)
        axes.add_patch(self._frame)
        self._over = axes.text(0.5, 0.5, "this run has ended", transform=axes.transAxes, zorder=8)
        self._over.set(ha="center", va="center", color=theme.ink, fontsize=12, fontweight="bold")
        self._over.set_bbox({"facecolor": theme.ground, "edgecolor": theme.faint, "alpha": 0.9})
        boxes = [artist for each in self.outcomes.values() for artist in each.artists]
        marks = [*self.outside.values(), self._withheld, self.inserted, self.removed, self.moved]
        parts = [*boxes, *marks, *self.agents.artists, *self.drives.artists, self._frame, self._over]
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
        recording = self.take.run.files.scene
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
        shown = self.take.estimate not in ("local", "received")
        self._withheld.set_verts(list(outlines(withheld_at(view.run, frame))) if shown else [])
        marks = view.marks(self.take.estimate)
        self.inserted.set_data(marks.added[:, 0], marks.added[:, 1])
        self.removed.set_data(marks.removed[:, 0], marks.removed[:, 1])
        self.moved.set_segments(list(_arrows(marks.moved[:, :, :2], window)))
        self.agents.show(frame, window, self.attacks.attacked(frame))
        self.drives.show(frame, window)
        self._frame.set_visible(self.attacks.on(frame))
        self._over.set_visible(over)


def _scale(axes: Axes) -> float:
    """Size of marks over that in a large panel."""
    figure = axes.get_figure()
    assert figure is not None
    inches = min(axes.bbox.width, axes.bbox.height) / figure.dpi
    return min(max(inches / _LARGE_INCHES, _LEAST_SCALE), 1.0)


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


class CameraPanel:
    """The boxes of an estimate as the agent's camera sees them, drawn anew in every frame."""

    def __init__(self, axes: Axes, take: Take, theme: Theme) -> None:
        self.axes, self.take, self._theme = axes, take, theme
        self.changing: list[Artist] = [axes]

    def show(self, frame: int) -> None:
        """Draw a frame of this panel's run."""
        self.axes.clear()
        view = self.take.view(frame)
        eye = ego_eye(view)
        if eye is None:
            self.axes.set_axis_off()
            return
        draw_camera(self.axes, view, self.take.estimate, eye, self._theme.camera)


def image_crop_aspect(take: Take) -> float | None:
    """Height by width of the part of the camera's image that is drawn; None: the agent is not in the scene."""
    eye = ego_eye(take.view(take.first))
    return None if eye is None else eye.crop_aspect


class Strip:
    """Missed and false objects over the time of the film.

    changing: the artists that differ from frame to frame;  most: the greatest number of objects in a scored frame
    """

    def __init__(self, axes: Axes, take: Take, attacks: Attacks, limits: tuple[float, float], theme: Theme) -> None:
        self.axes = axes
        low, high = limits
        axes.set_xlim(low, max(high, low + 1e-3))
        axes.set_facecolor(theme.ground)
        axes.tick_params(colors=theme.faint, labelsize=8, length=2, pad=1.5)
        axes.xaxis.set_major_locator(MaxNLocator(8))
        axes.xaxis.set_major_formatter("{x:g} s")
        axes.yaxis.set_major_locator(MaxNLocator(2, integer=True))
        for side, spine in axes.spines.items():
            spine.set_visible(side in ("left", "bottom"))
            spine.set_color(theme.building_edge)
        self._draw_bands(take, attacks, theme)
        series = take.series()
        self.most = 1.0
        if series is not None:
            times, missed, false = series
            inside = (times >= low - 1e-6) & (times <= high + 1e-6)
            # The axis fits the scored frames: before them, everything is missed.
            first, last = (take.seconds(frame) for frame in take.run.scored_frames or (take.first, take.last))
            scored = inside & (times >= first - 1e-6) & (times <= last + 1e-6)
            scored = scored if scored.any() else inside
            for values, outcome in ((missed, "truth missed"), (false, "track false")):
                axes.plot(times[inside], values[inside], color=theme.outcomes[outcome], linewidth=1.3, zorder=3)
                self.most = max(self.most, *values[scored].tolist())
        else:
            axes.yaxis.set_major_locator(NullLocator())
        self.set_most(self.most)
        self._now = axes.axvline(low, color=theme.ink, linewidth=1.4, zorder=4)
        self.changing: list[Artist] = [self._now]

    def _draw_bands(self, take: Take, attacks: Attacks, theme: Theme) -> None:
        period = take.run.period_s
        for start, end in attacks.spans:
            self.axes.axvspan(
                take.seconds(start), take.seconds(end - 1) + period, color=theme.adversary, alpha=0.28, lw=0
            )
        for each in spans(take.run, np.array([take.seconds(frame) for frame in range(take.last + 1)])):
            if each["kind"] == "fault":
                self.axes.axvspan(each["from_s"], each["until_s"], color=theme.fault, alpha=0.25, lw=0)
            elif each["kind"] == "interception":
                for edge in (each["from_s"], each["until_s"]):
                    self.axes.axvline(edge, color=theme.adversary, linewidth=1.2, linestyle=(0, (3, 2)), zorder=2)

    def set_most(self, most: float) -> None:
        """Set the greatest number of objects on the axis."""
        self.axes.set_ylim(-0.04 * most, 1.12 * most)

    def show(self, seconds: float) -> None:
        """Move the line to a time, s."""
        self._now.set_xdata([seconds, seconds])
