"""The panels of a film: the bird's-eye view with driven cars, and the errors over time."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator, NullLocator

from mast_zenoh.arrays.states import Floats
from mast_zenoh.launch.twin import NAME
from mast_zenoh.runs.driven import NEEDLESSLY, ROLLS, braking_of, cars_of, course_of, twin_course
from mast_zenoh.runs.events import spans
from mast_zenoh.runs.files import Table
from mast_zenoh.runs.frame import Frame
from mast_zenoh.show.figures.birdseye import GRID_M, LOWEST_MARK, BirdseyePanel, points, scale_of
from mast_zenoh.show.figures.style import Theme, plain
from mast_zenoh.show.figures.window import Window
from mast_zenoh.show.film.takes import Take


class FilmPanel(BirdseyePanel):
    """A bird's-eye view that shows whether an attack is on, and how cars are driven.

    window: of the first frame; all have one size
    """

    def __init__(self, axes: Axes, take: Take, theme: Theme, window: Window) -> None:
        super().__init__(axes, take.run, take.estimate, theme)
        self._attacks = take.attacks
        axes.tick_params(length=0, labelbottom=False, labelleft=False)
        length = GRID_M / (2 * window.across)
        if length < 0.5:
            style: dict[str, Any] = {"transform": axes.transAxes, "color": theme.faint, "zorder": 1.5}
            axes.add_artist(Line2D([0.98 - length, 0.98], [0.025, 0.025], **style))
            axes.text(0.98, 0.032, f"{GRID_M:g} m", ha="right", va="bottom", fontsize=8.5, **style)
        scale = scale_of(axes)
        self.drives = DriveMarks(axes, take, theme, scale)
        self.alarm = Rectangle((0, 0), 1, 1, transform=axes.transAxes, fill=False, zorder=7)
        self.alarm.set(edgecolor=theme.adversary, linewidth=4.0 * scale)
        axes.add_patch(self.alarm)
        self.over = axes.text(0.5, 0.5, "this run has ended", transform=axes.transAxes, zorder=8)
        self.over.set(ha="center", va="center", color=theme.ink, fontsize=12, fontweight="bold")
        self.over.set_bbox({"facecolor": theme.ground, "edgecolor": theme.faint, "alpha": 0.9})

    @property
    def changing(self) -> list[Artist]:
        """The artists that differ from frame to frame, in drawing order: all but the ground and buildings."""
        above = (artist for artist in self.axes.get_children() if artist.get_zorder() >= LOWEST_MARK)
        return sorted(above, key=lambda artist: artist.get_zorder())

    def show(self, frame: Frame, window: Window) -> None:
        """Move everything to a frame of the run."""
        super().show(frame, window)
        self.drives.show(frame.index, window)
        self.alarm.set_visible(self._attacks.on(frame.index))


#: m: from the middle of a car to its rear lights, and their width. Share of the window: at least.
_REAR_M, _WIDE_M, _LEAST_SHARE = 2.3, 1.9, 0.03


class DriveMarks:
    """The driven cars: rear lights when they brake, speed and acceleration, and the ways of their unattacked twins.

    scale: of marks and letters
    """

    def __init__(self, axes: Axes, take: Take, theme: Theme, scale: float) -> None:
        self._take, self._theme = take, theme
        courses = [(car, course_of(take.run, car)) for car in cars_of(take.run)]
        self._cars = [(car, course, twin_course(take.run, car)) for car, course in courses if course is not None]
        self.lights = LineCollection([], linewidths=4.0 * scale, zorder=6.5, capstyle="butt")
        axes.add_collection(self.lights)
        dashed: dict[str, Any] = {"color": theme.faint, "linestyle": (0, (4, 3)), "zorder": 2.4}
        for _, _, twin in self._cars:
            if twin is not None:
                axes.plot(twin["x"], twin["y"], linewidth=1.3 * scale, **dashed)
        self._ghosts = points(axes, "o", theme.faint, 8.5 * scale, 1.4 * scale, zorder=4.9)
        self.text = axes.text(0.015, 0.985, "", transform=axes.transAxes, ha="left", va="top", zorder=8)
        self.text.set(color=theme.ink, fontsize=max(9.5 * scale, 6.5), linespacing=1.25)
        self.text.set_bbox({"facecolor": theme.ground, "edgecolor": "none", "alpha": 0.7, "pad": 1.5})

    def show(self, frame: int, window: Window) -> None:
        """Move the marks to a frame."""
        now = np.array([self._take.seconds(frame)])
        lights, colours, lines, ghosts = [], [], [], []
        for car, course, twin in self._cars:
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
                row = _row_of(twin, frame)
                ghosts.append((twin["x"][row], twin["y"][row]))
                lines.append(f"{NAME} {twin['speed_mps'][row]:.1f} m/s (broken line)")
        self.lights.set_segments(lights)
        self.lights.set_color(colours)
        self._ghosts.set_data(*np.array(ghosts).reshape(-1, 2).T)
        self.text.set_text(plain("\n".join(lines)))


def _row_of(course: Table, frame: int) -> int:
    """The row of a frame, or of the last one before it."""
    return max(int(np.searchsorted(course["frame"], frame, side="right")) - 1, 0)


def _rear(place: Floats, heading: float, least: float) -> Floats:
    """(2, 2) m, a line across the rear of a car. least: m, its distance from the middle, and half its length"""
    ahead = np.array([np.cos(heading), np.sin(heading)])
    left = np.array([-ahead[1], ahead[0]]) * max(_WIDE_M / 2.0, least)
    back = place - ahead * max(_REAR_M, least)
    return np.stack([back - left, back + left])


class Strip:
    """Missed and false objects over the time of the film.

    limits: s, of the film
    most: the greatest number of objects in a scored frame;  now: the line at the time of the frame
    """

    def __init__(self, axes: Axes, take: Take, limits: tuple[float, float], theme: Theme) -> None:
        self.axes, (low, high) = axes, limits
        axes.set_xlim(low, max(high, low + 1e-3))
        axes.set_facecolor(theme.ground)
        axes.tick_params(colors=theme.faint, labelsize=8, length=2, pad=1.5)
        axes.xaxis.set_major_locator(MaxNLocator(8))
        axes.xaxis.set_major_formatter("{x:g} s")
        for side, spine in axes.spines.items():
            spine.set_visible(side in ("left", "bottom"))
            spine.set_color(theme.building_edge)
        self._draw_bands(take, theme)
        scores = {frame: score for frame, score in take.scores.items() if low <= take.seconds(frame) <= high}
        axes.yaxis.set_major_locator(MaxNLocator(2, integer=True) if scores else NullLocator())
        times = [take.seconds(frame) for frame in scores]
        for name, outcome in (("fn", "truth missed"), ("fp", "track false")):
            numbers = [getattr(score, name) for score in scores.values()]
            axes.plot(times, numbers, color=theme.outcomes[outcome], linewidth=1.3, zorder=3)
        # The axis fits the scored frames: before them, everything is missed.
        first, last = take.run.scored_frames or (take.first, take.last)
        scored = [score for frame, score in scores.items() if first <= frame <= last] or scores.values()
        self.most = max((max(score.fn, score.fp) for score in scored), default=1)
        self.now = axes.axvline(low, color=theme.ink, linewidth=1.4, zorder=4)

    def _draw_bands(self, take: Take, theme: Theme) -> None:
        for start, end in take.attacks.spans:
            until = take.seconds(end - 1) + take.run.period_s
            self.axes.axvspan(take.seconds(start), until, color=theme.adversary, alpha=0.28, lw=0)
        for each in spans(take.run, take.times):
            if each["kind"] == "fault":
                self.axes.axvspan(each["from_s"], each["until_s"], color=theme.fault, alpha=0.25, lw=0)
            elif each["kind"] == "interception":
                for edge in (each["from_s"], each["until_s"]):
                    self.axes.axvline(edge, color=theme.adversary, linewidth=1.2, linestyle=(0, (3, 2)), zorder=2)

    def set_most(self, most: int) -> None:
        """Set the greatest number of objects on the axis."""
        most = max(most, 1)
        self.axes.set_ylim(-0.04 * most, 1.12 * most)
