"""The agents in a panel from above: where they are, what their sensors cover, and what is wrong with them."""

from __future__ import annotations

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.text import Annotation

from mast_zenoh.arrays.geometry import heading
from mast_zenoh.arrays.states import Floats
from mast_zenoh.report.figures.birdseye import free_side
from mast_zenoh.report.figures.style import plain
from mast_zenoh.report.film.framing import Window
from mast_zenoh.report.film.takes import Take
from mast_zenoh.report.film.theme import Theme
from mast_zenoh.report.playback.conduct import node_absences
from mast_zenoh.report.trust_facts import states_at
from mast_zenoh.sensing.sensors import LidarSensor

#: Of a sensor's outline: its points, how opaque it is, and the number of agents above which it is fainter.
_POINTS, _OPACITY, _MANY = 49, 0.35, 6


class AgentMarks:
    """A triangle (roadside) or a circle (vehicle) with a name for each agent, and the limits of its sensor.

    scale: of marks and letters
    """

    def __init__(self, axes: Axes, take: Take, theme: Theme, scale: float) -> None:
        self._recording, self._run, self._theme = take.run.recording, take.run, theme
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
            trouble = "down" if agent.name in down else state if state in ("faulty", "suspended") else ""
            label = f"{agent.name}\n{trouble}" if trouble else agent.name
            name.set(text=plain(label), color=adversary or colour, fontweight="bold" if adversary else "normal")
            _place(name, position, turn, window, occupied)
        self._ranges.set_segments(outlines)
        self._ranges.set_color(colours)


def _place(
    name: Annotation,
    position: Floats,
    turn: float,
    window: Window,
    occupied: list[tuple[float, float, float, float]],
) -> None:
    """Put a name behind the agent, where no earlier name is. It depends on nothing but the frame."""
    behind = -np.array([np.cos(turn), np.sin(turn)])
    offset = np.abs(position[:2] + behind * 0.25 * window.half - [window.x, window.y])
    preferred = np.where(offset < [window.across, window.up], behind, -behind) > 0
    letters = max(map(len, name.get_text().split("\n")))
    right, above = free_side(occupied, position, letters, window.half, preferred)
    name.xy = (float(position[0]), float(position[1]))
    name.xyann = (7 if right else -7, 4 if above else -4)
    name.set(ha="left" if right else "right", va="bottom" if above else "top")


def _sector(position: Floats, turn: float, sensor: LidarSensor) -> Floats:
    """(k, 2) m, the outline of what a sensor covers."""
    start, end = np.radians([sensor.azimuth_min_deg, sensor.azimuth_max_deg])
    bearings = turn + np.linspace(start, end, _POINTS)
    arc = position[:2] + sensor.max_range_m * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    if end - start > np.radians(359.0):
        return arc
    return np.concatenate([position[None, :2], arc, position[None, :2]])
