"""The agent's camera view as a panel of a film."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import Collection
from matplotlib.colors import to_rgba_array
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mast_zenoh.arrays.states import Floats
from mast_zenoh.report.figures.camera import STRIP, draw_camera, ego_eye
from mast_zenoh.report.figures.view import FrameView
from mast_zenoh.report.film.takes import Take
from mast_zenoh.report.film.theme import DARK, Theme


class CameraPanel:
    """The boxes of an estimate as the agent's camera sees them, drawn anew in every frame."""

    def __init__(self, axes: Axes, take: Take, theme: Theme) -> None:
        self.axes, self.take, self._theme = axes, take, theme
        self.changing: list[Artist] = [axes]

    def show(self, frame: int) -> None:
        """Draw a frame of this panel's run."""
        self.axes.clear()
        view = self.take.view(frame)
        eye = ego_eye(view)
        if eye is None:
            self.axes.set_axis_off()
            return
        draw_camera(self.axes, _without_arrows(view), self.take.estimate, eye)
        if self._theme is not DARK:
            recolour(self.axes, self._theme)


def strip_aspect(take: Take) -> float | None:
    """Height by width of the strip of the camera's image that is drawn; None: the agent is not in the scene."""
    eye = ego_eye(take.view(take.first))
    return None if eye is None else eye.camera.height * (STRIP[1] - STRIP[0]) / eye.camera.width


def _without_arrows(view: FrameView) -> FrameView:
    """Without arrows, which are not readable in perspective."""
    before, behind = (marks._replace(moved=np.zeros((0, 2, 3))) for marks in (view.before, view.behind))
    return replace(view, before=before, behind=behind)


def recolour(axes: Axes, theme: Theme) -> None:
    """Turn axes that were drawn in dark colours into those of a theme; shades of grey are turned round."""
    axes.set_facecolor(theme.ground)
    for spine in axes.spines.values():
        spine.set_color(theme.building_edge)
    for artist in axes.get_children():
        if artist is axes.patch:
            continue
        if isinstance(artist, Collection | Patch):
            artist.set(
                facecolor=_turned(artist.get_facecolor(), theme), edgecolor=_turned(artist.get_edgecolor(), theme)
            )
        elif isinstance(artist, Line2D):
            for part in ("color", "markeredgecolor", "markerfacecolor"):
                colour = getattr(artist, f"get_{part}")()
                if not isinstance(colour, str) or colour != "none":
                    artist.set(**{part: _turned(colour, theme)[0]})


def _turned(colours: object, theme: Theme) -> Floats:
    """(n, 4) colours of a theme for those of the dark one."""
    result = to_rgba_array(colours)  # type: ignore[arg-type]
    known = {**dict(zip(DARK.outcomes.values(), theme.outcomes.values(), strict=True)), DARK.adversary: theme.adversary}
    pairs = [(to_rgba_array(dark)[0, :3], to_rgba_array(light)[0, :3]) for dark, light in known.items()]
    for row in result:
        match = next((light for dark, light in pairs if np.allclose(row[:3], dark, atol=1e-3)), None)
        row[:3] = 1.0 - 0.7 * row[:3].mean() if match is None else match
    turned: Floats = result
    return turned
