"""The course of a driven car: its path beside the reference's, speed and acceleration over time, and its brakes."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from mast_zenoh.driving.motion import HARD_BRAKING_MPS2
from mast_zenoh.runs.driven import brakes_of, course_of
from mast_zenoh.runs.files import Table
from mast_zenoh.runs.run import Run
from mast_zenoh.show.comparison import Reference
from mast_zenoh.show.figures.birdseye import draw_ground
from mast_zenoh.show.figures.over_time import handles_of, legend_above
from mast_zenoh.show.figures.style import THEMES, Figure, light_axes, plain
from mast_zenoh.show.figures.timeaxis import padded
from mast_zenoh.show.figures.view import Window
from mast_zenoh.show.palette import ADVERSARY_ON_LIGHT, INK, KEYS, LOCAL, RUN_COLOURS

#: Of needless brakes, and of others.
_NEEDLESS, _BRAKE = KEYS["paper"]["light"].outcomes["track false"], "#9aa3ad"
#: Inches: the figure; the map's side; margins.
_WIDTH, _HEIGHT, _MAP, _LEFT, _FOOT, _HEAD = 11.5, 4.6, 3.62, 0.6, 0.5, 0.46
#: m/s^2, of the axis at least.
_LEAST_MPS2 = (-3.0, 2.0)


def driven_figure(run: Run, reference: Reference | None = None) -> Figure | None:
    """The course of the driven car, the ego if it is driven; None: no car is driven, or its course is unknown."""
    course = course_of(run)
    if course is None:
        return None
    car = str(course["agent"][0])
    other = course_of(reference.run, car) if reference is not None else None
    figure = Figure(figsize=(_WIDTH, _HEIGHT), facecolor="white")
    brakes = brakes_of(run, car)
    _draw_map(figure.place(_LEFT, _HEIGHT - _FOOT - _MAP, _MAP, _MAP), run, course, other, brakes)
    charts = _chart_axes(figure)
    for axis in charts:
        light_axes(axis)
        _draw_bands(axis, run, brakes)
    courses: dict[str, tuple[Table, str, Any]] = {}
    if reference is not None and other is not None:
        courses[reference.name] = other, LOCAL, (0, (4, 2))
    courses[f"{car}, {run.name}" if courses else car] = course, RUN_COLOURS[0], "-"
    for label, (table, colour, dashes) in courses.items():
        style: dict[str, Any] = {"color": colour, "linestyle": dashes, "linewidth": 1.9}
        charts[0].plot(table["time_s"], table["speed_mps"], label=plain(label), **style)
        charts[1].plot(table["time_s"], table["acceleration_mps2"], drawstyle="steps-post", **style)
    charts[0].set_ylim(0.0, 1.15 * max(float(table["speed_mps"].max()) for table, *_ in courses.values()) + 0.5)
    charts[0].set_ylabel("speed (m/s)", fontsize=10, color=INK)
    charts[1].set_ylabel("acceleration (m/s²)", fontsize=10, color=INK)
    charts[1].axhline(-HARD_BRAKING_MPS2, color=INK, linewidth=0.9, linestyle=(0, (1, 2)), label="hard braking")
    least = [float(np.nanmin(table["acceleration_mps2"], initial=_LEAST_MPS2[0])) for table, *_ in courses.values()]
    most = [float(np.nanmax(table["acceleration_mps2"], initial=_LEAST_MPS2[1])) for table, *_ in courses.values()]
    charts[1].set_ylim(1.1 * min(least), 1.1 * max(most))
    charts[1].set_xlim(*padded(float(course["time_s"][0]), float(course["time_s"][-1])))
    charts[1].set_xlabel("time (s)", fontsize=10, color=INK)
    handles, corner = handles_of(charts), ((_LEFT + _MAP + 0.62) / _WIDTH, 1.0)
    style = {"bbox_to_anchor": corner, "fontsize": 9.5, "columnspacing": 1.2, "handlelength": 1.7}
    legend_above(figure, handles, 3 if len(handles) > 4 else 4, **style)
    return figure


def _chart_axes(figure: Figure) -> tuple[Axes, Axes]:
    left, gap, top = _LEFT + _MAP + 0.75, 0.16, _HEAD + 0.18
    width, height = _WIDTH - left - 0.15, (_HEIGHT - _FOOT - top - gap) / 2.0
    lower, upper = (figure.place(left, top + row * (height + gap), width, height) for row in (1, 0))
    upper.sharex(lower)
    upper.tick_params(labelbottom=False)
    return upper, lower


def _draw_map(axes: Axes, run: Run, course: Table, other: Table | None, brakes: Any) -> None:
    """Buildings, the paths, where the car braked, and where it ended."""
    paths = [np.column_stack([table["x"], table["y"]]) for table in (course, other) if table is not None]
    draw_ground(axes, run.files.scene, THEMES["light"])
    Window.around(np.concatenate(paths)).apply(axes)
    axes.set_xlabel("x, east (m)", fontsize=9.5, color=INK, labelpad=1)
    axes.set_ylabel("y, north (m)", fontsize=9.5, color=INK, labelpad=0)
    if other is not None:
        axes.plot(other["x"], other["y"], color=LOCAL, linestyle=(0, (4, 2)), linewidth=1.6, zorder=3)
        axes.plot(other["x"][-1], other["y"][-1], "o", mfc="white", mec=LOCAL, ms=6, zorder=3)
    axes.plot(course["x"], course["y"], color=RUN_COLOURS[0], linewidth=2.6, zorder=4)
    axes.plot(course["x"][-1], course["y"][-1], "o", color=RUN_COLOURS[0], ms=7, zorder=5)
    for brake in brakes:
        during = (course["time_s"] >= brake["from_s"]) & (course["time_s"] < brake["until_s"])
        colour = _NEEDLESS if brake.get("needless", False) else _BRAKE
        axes.plot(course["x"][during], course["y"][during], "s", color=colour, ms=4, zorder=6, linestyle="")
    axes.plot(course["x"][0], course["y"][0], "|", color=INK, ms=9, mew=2, zorder=5)


def _draw_bands(axis: Axes, run: Run, brakes: Any) -> None:
    """The time of the attack, and the brakes."""
    if run.attack_frames is not None:
        first, last = (run.period_s * frame for frame in run.attack_frames)
        axis.axvspan(first, last, color=ADVERSARY_ON_LIGHT, alpha=0.08, linewidth=0, label="attack")
        axis.axvline(first, color=ADVERSARY_ON_LIGHT, linewidth=0.9, alpha=0.6)
    for needless, colour, label in ((False, _BRAKE, "brakes"), (True, _NEEDLESS, "brakes needlessly")):
        for brake in brakes:
            if brake.get("needless", False) is needless:
                axis.axvspan(brake["from_s"], brake["until_s"], color=colour, alpha=0.35, linewidth=0, label=label)
