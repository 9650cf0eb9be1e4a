"""Where the parts of a film are, in inches."""

from __future__ import annotations

from typing import NamedTuple

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.report.film.look import Look

#: Left and right of the panels; between them; between a bird's-eye view and a camera view.
MARGIN, GAP, CAMERA_GAP = 0.12, 0.14, 0.06
#: Heights: of the title with and without a line for the state of the run; of a panel's title, and of its own state;
#: of the numbers; of a strip with the labels of its axis; of the caption.
_HEAD, _HEAD_OF_SEVERAL, _TITLE, _STATE, _COUNTS, _STRIP, _LABELS, _CAPTION = (
    0.58,
    0.36,
    0.28,
    0.28,
    0.26,
    0.5,
    0.22,
    0.4,
)
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
