"""The whole image of a film: its panels, strips, time, numbers, caption and legend."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator, NullLocator

from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import ConfigurationError, RunFolderError
from mast_zenoh.launch.twin import NAME
from mast_zenoh.metrics.estimates import TRUTH
from mast_zenoh.run_folder.finding import sentence
from mast_zenoh.runs.driven import NEEDLESSLY, ROLLS, braking_of, cars_of, course_of, twin_course
from mast_zenoh.runs.events import spans
from mast_zenoh.runs.files import Table
from mast_zenoh.runs.frame import Frame, ego_position
from mast_zenoh.show.figures.birdseye import GRID_M, LOWEST_MARK, BirdseyePanel, points, scale_of
from mast_zenoh.show.figures.camera import draw_camera, ego_eye
from mast_zenoh.show.figures.legend import draw_legend, legend_entries
from mast_zenoh.show.figures.style import Figure, Theme, plain
from mast_zenoh.show.figures.view import Window, window_of
from mast_zenoh.show.film.takes import Captions, Look, Take

#: Inches. Left and right of the panels; between them; between a bird's-eye view and a camera view.
_MARGIN, _GAP, _CAMERA_GAP = 0.12, 0.14, 0.06
#: Heights: of the title and the state of the run; of a panel's title; of the numbers; of a strip, with the labels of
#: its axis; of the caption.
_HEAD, _TITLE, _COUNTS, _STRIP, _LABELS, _CAPTION = 0.58, 0.28, 0.26, 0.5, 0.22, 0.4
#: Above and below the panels of a plain sheet; the least size of a bird's-eye view; left of a strip, for its labels.
_PLAIN_HEAD, _PLAIN_FOOT, _LEAST, _STRIP_LEFT = 0.04, 0.12, 1.0, 0.26
#: Width of a letter for each point of its size. Least widths for text of ordinary size: of a sheet for that of its
#: legend, of a panel for that of its numbers.
_LETTER, _WIDE, _WIDE_COUNTS = 0.0086, 5.0, 4.0
#: Share of the objects on either side that may lie outside the window.
_OUTLIERS = 0.04


class MovingFigure(Figure):
    """A figure whose images for a film are drawn quickly: but for the first, only what changes.

    changing: these artists, in drawing order
    """

    changing: Sequence[Artist] = ()
    _still: Any = None

    def savefig(self, fname: Any, **options: Any) -> None:
        """Write an image as Matplotlib's writers of films ask for it, or else a file of the whole figure."""
        if options.get("format") != "rgba":
            return super().savefig(fname, **options)
        if self._still is None:
            canvas: Any = FigureCanvasAgg(self)
            for artist in self.changing:
                artist.set_animated(True)
            canvas.draw()
            self._still = canvas, canvas.copy_from_bbox(self.bbox)
        canvas, still = self._still
        canvas.restore_region(still)
        for artist in self.changing:
            self.draw_artist(artist)
        fname.write(canvas.buffer_rgba())
        return None


class Sheet:
    """A figure that shows one frame after the other.

    takes:  the panels, from left to right: one run, or two
    frames: of the first take, those that are shown;  period: first and last frame of the strips
    """

    def __init__(self, takes: Sequence[Take], look: Look, frames: Sequence[int], period: tuple[int, int]) -> None:
        self.takes, self._look, self._theme = takes, look, look.colours
        self._width, self._height = (pixels / look.dpi for pixels in look.pixels(len(takes)))
        self.figure = MovingFigure(figsize=(self._width, self._height), dpi=look.dpi, facecolor=self._theme.ground)
        shown = [view for frame in frames for view in self._views(frame)]
        legend = self._draw_legend(shown)
        self._panel = (self._width - 2 * _MARGIN - (len(takes) - 1) * _GAP) / len(takes)
        self._top = (_PLAIN_HEAD if look.plain else _HEAD) + _TITLE
        foot = _PLAIN_FOOT if look.plain else _COUNTS + _STRIP + _LABELS + _CAPTION
        camera = self._camera_height()
        view = self._height - self._top - camera - foot - legend
        if min(view, self._panel) < _LEAST:
            size, hint = "x".join(map(str, look.pixels(len(takes)))), "" if look.plain else ", or plain"
            raise ConfigurationError(
                f"size: found {size} px at {look.dpi} dpi, which leaves no room for {len(takes)} "
                f"panel{'s' * (len(takes) > 1)}: expected a larger size or fewer dpi{hint}"
            )
        self._window = self._choose_window(shown, self._panel / view)
        self.birdseye: list[FilmPanel] = []
        self.cameras: list[Axes] = []
        for left, take in zip(self._lefts, takes, strict=True):
            self._write(left, self._top - 0.09, self._shortened(take.title, 11, self._panel), 11, bold=True)
            axes = self.figure.place(left, self._top, self._panel, view)
            self.birdseye.append(FilmPanel(axes, take, self._theme, self._window))
            if camera:
                top = self._top + view + _CAMERA_GAP
                self.cameras.append(self.figure.place(left, top, self._panel, camera - _CAMERA_GAP))
        self._strips: list[Strip] = []
        if not look.plain:
            self._place_words(period, self._top + view + camera)
        follow = look.window_choice().follow
        moving: list[Artist] = []
        for panel in self.birdseye:
            moving += [panel.axes] if follow else panel.changing
        words = (text for text in self.figure.texts if not text.get_text())  # the others never change
        self.figure.changing = [*moving, *self.cameras, *(strip.now for strip in self._strips), *words]

    @property
    def key(self) -> list[str]:
        """Colours that a film keeps exactly."""
        theme = self._theme
        return list(dict.fromkeys([theme.ground, theme.ink, theme.adversary, theme.building, *theme.outcomes.values()]))

    @property
    def _lefts(self) -> list[float]:
        """Inches, where the panels begin."""
        return [_MARGIN + index * (self._panel + _GAP) for index in range(len(self.takes))]

    def _views(self, frame: int) -> list[Frame]:
        """What the panels show in a frame of the first take: the others show the frame at the same time."""
        seconds = self.takes[0].seconds(frame)
        return [take.view(take.frame_at(seconds)) for take in self.takes]

    def _draw_legend(self, shown: Sequence[Frame]) -> float:
        """Create the legend; returns its height in inches."""
        entries = legend_entries(shown, self._theme)
        if any(take.attacks.possible for take in self.takes):
            colour = self._theme.adversary
            entries.append(Patch(facecolor=to_rgba(colour, 0.28), edgecolor=colour, label="attack"))
        return draw_legend(self.figure, entries, self._theme, 9.0 if self._width >= _WIDE else 7.0)

    def _camera_height(self) -> float:
        """Inches, of camera views with the gap above them; 0: there are none. Raises RunFolderError without a camera"""
        if not self._look.camera:
            return 0.0
        take = self.takes[0]
        eye = ego_eye(take.view(take.first))
        if eye is None:
            raise RunFolderError(f"{take.run.path}: {take.run.ego} has no camera: it is not in the scene")
        return self._panel * eye.crop_aspect + _CAMERA_GAP

    def _choose_window(self, shown: Sequence[Frame], aspect: float) -> Window:
        """The window of all frames; if it follows an agent, relative to it."""
        follow, centre, half = self._look.window_choice()
        if centre is not None and half is not None:
            return Window.of(centre, half, aspect)
        if half is not None:
            return Window.of((0.0, 0.0), half, aspect)
        return window_of(shown, aspect, _OUTLIERS, follow=follow)

    def _place_words(self, period: tuple[int, int], below: float) -> None:
        """Create all text, and the strips. below: inches, where the views end"""
        first, look = self.takes[0], self._look
        runs = list({take.run.path: take for take in self.takes}.values())
        self._captions = Captions(runs, look.own_captions())
        names = " and ".join(dict.fromkeys(take.run.name for take in self.takes))
        title = look.title if look.title is not None else f"{names}, seen by {first.run.ego}"
        self._write(_MARGIN, 0.25, self._shortened(title, 13.5, self._width - 2.6), 13.5, bold=True)
        self._time = self._write(self._width - _MARGIN, 0.25, "", 11, ha="right")
        self._states = [self._write(left, 0.5, "", 10) for left in self._lefts[: len(runs)]]
        limits = first.seconds(period[0]), first.seconds(period[1])
        self._counts: list[list[Text]] = []
        size = 10 * min(self._panel / _WIDE_COUNTS, 1.0)
        for left, take in zip(self._lefts, self.takes, strict=True):
            colours = [self._theme.outcomes[name] for name in ("truth missed", "track false", "track matched")]
            places = zip((0.0, 0.235, 0.45, 0.71), [*colours, self._theme.ink], strict=True)
            self._counts.append(
                [self._write(left + share * self._panel, below + 0.2, "", size, bold=True, color=colour)
                 for share, colour in places]
            )  # fmt: skip
            axes = self.figure.place(left + _STRIP_LEFT, below + _COUNTS, self._panel - _STRIP_LEFT - 0.08, _STRIP)
            self._strips.append(Strip(axes, take, limits, self._theme))
        for strip in self._strips:  # panels are compared
            strip.set_most(max(each.most for each in self._strips))
        self._caption = self._write(_MARGIN, below + _COUNTS + _STRIP + _LABELS + 0.2, "", 11.5, bold=True)

    def show(self, frame: int) -> None:
        """Move all artists to a frame of the first take; the others show the frame at the same time."""
        seconds, window = self.takes[0].seconds(frame), self._window
        if self._look.window_choice().follow and (at := ego_position(self.takes[0].run, frame)) is not None:
            window = window._replace(x=float(at[0]), y=float(at[1]))
        views = self._views(frame)
        for panel, take, view in zip(self.birdseye, self.takes, views, strict=True):
            panel.show(view, window)
            panel.over.set_visible(take.ended(seconds))
        for axes, take, view in zip(self.cameras, self.takes, views, strict=False):
            axes.clear()
            if (eye := ego_eye(view)) is None:
                axes.set_axis_off()
            else:
                draw_camera(axes, view, take.estimate, eye, self._theme)
        if not self._look.plain:
            self._show_words(frame, views)

    def _show_words(self, frame: int, views: Sequence[Frame]) -> None:
        """Move the strips, and change the text, to a frame of the first take."""
        seconds, theme = self.takes[0].seconds(frame), self._theme
        self._time.set_text(f"t = {seconds:.1f} s   frame {frame}")
        on = [take.attacks.on(view.index) for take, view in zip(self.takes, views, strict=True)]
        caption = self._shortened(self._captions.at(frame), 11.5, self._width - 2 * _MARGIN)
        self._caption.set(text=plain(caption), color=theme.adversary if any(on) else theme.ink)
        room = self._panel if len(self._states) > 1 else self._width - 2 * _MARGIN
        for state, take, view, attacked in zip(self._states, self.takes, views, on, strict=False):
            state.set_text(plain(self._shortened(sentence(take.attacks.at(view.index)), 10, room)))
            state.set_color(theme.adversary if attacked else theme.faint)
        for strip, texts, take, view in zip(self._strips, self._counts, self.takes, views, strict=True):
            strip.now.set_xdata([min(seconds, take.seconds(take.last))] * 2)
            for text, words in zip(texts, _numbers(take, view.index), strict=True):
                text.set_text(words)

    def _write(self, left: float, top: float, text: str, size: float, *, bold: bool = False, **style: Any) -> Text:
        """Add text whose base line is `top` inches below the upper edge."""
        style = {"color": self._theme.ink, "fontweight": "bold" if bold else "normal", "va": "baseline"} | style
        return self.figure.write(left, top, text, fontsize=size, **style)

    @staticmethod
    def _shortened(text: str, size: float, width: float) -> str:
        """Text that fits into a width in inches."""
        most = max(int(width / (_LETTER * size)), 4)
        return text if len(text) <= most else text[: most - 1] + "…"


def _numbers(take: Take, frame: int) -> tuple[str, str, str, str]:
    """The scores of a frame in words."""
    if take.estimate == TRUTH:
        return "", "", "", ""
    score = take.scores.get(frame)
    if score is None:
        return "not scored", "", "", ""
    rmse = "" if math.isnan(score.rmse_m) else f"RMSE {score.rmse_m:.2f} m"
    return f"{score.fn} missed", f"{score.fp} false", f"{score.tp} matched", rmse


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
