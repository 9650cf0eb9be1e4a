"""A frame from above: boxes, buildings, agents and manipulations; of a run, or of a scene without one."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import patheffects
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Wedge
from matplotlib.text import Annotation
from matplotlib.ticker import MultipleLocator

from mast_zenoh.arrays.boxes import Boxes
from mast_zenoh.arrays.geometry import box_corners, heading
from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.metrics.estimates import OWN
from mast_zenoh.report.figures.style import Figure, dark_axes, plain
from mast_zenoh.runs.evaluated import Changes
from mast_zenoh.runs.events import states_at, withheld_at
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.interposers import adversaries_by_agent, interposers
from mast_zenoh.scenes.recording import SEEN_RETURNS, Recording
from mast_zenoh.sensing import sensor_pose, to_world
from mast_zenoh.viewer.palette import (
    ADVERSARY,
    AGENT,
    BUILDING,
    BUILDING_EDGE,
    FAINT,
    GRID,
    GROUND,
    OUTCOME_COLOURS,
    OUTCOME_LABELS,
    STATES,
    TROUBLES,
    WITHHELD,
)

#: m, minimum length and width of drawn boxes, so that pedestrians are visible; the line ahead of a box.
SMALLEST_M, _AHEAD_M = 1.4, 1.2
#: Drawing order of marks of adversaries: above buildings, below boxes.
_MARKS = 2.5
#: Line style of withheld objects.
DASHED = (0, (3.0, 2.0))

_HALO = [patheffects.withStroke(linewidth=2.5, foreground=GROUND)]


def draw_birdseye(axes: Axes, view: Frame, estimator: str, window: tuple[float, float, float]) -> None:
    """Draw the boxes of one estimator in a frame.

    estimator: one of `view.PANELS`; window: as from `view.window`, m
    """
    x, y, half = window
    dark_axes(axes)
    axes.set_xlim(x - half, x + half)
    axes.set_ylim(y - half, y + half)
    axes.set_aspect("equal")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(20.0))
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.set_xlabel("x, east (m)", color=FAINT, fontsize=10, labelpad=2)
    axes.set_ylabel("y, north (m)", color=FAINT, fontsize=10, labelpad=-2)
    recording = view.run.files.scene
    if recording is not None:
        axes.add_collection(
            PolyCollection(list(recording.buildings), facecolors=BUILDING, edgecolors=BUILDING_EDGE, zorder=1)
        )
    for order, (outcome, colour) in enumerate(OUTCOME_COLOURS.items()):
        BoxArtists(axes, colour, 3 + 0.1 * order, outcome).show(view.boxes[estimator][outcome])
    if estimator not in OWN:
        withheld = outlines(withheld_at(view.run, view.index))
        axes.add_collection(PolyCollection(list(withheld), **withheld_style(WITHHELD), zorder=3.5))
    _draw_attack(axes, view.marks(estimator))
    _draw_agents(axes, view, window)


def outlines(boxes: Boxes) -> Floats:
    """(n, 4, 2) m, corners from above."""
    corners: Floats = box_corners(boxes.position, np.maximum(boxes.size, SMALLEST_M), boxes.yaw)[:, :4, :2]
    return corners


def withheld_style(colour: str) -> dict[str, Any]:
    """How objects are drawn that the command centre withholds."""
    return {"facecolors": "none", "edgecolors": colour, "linewidths": 1.2, "linestyles": [DASHED]}


def face(outcome: str, colour: str) -> tuple[float, float, float, float]:
    """RGBA, the inside of boxes: errors are filled."""
    return to_rgba(colour, 0.35 if outcome in ("truth missed", "track false") else 0.0)


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
        self.artists = (self.outlines, self.lines)
        for artist in self.artists:
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


def _draw_attack(axes: Axes, marks: Changes) -> None:
    # Larger than most boxes and below them, so that marks hide nothing.
    if len(marks.added):
        axes.plot(*marks.added[:, :2].T, "D", ms=14, mfc="none", mec=ADVERSARY, mew=1.2, zorder=_MARKS)
    if len(marks.removed):
        axes.plot(*marks.removed[:, :2].T, "x", ms=16, color=ADVERSARY, mew=1.4, zorder=_MARKS)
    for before, after in marks.moved:
        arrow = {"arrowstyle": "->", "color": ADVERSARY, "lw": 1.5}
        axes.annotate("", after[:2], before[:2], arrowprops=arrow, annotation_clip=True, zorder=_MARKS)


def _draw_agents(axes: Axes, view: Frame, window: tuple[float, float, float]) -> None:
    recording = view.run.files.scene
    if recording is None or view.index >= len(recording):
        return
    x, y, half = window
    occupied: list[tuple[float, float, float, float]] = []
    attacked = adversaries_by_agent(interposers(view.run))
    states = states_at(view.run, view.index)
    for index, agent in enumerate(recording.agents):
        position = recording.agent_position[view.index, index]
        if max(abs(position[0] - x), abs(position[1] - y)) > half:
            continue
        state = states.get(agent.name, "unknown")
        colour = STATES[state] if states else ADVERSARY if agent.name in attacked else AGENT
        name_colour = ADVERSARY if agent.name in attacked else colour
        label = f"{agent.name}\n{state}" if state in TROUBLES else agent.name
        sector = agent.sensor.azimuth_max_deg - agent.sensor.azimuth_min_deg
        facing = recording.agent_rotation[view.index, index] @ agent.sensor.mount_rotation
        turn = float(heading(facing))
        if sector < 359.0:
            start = np.degrees(turn) + agent.sensor.azimuth_min_deg
            wedge = Wedge((position[0], position[1]), agent.sensor.max_range_m, start, start + sector)
            wedge.set(facecolor="none", edgecolor=to_rgba(colour, 0.3), linewidth=0.8, zorder=2)
            axes.add_patch(wedge)
        marker, inside = ("^", colour) if agent.kind == "static" else ("o", "none")
        axes.plot(position[0], position[1], marker, ms=9, mfc=inside, mec=colour, mew=1.5, zorder=5)
        name = axes.annotate(
            plain(label),
            (0, 0),
            (0, 0),
            textcoords="offset points",
            color=name_colour,
            fontsize=10,
            linespacing=1.0,
            fontweight="bold" if name_colour == ADVERSARY else "normal",
            path_effects=_HALO,
            zorder=6,
        )
        place_name(name, position, half, occupied, side_behind(position, turn, half, (x, y), (half, half)))


def side_behind(
    at: Floats, turn: float, half: float, centre: tuple[float, float], reach: tuple[float, float]
) -> tuple[bool, bool]:
    """(right, above): the side behind an agent, away from where it looks and the observed traffic.

    turn: rad, where it looks;  half, centre, reach: m, of the window; near its edge, the other side is better
    """
    behind = -np.array([np.cos(turn), np.sin(turn)])
    inside = np.abs(at[:2] + behind * 0.25 * half - centre) < reach
    right, above = np.where(inside, behind, -behind) > 0
    return bool(right), bool(above)


def place_name(
    name: Annotation,
    at: Floats,
    half: float,
    occupied: list[tuple[float, float, float, float]],
    preferred: tuple[bool, bool] = (True, True),
    gap: int = 7,
) -> None:
    """Put a name beside a position, at the preferred side (right, above) if no earlier name is there.

    half: m, of the window;  gap: points;  occupied: boxes of earlier names, to which its own is added
    """
    lines = name.get_text().split("\n")
    right, above = _free_side(occupied, at, (max(map(len, lines)), len(lines)), half, preferred)
    name.xy = (float(at[0]), float(at[1]))
    name.xyann = (gap if right else -gap, 4 if above else -4)
    name.set(ha="left" if right else "right", va="bottom" if above else "top")


def _free_side(
    occupied: list[tuple[float, float, float, float]],
    at: Floats,
    size: tuple[int, int],
    half: float,
    preferred: tuple[bool, bool],
) -> tuple[bool, bool]:
    """(right, above): the side of a position where a label does not overlap others.

    occupied: boxes of earlier labels (left, right, bottom, top), m; the new one is appended
    size: letters in a line, and lines
    """
    letters, lines = size
    width, height, gap = 0.045 * letters * half, (0.02 + 0.07 * lines) * half, 0.03 * half
    right, above = preferred
    for choice in ((right, above), (right, not above), (not right, above), (not right, not above)):
        left = at[0] + gap if choice[0] else at[0] - gap - width
        low = at[1] + gap if choice[1] else at[1] - gap - height
        box = (left - gap, left + width + gap, low, low + height)
        if not any(box[0] < t[1] and t[0] < box[1] and box[2] < t[3] and t[2] < box[3] for t in occupied):
            occupied.append(box)
            return choice
    return right, above


def key(views: Sequence[Frame], *, agents: bool = True) -> list[Artist]:
    """Legend handles for `views`: all outcomes, and agents and attacks if present."""
    shown = {name for view in views for of in view.boxes.values() for name, boxes in of.items() if len(boxes)}
    handles = outcome_handles(OUTCOME_COLOURS, shown)
    if agents and any(v.run.files.scene is not None for v in views):
        states = {state for v in views for state in states_at(v.run, v.index).values()}
        handles.append(mark_handle("o", WITHHELD if states else AGENT, "vehicle with sensors", hollow=True))
        handles.append(mark_handle("^", WITHHELD if states else AGENT, "roadside sensor"))
        attacked = any(adversaries_by_agent(interposers(v.run)) for v in views)
        handles += [mark_handle("^", STATES[state], f"{state} agent") for state in STATES if state in states]
        if attacked:
            name = Line2D([], [], linestyle="", marker="$name$", ms=24, mew=0.0, color=ADVERSARY)
            name.set_label("adversary on its wire")
            handles.append(name if states else mark_handle("^", ADVERSARY, "adversary on its wire"))
    if any(len(withheld_at(v.run, v.index)) for v in views):
        handles.append(Patch(facecolor="none", edgecolor=WITHHELD, linewidth=1.2, linestyle=DASHED, label="withheld"))
    return handles + manipulation_handles([v.before.joined(v.behind) for v in views], ADVERSARY)


def outcome_handles(colours: Mapping[str, str], shown: Collection[str]) -> list[Artist]:
    """Legend handles for the outcomes of boxes; unevaluated ones only if they are shown."""
    return [
        Patch(facecolor=face(name, colours[name]), edgecolor=colours[name], linewidth=1.5, label=OUTCOME_LABELS[name])
        for name in ("truth matched", "track matched", "truth missed", "track false", "unevaluated")
        if name != "unevaluated" or name in shown
    ]


def manipulation_handles(marks: Sequence[Changes], colour: str, size: float = 8) -> list[Artist]:
    """Legend handles for what adversaries did."""
    kinds = (("added", "D", "inserted"), ("removed", "x", "removed"), ("moved", "$\\rightarrow$", "moved"))
    return [
        mark_handle(marker, colour, f"{done} by adversary", hollow=marker == "D", size=size)
        for kind, marker, done in kinds
        if any(len(getattr(each, kind)) for each in marks)
    ]


def mark_handle(marker: str, colour: str, label: str, *, hollow: bool = False, size: float = 8) -> Line2D:
    """A legend handle for a mark; hollow: its outline alone."""
    inside = "none" if hollow else colour
    return Line2D([], [], linestyle="", marker=marker, ms=size, mfc=inside, mec=colour, mew=1.5, label=label)


_SEEN, _UNSEEN, _DETECTION = OUTCOME_COLOURS["truth matched"], OUTCOME_COLOURS["unevaluated"], "#56b4e9"
_MARGIN_M = 12.0
_FARTHEST_M = 110.0  # objects beyond this distance from all agents do not widen the window


def scene_figure(recording: Recording, frame: int) -> Figure:
    """Draw a frame: boxes by whether an agent sees them, detections, and the agents with their ranges."""
    truth = recording.truth_at(frame)
    seen: Bools = np.asarray((recording.points_at(frame) >= SEEN_RETURNS).any(axis=1))
    agents = recording.agent_position[frame, :, :2]
    figure = Figure(figsize=(9.0, 9.4), facecolor=GROUND)
    axes = figure.add_axes((0.09, 0.12, 0.88, 0.83))
    dark_axes(axes)
    near = np.linalg.norm(truth.position[:, None, :2] - agents[None], axis=2).min(axis=1) <= _FARTHEST_M
    shown = np.concatenate([agents, truth.position[near, :2]])
    centre, half = (shown.min(axis=0) + shown.max(axis=0)) / 2, (np.ptp(shown, axis=0).max() / 2) + _MARGIN_M
    axes.set_xlim(centre[0] - half, centre[0] + half)
    axes.set_ylim(centre[1] - half, centre[1] + half)
    axes.set_aspect("equal")
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.set_xlabel("x, east (m)", color=FAINT)
    axes.set_ylabel("y, north (m)", color=FAINT)
    seconds = (recording.times_ns[frame] - recording.times_ns[0]) * 1e-9
    axes.set_title(plain(f"{recording.name}, t = {seconds:.1f} s (frame {frame})"), color=_SEEN, loc="left")
    walls = PolyCollection(list(recording.buildings), facecolors=BUILDING, edgecolors=BUILDING_EDGE, zorder=1)
    axes.add_collection(walls)
    for chosen, colour in ((~seen, _UNSEEN), (seen, _SEEN)):
        boxes = Boxes.unnamed(truth.position[chosen], truth.size[chosen], truth.yaw[chosen])
        BoxArtists(axes, colour, 3).show(boxes)
    occupied: list[tuple[float, float, float, float]] = []
    for column, agent in enumerate(recording.agents):
        _draw_scene_agent(axes, recording, frame, column)
        name = axes.annotate(plain(agent.name), (0, 0), (0, 0), textcoords="offset points")
        name.set(color=AGENT, fontsize=9, zorder=6)
        place_name(name, recording.agent_position[frame, column], half, occupied, gap=6)
        pose = recording.agent_position[frame, column], recording.agent_rotation[frame, column]
        for row in range(len(agent.sensors)):
            sensor = sensor_pose(*pose, *recording.mount_at(frame, column, row))
            found = to_world(recording.detections_at(frame, column, row), *sensor)
            axes.plot(*found.position[:, :2].T, "+", color=_DETECTION, ms=6, mew=1.1, zorder=4)
    handles = [
        Patch(facecolor="none", edgecolor=_SEEN, label=f"seen ({SEEN_RETURNS} lidar returns)"),
        Patch(facecolor="none", edgecolor=_UNSEEN, label="not seen"),
        Line2D([], [], marker="+", linestyle="", color=_DETECTION, label="detection"),
        Line2D([], [], marker="o", linestyle="", mfc="none", color=AGENT, label="car with a sensor"),
        Line2D([], [], marker="^", linestyle="", color=AGENT, label="pole"),
    ]
    figure.legend(handles=handles, loc="lower center", ncols=5, frameon=False, labelcolor=_SEEN, fontsize=9.5)
    return figure


def _draw_scene_agent(axes: Axes, recording: Recording, frame: int, column: int) -> None:
    """A marker, and the sensor's sector at its true range."""
    agent = recording.agents[column]
    x, y = recording.agent_position[frame, column, :2]
    facing = float(np.degrees(heading(recording.agent_rotation[frame, column] @ agent.sensor.mount_rotation)))
    low, high = facing + agent.sensor.azimuth_min_deg, facing + agent.sensor.azimuth_max_deg
    sector = Wedge((x, y), agent.sensor.max_range_m, low, high, zorder=2)
    sector.set(facecolor=to_rgba(AGENT, 0.03), edgecolor=to_rgba(AGENT, 0.3), linewidth=0.7)
    axes.add_patch(sector)
    marker, inside = ("^", AGENT) if agent.kind == "static" else ("o", "none")
    axes.plot(x, y, marker, ms=8, mfc=inside, mec=AGENT, mew=1.4, zorder=5)
