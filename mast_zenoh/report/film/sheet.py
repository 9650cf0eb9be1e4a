"""The whole image of a film: panels, title, time, numbers, strips, caption and legend."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from matplotlib import figure as figures
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.patches import Patch
from matplotlib.text import Text

from mast_zenoh.errors import ConfigurationError, RunFolderError
from mast_zenoh.metrics.estimates import TRUTH
from mast_zenoh.report.figures.birdseye import manipulation_handles, mark_handle, outcome_handles
from mast_zenoh.report.figures.style import Figure, plain
from mast_zenoh.report.film.look import Look, Theme
from mast_zenoh.report.film.panels import BirdseyePanel, CameraPanel, Strip, image_crop_aspect
from mast_zenoh.report.film.takes import Attacks, Captions, Framing, Take, framing
from mast_zenoh.runs.events import states_at, withheld_at
from mast_zenoh.runs.frame import Frame

#: Left and right of the panels; between them; between a bird's-eye view and a camera view.
MARGIN, GAP, CAMERA_GAP = 0.12, 0.14, 0.06
#: Heights: of the title with and without a line for the state of the run; of a panel's title, and of its own state;
#: of the numbers; of a strip with the labels of its axis; of the caption.
_HEAD, _HEAD_OF_SEVERAL, _TITLE, _STATE = 0.58, 0.36, 0.28, 0.28
_COUNTS, _STRIP, _LABELS, _CAPTION = 0.26, 0.5, 0.22, 0.4
#: Space of a plain sheet above and below its panels.
_PLAIN_HEAD, _PLAIN_FOOT = 0.04, 0.12
#: Of a bird's-eye view, at least.
_LEAST = 1.0


class Layout(NamedTuple):
    """Of a sheet, from top to bottom. All panels are alike, and none of the parts overlap.

    width, height: of the sheet;  panel: width of a panel
    head:   title;  title: of panels, with the state of the run if panels differ in it
    view:   bird's-eye view;  camera: camera view with the gap above it, 0: none
    counts: numbers;  strip: of errors over time, without its labels, 0: none
    """

    width: float
    height: float
    panel: float
    head: float
    title: float
    view: float
    camera: float
    counts: float
    strip: float

    def left(self, panel: int) -> float:
        """Where a panel begins."""
        return MARGIN + panel * (self.panel + GAP)

    @property
    def top(self) -> float:
        """Where bird's-eye views begin."""
        return self.head + self.title

    @property
    def below(self) -> float:
        """Where bird's-eye views and camera views end."""
        return self.top + self.view + self.camera

    @property
    def caption(self) -> float:
        """Where the caption begins."""
        return self.below + self.counts + self.strip + _LABELS


def layout(look: Look, panels: int, legend: float, aspect: float | None, *, several: bool) -> Layout:
    """The layout of a sheet.

    panels: their number;  legend: its height;  aspect: height by width of a camera view, None: without
    several: panels show several runs
    Raises ConfigurationError if a panel would be too small.
    """
    pixels = look.pixels(panels)
    width, height = (each / look.dpi for each in pixels)
    panel = (width - 2 * MARGIN - (panels - 1) * GAP) / panels
    camera = panel * aspect + CAMERA_GAP if aspect else 0.0
    if look.plain:
        head, title, counts, strip, labels, caption = _PLAIN_HEAD, _TITLE, 0.0, 0.0, 0.0, _PLAIN_FOOT
    else:
        head, title = (_HEAD_OF_SEVERAL, _TITLE + _STATE) if several else (_HEAD, _TITLE)
        counts, strip, labels, caption = _COUNTS, _STRIP, _LABELS, _CAPTION
    view = height - head - title - camera - counts - strip - labels - caption - legend
    if min(view, panel) < _LEAST:
        hint = "" if look.plain else ", or plain"
        raise ConfigurationError(
            f"size: found {pixels[0]}x{pixels[1]} px at {look.dpi} dpi, which leaves no room for "
            f"{panels} panel{'s' if panels > 1 else ''}: expected a larger size or fewer dpi{hint}"
        )
    return Layout(width, height, panel, head, title, view, camera, counts, strip)


#: Inches for each point of the font's size: width of a letter, of an entry's symbol and gaps; height of a line.
_LETTER, _ENTRY, _LINE = 0.0081, 0.056, 0.0235
#: Points, size of marks in the legend.
_MARK = 7
#: Inches, least width of a figure with text of the ordinary size; points, that size and the one of narrow figures.
_NARROW, _SIZE, _SMALL_SIZE = 5.0, 9.0, 7.0


def legend_entries(
    takes: Sequence[Take], attacks: Sequence[Attacks], frames: Sequence[int], theme: Theme
) -> list[Artist]:
    """The entries for all that the panels show in these frames of the first take."""
    views = [(take, take.view(take.frame_at(takes[0].seconds(frame)))) for take in takes for frame in frames]
    shown = {name for take, view in views for name, boxes in view.boxes[take.estimate].items() if len(boxes)}
    if all(take.estimate == TRUTH for take in takes):
        handles: list[Artist] = [Patch(facecolor="none", edgecolor=theme.outcomes["truth matched"], label="object")]
    else:
        handles = outcome_handles(theme.outcomes, shown)
    if any(take.run.files.scene is not None for take in takes):
        states = {state for take, view in views for state in states_at(take.run, view.index).values()}
        colour = theme.withheld if states else theme.agent
        kinds = {agent.kind for take in takes if take.run.files.scene for agent in take.run.files.scene.agents}
        handles += (
            [mark_handle("o", colour, "vehicle with sensors", hollow=True, size=_MARK)] if kinds - {"static"} else []
        )
        handles += [mark_handle("^", colour, "roadside sensor", size=_MARK)] if "static" in kinds else []
        handles += [
            mark_handle("^", theme.states[state], f"{state} agent", size=_MARK)
            for state in theme.states
            if state in states
        ]
    return handles + _conduct(views, attacks, theme)


def _conduct(views: Sequence[tuple[Take, Frame]], attacks: Sequence[Attacks], theme: Theme) -> list[Artist]:
    handles: list[Artist] = []
    if any(each.possible for each in attacks):
        handles.append(mark_handle("^", theme.adversary, "adversary on its wire", size=_MARK))
        band = Patch(facecolor=to_rgba(theme.adversary, 0.28), edgecolor=theme.adversary, label="attack")
        handles.append(band)
    if any(len(withheld_at(view.run, view.index)) for _, view in views):
        handles.append(Patch(facecolor="none", edgecolor=theme.withheld, linestyle="--", label="withheld"))
    marks = [view.marks(take.estimate) for take, view in views]
    return handles + manipulation_handles(marks, theme.adversary, _MARK)


def _legend_lines(handles: Sequence[Artist], width: float) -> int:
    """Lines that entries need in a width in inches."""
    points = width / _font_size(width)
    return next((count for count in range(1, len(handles)) if _breadth(handles, count) <= points), len(handles))


def legend_height(handles: Sequence[Artist], width: float) -> float:
    """Inches that entries need in a width in inches."""
    return _LINE * _font_size(width) * _legend_lines(handles, width)


def _font_size(width: float) -> float:
    return _SIZE if width >= _NARROW else _SMALL_SIZE


def _breadth(handles: Sequence[Artist], count: int) -> float:
    """Width of a legend of so many lines, inches for each point of the font's size.

    Matplotlib fills it column by column, the first ones the fullest.
    """
    columns = -(-len(handles) // count)
    full, left = divmod(len(handles), columns)
    ends = [full * column + min(column, left) for column in range(columns + 1)]
    widths = [[_width(each) for each in handles[start:end]] for start, end in pairwise(ends)]
    return sum(max(column) for column in widths if column)


def draw_legend(figure: figures.Figure, handles: Sequence[Artist], theme: Theme) -> None:
    """Put entries at the bottom of a figure."""
    count = _legend_lines(handles, figure.get_figwidth())
    figure.legend(
        handles=list(handles),
        loc="lower center",
        ncols=-(-len(handles) // count),
        frameon=False,
        labelcolor=theme.ink,
        fontsize=_font_size(figure.get_figwidth()),
        handlelength=1.3,
        columnspacing=1.3,
        labelspacing=0.4,
        borderaxespad=0.2,
    )


def _width(entry: Artist) -> float:
    return _ENTRY + _LETTER * len(str(entry.get_label()))


#: Inches between the left edge of a panel and its strip, for the labels of the axis.
_STRIP_LEFT = 0.26
#: Of text, inches for each letter and point of its size.
_TEXT_LETTER = 0.0086


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
        handles = legend_entries(takes, self._attacks, frames, self._theme)
        width, height = (each / look.dpi for each in look.pixels(len(takes)))
        place = layout(look, len(takes), legend_height(handles, width), aspect, several=self._several)
        self.figure = Figure(figsize=(width, height), dpi=look.dpi, facecolor=self._theme.ground)
        draw_legend(self.figure, handles, self._theme)
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
        names = " and ".join(dict.fromkeys(each.run.name for each in self.takes))
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
        texts, counts = self._counts[index], self.takes[index].score(frame)
        if not texts:
            return
        if counts is None:
            values = ["not scored", "", "", ""]
        else:
            rmse = "" if math.isnan(counts.rmse_m) else f"RMSE {counts.rmse_m:.2f} m"
            values = [f"{counts.fn} missed", f"{counts.fp} false", f"{counts.tp} matched", rmse]
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
        most = max(int(width / (_TEXT_LETTER * size)), 4)
        return text if len(text) <= most else text[: most - 1] + "…"
