"""The whole image of a film: panels, title, time, numbers, strips, caption and legend."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.text import Text

from mast_zenoh.errors import RunFolderError
from mast_zenoh.report.figures.style import Figure, plain
from mast_zenoh.report.film import legend
from mast_zenoh.report.film.attacks import Attacks
from mast_zenoh.report.film.birdseye_panel import BirdseyePanel
from mast_zenoh.report.film.camera_panel import CameraPanel, image_crop_aspect
from mast_zenoh.report.film.captions import Captions
from mast_zenoh.report.film.framing import Framing, framing
from mast_zenoh.report.film.layout import CAMERA_GAP, MARGIN, layout
from mast_zenoh.report.film.look import TRUTH, Look
from mast_zenoh.report.film.strip import Strip
from mast_zenoh.report.film.takes import Take

#: Inches between the left edge of a panel and its strip, for the labels of the axis.
_STRIP_LEFT = 0.26
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
        runs = list({take.run.path: take for take in takes}.values())
        self._several = len(runs) > 1
        self._attacks = [Attacks(take.run) for take in takes]
        self._captions = Captions(runs, look.own_captions())
        aspect = image_crop_aspect(takes[0]) if look.camera else None
        if look.camera and aspect is None:
            raise RunFolderError(f"{takes[0].run.path}: {takes[0].run.ego} has no camera: it is not in the scene")
        handles = legend.entries(takes, self._attacks, frames, self._theme)
        width, height = (each / look.dpi for each in look.pixels(len(takes)))
        place = layout(look, len(takes), legend.height(handles, width), aspect, several=self._several)
        self.figure = Figure(figsize=(width, height), dpi=look.dpi, facecolor=self._theme.ground)
        legend.draw(self.figure, handles, self._theme)
        self._place, self.changing = place, list[Artist]()
        chosen = framing(look.window_choice(), takes, frames, place.panel / place.view)
        self._place_panels(chosen)
        self._strips: list[Strip] = []
        self._counts: list[list[Text]] = []
        self._states: list[Text] = []
        if not look.plain:
            self._place_numbers((takes[0].seconds(period[0]), takes[0].seconds(period[1])))
            self._place_head()

    def _place_panels(self, chosen: Framing) -> None:
        """Create the views and their titles."""
        place, theme = self._place, self._theme
        self.birdseye: list[BirdseyePanel] = []
        self.cameras: list[CameraPanel] = []
        for index, (take, attacks) in enumerate(zip(self.takes, self._attacks, strict=True)):
            left = place.left(index)
            self._text(left, place.head + 0.19, self._shortened(take.title, 11, place.panel), 11, bold=True)
            axes = self._axes(left, place.top, place.panel, place.view)
            self.birdseye.append(BirdseyePanel(axes, take, attacks, chosen, theme))
            if place.camera:
                axes = self._axes(left, place.top + place.view + CAMERA_GAP, place.panel, place.camera - CAMERA_GAP)
                self.cameras.append(CameraPanel(axes, take, theme))
        views: list[BirdseyePanel | CameraPanel] = [*self.birdseye, *self.cameras]
        self.changing += [artist for each in views for artist in each.changing]

    def _place_numbers(self, period: tuple[float, float]) -> None:
        """Create the numbers and strips below the views. period: s, of the strips"""
        place = self._place
        for index, (take, attacks) in enumerate(zip(self.takes, self._attacks, strict=True)):
            left, low = place.left(index), place.below
            self._counts.append(self._place_counts(left, low + 0.2, place.panel) if take.estimate != TRUTH else [])
            axes = self._axes(left + _STRIP_LEFT, low + place.counts, place.panel - _STRIP_LEFT - 0.08, place.strip)
            self._strips.append(Strip(axes, take, attacks, period, self._theme))
        for strip in self._strips:  # panels are compared
            strip.set_most(max(each.most for each in self._strips))
            self.changing += strip.changing

    def _place_head(self) -> None:
        """Create the title, the time, the states of runs, and the caption."""
        place, take = self._place, self.takes[0]
        names = " and ".join(dict.fromkeys(each.run.label for each in self.takes))
        title = self._look.title if self._look.title is not None else f"{names}, seen by {take.run.ego}"
        self._text(MARGIN, 0.25, self._shortened(title, 13.5, place.width - 2.6), 13.5, bold=True)
        self._time = self._text(place.width - MARGIN, 0.25, "", 11, align="right", changing=True)
        if self._several:
            for index in range(len(self.takes)):
                self._states.append(self._text(place.left(index), place.top - 0.11, "", 9.5, changing=True))
        else:
            self._states.append(self._text(MARGIN, 0.5, "", 10, changing=True))
        self._caption = self._text(MARGIN, place.caption + 0.2, "", 11.5, bold=True, changing=True)

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
        for index, take in enumerate(self.takes):
            shown = take.frame_at(seconds)
            self.birdseye[index].show(shown, over=take.ended(seconds))
            if self.cameras:
                self.cameras[index].show(shown)
        if not self._look.plain:
            self._show_words(frame, seconds)

    def _show_words(self, frame: int, seconds: float) -> None:
        """Move the strips, and change the text, to a frame of the first take."""
        width = self._place.width - 2 * MARGIN
        self._time.set_text(f"t = {seconds:.1f} s   frame {frame}")
        frames = [take.frame_at(seconds) for take in self.takes]
        on = [attacks.on(shown) for attacks, shown in zip(self._attacks, frames, strict=True)]
        text = plain(self._shortened(self._captions.at(frame), 11.5, width))
        self._caption.set(text=text, color=self._theme.adversary if any(on) else self._theme.ink)
        for index, shown in enumerate(frames):
            self._strips[index].show(min(seconds, self.takes[index].seconds(self.takes[index].last)))
            self._show_counts(index, shown)
        for index, state in enumerate(self._states):
            sentence = self._attacks[index].sentence(frames[index])
            room = self._place.panel if self._several else width
            state.set(text=plain(self._shortened(sentence, 10, room)))
            state.set_color(self._theme.adversary if on[index] else self._theme.faint)

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
        w, h = self._place.width, self._place.height
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
        artist = self.figure.text(
            x / self._place.width, 1 - y / self._place.height, plain(text), fontsize=size, ha=align
        )
        artist.set(color=self._theme.ink, fontweight="bold" if bold else "normal", va="baseline")
        if changing:
            self.changing.append(artist)
        return artist

    @staticmethod
    def _shortened(text: str, size: float, width: float) -> str:
        """Text that fits into a width in inches."""
        most = max(int(width / (_LETTER * size)), 4)
        return text if len(text) <= most else text[: most - 1] + "…"
