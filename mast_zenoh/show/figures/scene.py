"""A frame of a scene without a run: its objects, and what the agents see."""

from __future__ import annotations

import numpy as np
from matplotlib.patches import Patch

from mast_zenoh.arrays.boxes import Boxes
from mast_zenoh.arrays.states import Bools
from mast_zenoh.scenes.recording import SEEN_RETURNS, Recording
from mast_zenoh.sensing import sensor_pose, to_world
from mast_zenoh.show.figures.birdseye import AgentLook, AgentMarks, BoxArtists, draw_ground
from mast_zenoh.show.figures.legend import draw_legend, mark_entry
from mast_zenoh.show.figures.style import THEMES, Figure, plain
from mast_zenoh.show.figures.view import Window

_DETECTION = "#56b4e9"
_FARTHEST_M = 110.0  # objects beyond this distance from all agents do not widen the window


def scene_figure(recording: Recording, frame: int) -> Figure:
    """Draw a frame: boxes by whether an agent sees them, detections, and the agents with their ranges."""
    theme, truth = THEMES["dark"], recording.truth_at(frame)
    seen: Bools = np.asarray((recording.points_at(frame) >= SEEN_RETURNS).any(axis=1))
    agents = recording.agent_position[frame, :, :2]
    near = np.linalg.norm(truth.position[:, None, :2] - agents[None], axis=2).min(axis=1) <= _FARTHEST_M
    window = Window.around(np.concatenate([agents, truth.position[near, :2]]))
    figure = Figure(figsize=(9.0, 9.4), facecolor=theme.ground)
    axes = figure.place(0.85, 0.5, 7.95, 7.95)
    draw_ground(axes, recording, theme)
    window.apply(axes)
    axes.set_xlabel("x, east (m)", color=theme.faint)
    axes.set_ylabel("y, north (m)", color=theme.faint)
    seconds = (recording.times_ns[frame] - recording.times_ns[0]) * 1e-9
    axes.set_title(plain(f"{recording.name}, t = {seconds:.1f} s (frame {frame})"), color=theme.ink, loc="left")
    colours = {True: theme.outcomes["truth matched"], False: theme.outcomes["unevaluated"]}
    for is_seen, colour in colours.items():
        chosen = seen == is_seen
        boxes = Boxes.unnamed(truth.position[chosen], truth.size[chosen], truth.yaw[chosen])
        BoxArtists(axes, colour, 3).show(boxes)
    looks = {name: AgentLook(theme.agent, theme.agent, name) for name in recording.agent_names}
    AgentMarks(axes, recording, theme, 1.0).show(frame, window, looks)
    for column, agent in enumerate(recording.agents):
        pose = recording.agent_position[frame, column], recording.agent_rotation[frame, column]
        for row in range(len(agent.sensors)):
            sensor = sensor_pose(*pose, *recording.mount_at(frame, column, row))
            found = to_world(recording.detections_at(frame, column, row), *sensor)
            axes.plot(*found.position[:, :2].T, "+", color=_DETECTION, ms=6, mew=1.1, zorder=4)
    entries = [
        Patch(facecolor="none", edgecolor=colours[True], label=f"seen ({SEEN_RETURNS} lidar returns)"),
        Patch(facecolor="none", edgecolor=colours[False], label="not seen"),
        mark_entry("+", _DETECTION, "detection"),
        mark_entry("o", theme.agent, "car with a sensor", hollow=True),
        mark_entry("^", theme.agent, "pole"),
    ]
    draw_legend(figure, entries, theme, 9.5)
    return figure
