"""A frame from above: boxes, buildings, agents and manipulations; of a run, or of a scene without one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import patheffects
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Wedge
from matplotlib.ticker import MultipleLocator

from mast_zenoh.arrays.geometry import box_corners, heading
from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.metrics.estimates import OWN
from mast_zenoh.report.figures.style import Figure, dark_axes, plain
from mast_zenoh.scenes.recording import SEEN_RETURNS, Recording
from mast_zenoh.sensing import sensor_pose, to_world
from mast_zenoh.viewer.events import states_at, withheld_at
from mast_zenoh.viewer.frame import Boxes, Frame, Marks
from mast_zenoh.viewer.interposers import adversaries_by_agent, interposers
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
    WITHHELD,
)

#: Minimum length and width of drawn boxes, m, so that pedestrians are visible.
_SMALLEST = 1.4

#: Drawing order of marks of adversaries: above buildings, below boxes.
_MARKS = 2.5
#: Line style of withheld objects.
_DASHED = (0, (3.0, 2.0))

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
    recording = view.run.recording
    if recording is not None:
        axes.add_collection(
            PolyCollection(list(recording.buildings), facecolors=BUILDING, edgecolors=BUILDING_EDGE, zorder=1)
        )
    for order, (outcome, colour) in enumerate(OUTCOME_COLOURS.items()):
        _draw_outcome(axes, view.boxes[estimator][outcome], outcome, colour, 3 + 0.1 * order)
    if estimator not in OWN:
        _draw_withheld(axes, view)
    _draw_attack(axes, view.marks(estimator))
    _draw_agents(axes, view, window)


def _draw_outcome(axes: Axes, boxes: Boxes, outcome: str, colour: str, zorder: float) -> None:
    filled = outcome in ("truth missed", "track false")
    width = 1.3 if outcome == "track matched" else 1.6
    draw_boxes(axes, boxes, colour, zorder, width=width, filled=filled, crossed=outcome == "track false")


def draw_boxes(
    axes: Axes,
    boxes: Boxes,
    colour: str,
    zorder: float,
    *,
    width: float,
    filled: bool = False,
    crossed: bool = False,
) -> None:
    """Outlines with a line ahead. crossed: crossed out as well, for colour-blind readers"""
    if not len(boxes):
        return
    size = np.maximum(boxes.size, _SMALLEST)
    corners = box_corners(boxes.position, size, boxes.yaw)[:, :4, :2]
    axes.add_collection(
        PolyCollection(
            list(corners),
            facecolors=to_rgba(colour, 0.35 if filled else 0.0),
            edgecolors=colour,
            linewidths=width,
            zorder=zorder,
        )
    )
    ahead = np.stack([np.cos(boxes.yaw), np.sin(boxes.yaw)], axis=1)
    centre = boxes.position[:, :2]
    ticks = np.stack([centre, centre + ahead * (size[:, :1] / 2 + 1.2)], axis=1)
    lines = [ticks]
    if crossed:
        lines += [corners[:, [0, 2]], corners[:, [1, 3]]]
    axes.add_collection(LineCollection(list(np.concatenate(lines)), colors=colour, linewidths=1.1, zorder=zorder))


def _draw_withheld(axes: Axes, view: Frame) -> None:
    position, size, yaw = withheld_at(view.run, view.index)
    if len(yaw):
        corners = box_corners(position, np.maximum(size, _SMALLEST), yaw)[:, :4, :2]
        boxes = PolyCollection(list(corners), facecolors="none", edgecolors=WITHHELD, linewidths=1.2, zorder=3.5)
        boxes.set_linestyle(_DASHED)
        axes.add_collection(boxes)


def _draw_attack(axes: Axes, marks: Marks) -> None:
    # Larger than most boxes and below them, so that marks hide nothing.
    if len(marks.added):
        axes.plot(*marks.added[:, :2].T, "D", ms=14, mfc="none", mec=ADVERSARY, mew=1.2, zorder=_MARKS)
    if len(marks.removed):
        axes.plot(*marks.removed[:, :2].T, "x", ms=16, color=ADVERSARY, mew=1.4, zorder=_MARKS)
    for before, after in marks.moved:
        arrow = {"arrowstyle": "->", "color": ADVERSARY, "lw": 1.5}
        axes.annotate("", after[:2], before[:2], arrowprops=arrow, annotation_clip=True, zorder=_MARKS)


def _draw_agents(axes: Axes, view: Frame, window: tuple[float, float, float]) -> None:
    recording = view.run.recording
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
        label = f"{agent.name}\n{state}" if state in ("faulty", "suspended") else agent.name
        sector = agent.sensor.azimuth_max_deg - agent.sensor.azimuth_min_deg
        facing = recording.agent_rotation[view.index, index] @ agent.sensor.mount_rotation
        turn = float(heading(facing))
        if sector < 359.0:
            start = np.degrees(turn) + agent.sensor.azimuth_min_deg
            wedge = Wedge((position[0], position[1]), agent.sensor.max_range_m, start, start + sector)
            wedge.set(facecolor="none", edgecolor=to_rgba(colour, 0.3), linewidth=0.8, zorder=2)
            axes.add_patch(wedge)
        marker, face = ("^", colour) if agent.kind == "static" else ("o", "none")
        axes.plot(position[0], position[1], marker, ms=9, mfc=face, mec=colour, mew=1.5, zorder=5)
        # The name goes behind the agent, away from where it looks and the observed traffic.
        behind = -np.array([np.cos(turn), np.sin(turn)])
        inside = np.abs(position[:2] + behind * 0.25 * half - [x, y]) < half
        letters = max(map(len, label.split("\n")))
        side = free_side(occupied, position, letters, half, np.where(inside, behind, -behind) > 0)
        axes.annotate(
            plain(label),
            (position[0], position[1]),
            (7 if side[0] else -7, 4 if side[1] else -4),
            textcoords="offset points",
            ha="left" if side[0] else "right",
            va="bottom" if side[1] else "top",
            color=name_colour,
            fontsize=10,
            linespacing=1.0,
            fontweight="bold" if name_colour == ADVERSARY else "normal",
            path_effects=_HALO,
            zorder=6,
        )


def free_side(
    occupied: list[tuple[float, float, float, float]], at: Floats, letters: int, half: float, preferred: Bools
) -> tuple[bool, bool]:
    """(right, above): the side of a position where a label does not overlap others.

    preferred: used if free

    occupied: boxes of earlier labels (left, right, bottom, top), m; the new one is appended
    """
    width, height, gap = 0.045 * letters * half, 0.09 * half, 0.03 * half
    right, above = bool(preferred[0]), bool(preferred[1])
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
    handles: list[Artist] = []
    for outcome in ("truth matched", "track matched", "truth missed", "track false", "unevaluated"):
        if outcome == "unevaluated" and not any(len(of[outcome]) for v in views for of in v.boxes.values()):
            continue
        colour = OUTCOME_COLOURS[outcome]
        filled = to_rgba(colour, 0.35 if outcome in ("truth missed", "track false") else 0.0)
        handles.append(Patch(facecolor=filled, edgecolor=colour, linewidth=1.5, label=OUTCOME_LABELS[outcome]))
    if agents and any(v.run.recording is not None for v in views):
        states = {state for v in views for state in states_at(v.run, v.index).values()}
        handles.append(_marker("o", WITHHELD if states else AGENT, "vehicle with sensors", hollow=True))
        handles.append(_marker("^", WITHHELD if states else AGENT, "roadside sensor"))
        attacked = any(adversaries_by_agent(interposers(v.run)) for v in views)
        handles += [_marker("^", STATES[state], f"{state} agent") for state in STATES if state in states]
        if attacked:
            name = Line2D([], [], linestyle="", marker="$name$", ms=24, mew=0.0, color=ADVERSARY)
            name.set_label("adversary on its wire")
            handles.append(name if states else _marker("^", ADVERSARY, "adversary on its wire"))
    if any(len(withheld_at(v.run, v.index)[2]) for v in views):
        handles.append(Patch(facecolor="none", edgecolor=WITHHELD, linewidth=1.2, linestyle=_DASHED, label="withheld"))
    marks = [v.before.joined(v.behind) for v in views]
    if any(len(each.added) for each in marks):
        handles.append(_marker("D", ADVERSARY, "inserted by adversary", hollow=True))
    if any(len(each.removed) for each in marks):
        handles.append(_marker("x", ADVERSARY, "removed by adversary"))
    if any(len(each.moved) for each in marks):
        handles.append(_marker("$\\rightarrow$", ADVERSARY, "moved by adversary"))
    return handles


def _marker(marker: str, colour: str, label: str, *, hollow: bool = False) -> Line2D:
    face = "none" if hollow else colour
    return Line2D([], [], linestyle="", marker=marker, ms=8, mfc=face, mec=colour, mew=1.5, label=label)


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
        boxes = Boxes(truth.position[chosen], truth.size[chosen], truth.yaw[chosen])
        draw_boxes(axes, boxes, colour, 3, width=1.2)
    occupied: list[tuple[float, float, float, float]] = []
    for column, agent in enumerate(recording.agents):
        _draw_scene_agent(axes, recording, frame, column)
        _write_name(axes, recording, frame, column, half, occupied)
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
    """A marker, the name, and the sensor's sector at its true range."""
    agent = recording.agents[column]
    x, y = recording.agent_position[frame, column, :2]
    facing = float(np.degrees(heading(recording.agent_rotation[frame, column] @ agent.sensor.mount_rotation)))
    low, high = facing + agent.sensor.azimuth_min_deg, facing + agent.sensor.azimuth_max_deg
    sector = Wedge((x, y), agent.sensor.max_range_m, low, high, zorder=2)
    sector.set(facecolor=to_rgba(AGENT, 0.03), edgecolor=to_rgba(AGENT, 0.3), linewidth=0.7)
    axes.add_patch(sector)
    marker, face = ("^", AGENT) if agent.kind == "static" else ("o", "none")
    axes.plot(x, y, marker, ms=8, mfc=face, mec=AGENT, mew=1.4, zorder=5)


def _write_name(
    axes: Axes,
    recording: Recording,
    frame: int,
    column: int,
    half: float,
    occupied: list[tuple[float, float, float, float]],
) -> None:
    """An agent's name where no other is. half: m, of the window; occupied: by earlier names"""
    name, at = recording.agents[column].name, recording.agent_position[frame, column, :2]
    right, above = free_side(occupied, at, len(name), half, np.array([True, True]))
    axes.annotate(
        plain(name),
        (at[0], at[1]),
        (6 if right else -6, 4 if above else -4),
        textcoords="offset points",
        ha="left" if right else "right",
        va="bottom" if above else "top",
        color=AGENT,
        fontsize=9,
        zorder=6,
    )
