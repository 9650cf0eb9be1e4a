"""The agent's camera view as a panel of a film."""

from __future__ import annotations

from matplotlib.artist import Artist
from matplotlib.axes import Axes

from mast_zenoh.report.figures.camera import draw_camera, ego_eye
from mast_zenoh.report.film.takes import Take
from mast_zenoh.report.film.theme import Theme


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
        draw_camera(self.axes, view, self.take.estimate, eye, self._theme.camera)


def image_crop_aspect(take: Take) -> float | None:
    """Height by width of the part of the camera's image that is drawn; None: the agent is not in the scene."""
    eye = ego_eye(take.view(take.first))
    return None if eye is None else eye.crop_aspect
