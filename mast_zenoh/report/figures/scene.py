"""A frame of a scene from above: objects, agents and detections, without a run."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Wedge

from mast_zenoh.arrays.geometry import heading
from mast_zenoh.arrays.states import Bools
from mast_zenoh.report.figures.birdseye import draw_boxes, free_side
from mast_zenoh.report.figures.style import (
    AGENT,
    BUILDING,
    BUILDING_EDGE,
    FAINT,
    GRID,
    GROUND,
    OUTCOME_COLOURS,
    Figure,
    dark_axes,
    plain,
)
from mast_zenoh.report.figures.view import Boxes
from mast_zenoh.scenes.recording import SEEN_RETURNS, Recording
from mast_zenoh.sensing import sensor_pose, to_world

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
        _draw_agent(axes, recording, frame, column)
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


def _draw_agent(axes: Axes, recording: Recording, frame: int, column: int) -> None:
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
