"""The whole picture of a film: panels, title, time, numbers, strips, caption and legend."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.text import Text

from mast_zenoh.errors import ConfigurationError, RunFolderError
from mast_zenoh.report.figures.style import Figure, plain
from mast_zenoh.report.film import legend
from mast_zenoh.report.film.attacks import Attacks
from mast_zenoh.report.film.birdseye_panel import BirdseyePanel
from mast_zenoh.report.film.camera_panel import CameraPanel, strip_aspect
from mast_zenoh.report.film.captions import Captions
from mast_zenoh.report.film.framing import framing
from mast_zenoh.report.film.look import TRUTH, Look
from mast_zenoh.report.film.strip import Strip
from mast_zenoh.report.film.takes import Take

#: Inches. Left, right and between panels; the lines of text; a strip and the labels of its axis.
_MARGIN, _GAP = 0.12, 0.14
_HEAD, _TITLE, _COUNTS, _STRIP, _STRIP_LABELS, _CAPTION = 0.58, 0.28, 0.26, 0.5, 0.22, 0.3
_STRIP_LEFT = 0.26
#: Inches, least height of a bird's-eye view.
_LEAST_VIEW = 1.0
#: Of text, inches for each letter and point of its size.
_LETTER = 0.0086


class Sheet:
    """A figure that shows one frame after the other.

    takes:  the panels, from left to right: one run, or two
    frames: of the first take, those that are shown;  period: first and last frame of the strips
    figure: Matplotlib's;  changing: the artists that differ from frame to frame, in drawing order
    """

    def __init__(self, takes: Sequence[Take], look: Look, frames: Sequence[int], period: tuple[int, int]) -> None:
        self.takes, self._look, self._theme = takes, look, look.colours
        width, height = look.pixels(len(takes))
        self._width, self._height = width / look.dpi, height / look.dpi
        self.figure = Figure(figsize=(self._width, self._height), dpi=look.dpi, facecolor=self._theme.ground)
        runs = list({take.run.path: take for take in takes}.values())
        self._several = len(runs) > 1
        self._attacks = [Attacks(take.run) for take in takes]
        self._captions = Captions(runs, look.own_captions())
        self.changing: list[Artist] = []
        handles = legend.entries(takes, self._attacks, frames, self._theme)
        legend.draw(self.figure, handles, self._theme)
        foot = _CAPTION + 0.1 + legend.LINE_INCHES * legend.lines(handles, self._width)
        self._place_panels(frames, period, foot)
        self._place_head(foot)

    def _place_panels(self, frames: Sequence[int], period: tuple[int, int], foot: float) -> None:
        """Create axes and their contents. foot: inches below the panels"""
        takes, theme = self.takes, self._theme
        count = len(takes)
        panel = (self._width - 2 * _MARGIN - (count - 1) * _GAP) / count
        aspect = strip_aspect(takes[0]) if self._look.camera else None
        if self._look.camera and aspect is None:
            raise RunFolderError(f"{takes[0].run.path}: {takes[0].run.ego} has no camera: it is not in the scene")
        camera = panel * aspect + 0.06 if aspect else 0.0
        counted = any(take.estimate != TRUTH for take in takes)
        titles = _TITLE * (2 if self._several else 1)
        below = camera + (_COUNTS if counted else 0.06) + _STRIP + _STRIP_LABELS + foot
        view = self._height - _HEAD - titles - below
        if view < _LEAST_VIEW or panel < _LEAST_VIEW:
            raise ConfigurationError(
                f"size: found {self._width * self._look.dpi:.0f}x{self._height * self._look.dpi:.0f} px at "
                f"{self._look.dpi} dpi, which leaves no room for {count} panel{'s' if count > 1 else ''}: expected a "
                f"larger size or fewer dpi"
            )
        chosen = framing(self._look.window_choice(), takes, frames, panel / view)
        times = takes[0].seconds(period[0]), takes[0].seconds(period[1])
        self.birdseye: list[BirdseyePanel] = []
        self.cameras: list[CameraPanel] = []
        self._strips: list[Strip] = []
        self._counts: list[list[Text]] = []
        self._states: list[Text] = []
        for index, (take, attacks) in enumerate(zip(takes, self._attacks, strict=True)):
            left, top = _MARGIN + index * (panel + _GAP), _HEAD + titles
            self._text(left, _HEAD + 0.19, take.title, 11, bold=True)
            if self._several:
                self._states.append(self._text(left, _HEAD + _TITLE + 0.17, "", 9.5, changing=True))
            axes = self._axes(left, top, panel, view)
            self.birdseye.append(BirdseyePanel(axes, take, attacks, chosen, theme))
            if aspect:
                axes = self._axes(left, top + view + 0.06, panel, panel * aspect)
                self.cameras.append(CameraPanel(axes, take, theme))
            low = top + view + camera
            self._counts.append(self._place_counts(left, low + 0.2, panel) if take.estimate != TRUTH else [])
            low += _COUNTS if counted else 0.06
            axes = self._axes(left + _STRIP_LEFT, low, panel - _STRIP_LEFT - 0.08, _STRIP)
            self._strips.append(Strip(axes, take, attacks, times, theme))
        panels: list[BirdseyePanel | CameraPanel | Strip] = [*self.birdseye, *self.cameras, *self._strips]
        for each in panels:
            self.changing += each.changing

    def _place_head(self, foot: float) -> None:
        take, theme = self.takes[0], self._theme
        names = " and ".join(dict.fromkeys(each.run.label for each in self.takes))
        title = self._look.title if self._look.title is not None else f"{names}, seen by {take.run.ego}"
        self._text(_MARGIN, 0.25, self._shortened(title, 13.5, self._width - 2.6), 13.5, bold=True)
        self._time = self._text(self._width - _MARGIN, 0.25, "", 11, align="right", changing=True)
        if not self._several:
            self._states.append(self._text(_MARGIN, 0.5, "", 10, changing=True))
        self._caption = self._text(_MARGIN, self._height - foot + 0.2, "", 11.5, bold=True, changing=True)
        self._caption.set_color(theme.adversary)

    def _place_counts(self, left: float, top: float, width: float) -> list[Text]:
        colours = [self._theme.outcomes[name] for name in ("truth missed", "track false", "track matched")]
        places = (0.0, 0.235, 0.45, 0.71)
        texts = [self._text(left + place * width, top, "", 10, changing=True) for place in places]
        for text, colour in zip(texts, [*colours, self._theme.ink], strict=True):
            text.set(color=colour, fontweight="bold")
        return texts

    def show(self, frame: int) -> None:
        """Move all artists to a frame of the first take; the others show the frame at the same time."""
        seconds = self.takes[0].seconds(frame)
        self._time.set_text(f"t = {seconds:.1f} s   frame {frame}")
        text = self._shortened(self._captions.at(frame), 11.5, self._width - 2 * _MARGIN)
        self._caption.set_text(plain(text))
        for index, (take, attacks) in enumerate(zip(self.takes, self._attacks, strict=True)):
            shown, over = take.frame_at(seconds), take.ended(seconds)
            self.birdseye[index].show(shown, over=over)
            if self.cameras:
                self.cameras[index].show(shown)
            self._strips[index].show(min(seconds, take.seconds(take.last)))
            self._show_counts(index, shown)
            if index < len(self._states):
                self._states[index].set_text(plain(self._shortened(attacks.sentence(shown), 10, self._state_width)))
                self._states[index].set_color(self._theme.adversary if attacks.on(shown) else self._theme.faint)

    @property
    def _state_width(self) -> float:
        return self._width / (len(self.takes) if self._several else 1) - 2 * _MARGIN

    def _show_counts(self, index: int, frame: int) -> None:
        texts, counts = self._counts[index], self.takes[index].counts(frame)
        if not texts:
            return
        if counts is None:
            values = ["not scored", "", "", ""]
        else:
            rmse = "" if math.isnan(counts.rmse_m) else f"RMSE {counts.rmse_m:.2f} m"
            values = [f"{counts.missed} missed", f"{counts.false} false", f"{counts.matched} matched", rmse]
        for text, value in zip(texts, values, strict=True):
            text.set_text(value)

    def _axes(self, left: float, top: float, width: float, height: float) -> Axes:
        """Axes placed in inches from the upper left corner."""
        w, h = self._width, self._height
        return self.figure.add_axes((left / w, 1 - (top + height) / h, width / w, height / h))

    def _text(
        self,
        x: float,
        y: float,
        text: str,
        size: float,
        *,
        bold: bool = False,
        align: str = "left",
        changing: bool = False,
    ) -> Text:
        """Text whose base line is `y` inches below the upper edge."""
        artist = self.figure.text(x / self._width, 1 - y / self._height, plain(text), fontsize=size, ha=align)
        artist.set(color=self._theme.ink, fontweight="bold" if bold else "normal", va="baseline")
        if changing:
            self.changing.append(artist)
        return artist

    @staticmethod
    def _shortened(text: str, size: float, width: float) -> str:
        """Text that fits into a width in inches."""
        most = max(int(width / (_LETTER * size)), 4)
        return text if len(text) <= most else text[: most - 1] + "…"
