"""The ego's camera view: wire-frame boxes, ground and buildings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb

from mast_zenoh.arrays.geometry import box_corners, heading, to_world
from mast_zenoh.arrays.states import Floats
from mast_zenoh.report.figures.style import ADVERSARY, BUILDING, BUILDING_EDGE, GROUND, OUTCOME_COLOURS, dark_axes
from mast_zenoh.report.figures.view import FrameView
from mast_zenoh.sensing.camera import Camera

#: Near plane of the camera, m.
_NEAR = 0.5
#: Boxes centred nearer than this to the ego are the ego itself, m in the bird's-eye view.
_SELF = 2.5
_SKY, _ROAD, _LINE = "#1a2230", GROUND, "#242d39"

#: Edges of a box between the corners of `geometry.box_corners`.
_EDGES = np.array([(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)])
#: The strip of the image that is shown, as fractions of its height: without sky and bonnet.
STRIP = (0.28, 0.72)


@dataclass(frozen=True, eq=False)
class Eye:
    """A camera at an agent's pose.

    position: (3,) m, rotation: (3, 3) active; of the agent in the world frame
    """

    camera: Camera
    position: Floats
    rotation: Floats

    def pixels(self, points: Floats) -> tuple[Floats, Floats]:
        """Pixels (n, 2) and depth (n,) m of world points (n, 3)."""
        return self.camera.project(points, self.position, self.rotation)

    def lines(self, segments: Floats) -> Floats:
        """(m, 2, 2) px: the parts of world segments (n, 2, 3) in front of the camera."""
        depth = self.pixels(segments.reshape(-1, 3))[1].reshape(-1, 2)
        segments, depth = segments[(depth > _NEAR).any(axis=1)], depth[(depth > _NEAR).any(axis=1)]
        clipped = segments.copy()
        for end in (0, 1):
            behind = depth[:, end] < _NEAR
            fraction = (_NEAR * 1.001 - depth[behind, end]) / (depth[behind, 1 - end] - depth[behind, end])
            clipped[behind, end] += fraction[:, None] * (segments[behind, 1 - end] - segments[behind, end])
        return self.pixels(clipped.reshape(-1, 3))[0].reshape(-1, 2, 2)

    def face(self, corners: Floats) -> Floats | None:
        """(k, 2) px: part of a convex face (n, 3) m beyond the near plane; None: none."""
        depth = self.pixels(corners)[1]
        visible = []
        for here, there in zip(range(len(corners)), [*range(1, len(corners)), 0], strict=True):
            if depth[here] > _NEAR:
                visible.append(corners[here])
            if (depth[here] > _NEAR) != (depth[there] > _NEAR):
                along = (_NEAR * 1.001 - depth[here]) / (depth[there] - depth[here])
                visible.append(corners[here] + along * (corners[there] - corners[here]))
        return self.pixels(np.array(visible))[0] if visible else None


def ego_eye(view: FrameView) -> Eye | None:
    """The ego's camera in a frame; None: not in the recorded scene."""
    recording, ego = view.run.recording, view.run.ego
    if recording is None or ego not in recording.agent_names or view.frame >= len(recording):
        return None
    index = recording.agent_names.index(ego)
    pose = recording.agent_position[view.frame, index], recording.agent_rotation[view.frame, index]
    return Eye(recording.agents[index].camera, *pose)


def draw_camera(axes: Axes, view: FrameView, estimator: str, eye: Eye) -> None:
    """Draw the boxes of one estimator in a frame, as seen by the ego's camera.

    estimator: one of `view.PANELS`
    """
    camera = eye.camera
    dark_axes(axes)
    axes.set_xlim(0, camera.width)
    axes.set_ylim(camera.height * STRIP[1], camera.height * STRIP[0])
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    _draw_ground(axes, eye)
    _draw_buildings(axes, view, eye)
    for order, (outcome, colour) in enumerate(OUTCOME_COLOURS.items()):
        boxes = view.boxes[estimator][outcome]
        away = np.hypot(*(boxes.position - eye.position)[:, :2].T) > _SELF
        corners = box_corners(boxes.position[away], boxes.size[away], boxes.yaw[away])
        lines = eye.lines(corners[:, _EDGES].reshape(-1, 2, 3))
        width = 1.2 if outcome in ("truth matched", "unevaluated") else 1.7
        axes.add_collection(LineCollection(list(lines), colors=colour, linewidths=width, zorder=3 + 0.1 * order))
    marks = view.marks(estimator)
    for points, marker, size in ((marks.added, "D", 12.0), (marks.removed, "x", 11.0)):
        pixels, depth = eye.pixels(points)
        pixels = pixels[depth > _NEAR]
        axes.plot(*pixels.T, marker, ms=size, mfc="none", mec=ADVERSARY, mew=1.5, zorder=5)


def _draw_ground(axes: Axes, eye: Eye) -> None:
    """Sky, road and a grid of 10 m on the plane under the ego."""
    camera, at = eye.camera, eye.position
    turn = heading(eye.rotation @ camera.mount_rotation)
    lens = to_world(camera.mount_position[None], at, eye.rotation)
    pixels, _ = eye.pixels(lens + 1e6 * np.array([[np.cos(turn), np.sin(turn), 0.0]]))
    level = float(np.clip(np.nan_to_num(pixels[0, 1]), 0, camera.height))
    axes.axhspan(0, level, color=_SKY, zorder=0)
    axes.axhspan(level, camera.height, color=_ROAD, zorder=0)
    axes.axhline(level, color=BUILDING_EDGE, linewidth=0.8, zorder=1)
    steps = np.arange(-80.0, 81.0, 10.0)
    start = np.floor(at[:2] / 10.0) * 10.0
    lines = []
    for step in steps:
        lines.append([[start[0] + step, at[1] - 80, at[2]], [start[0] + step, at[1] + 80, at[2]]])
        lines.append([[at[0] - 80, start[1] + step, at[2]], [at[0] + 80, start[1] + step, at[2]]])
    axes.add_collection(LineCollection(list(eye.lines(np.array(lines))), colors=_LINE, linewidths=0.7, zorder=1))


def _draw_buildings(axes: Axes, view: FrameView, eye: Eye) -> None:
    """Walls, the farthest first, paler with distance."""
    recording = view.run.recording
    if recording is None:
        return
    ground = float(eye.position[2])
    walls: list[tuple[float, Floats]] = []
    for outline, top in zip(recording.buildings, recording.building_height, strict=True):
        for (ax, ay), (bx, by) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
            corners = np.array([[ax, ay, ground], [bx, by, ground], [bx, by, top], [ax, ay, top]])
            distance = float(np.hypot(*((corners[0] + corners[1]) / 2 - eye.position)[:2]))
            face = eye.face(corners) if distance < 200.0 else None
            if face is not None:
                walls.append((distance, face))
    walls.sort(key=lambda wall: -wall[0])
    near, far = np.array(to_rgb(BUILDING)), np.array(to_rgb(_SKY))
    shades = [near + (far - near) * min(distance / 140.0, 1.0) for distance, _ in walls]
    faces = [face for _, face in walls]
    axes.add_collection(PolyCollection(faces, facecolors=shades, edgecolors=BUILDING_EDGE, linewidths=0.6, zorder=2))
