"""The ego's camera view: boxes as wire frames, ground and buildings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb, to_rgba

from mast_zenoh.arrays.boxes import Boxes
from mast_zenoh.arrays.geometry import along_and_across, box_corners, heading, to_world
from mast_zenoh.arrays.states import Floats
from mast_zenoh.runs.frame import Frame
from mast_zenoh.sensing.sensors import Camera
from mast_zenoh.show.figures.birdseye import ERRORS
from mast_zenoh.show.figures.style import Theme


def clip_polygon(corners: Floats, side: Floats) -> Floats:
    """The part of a polygon on the positive side of a plane (Sutherland and Hodgman, CACM 1974).

    corners: (n, d) in order;  side: (n,) signed distances of the corners from the plane, 0 or more is kept
    Returns (k, d): `corners` itself if nothing is cut off, k = 0 if everything is.
    """
    inside = side >= 0.0
    if inside.all():
        return corners
    following, there = np.roll(corners, -1, axis=0), np.roll(side, -1)
    crosses = inside != (there >= 0.0)
    span = np.where(crosses, side - there, 1.0)  # not 0 where an edge crosses: the signs differ
    cuts = corners + np.where(crosses, side / span, 0.0)[:, None] * (following - corners)
    # Each corner comes before the crossing on the edge that begins in it.
    points = np.stack([corners, cuts], axis=1).reshape(-1, corners.shape[1])
    return np.asarray(points[np.stack([inside, crosses], axis=1).ravel()])


#: Near plane of the camera, m.
_NEAR = 0.5
#: Boxes centred nearer than this to the ego are the ego itself, m in the bird's-eye view.
_SELF = 2.5

#: Faces of a box by the corners of `geometry.box_corners`: front, back, left, right, top, bottom.
_FACES = np.array([(0, 3, 7, 4), (1, 2, 6, 5), (0, 1, 5, 4), (3, 2, 6, 7), (4, 5, 6, 7), (0, 1, 2, 3)])
_FRONT = 0
#: Opacity of lines on the far side of a box; of what covers the boxes behind; of the front; of the sides of errors.
_FAR_SIDE, _COVER, _FRONT_FILL, _ERROR_FILL = 0.35, 0.35, 0.5, 0.25
#: The part of the image that is shown, as fractions of its height: without sky and bonnet.
IMAGE_CROP = (0.28, 0.72)


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

    @property
    def lens(self) -> Floats:
        """(3,) m, where the camera is."""
        return np.asarray(to_world(self.camera.mount_position[None], self.position, self.rotation)[0])

    def visible(self, corners: Floats) -> Floats:
        """(k, 2) px: the part of a line or convex polygon (n, 3) m beyond the near plane; k = 0: none."""
        depth = self.pixels(corners)[1]
        return self.pixels(clip_polygon(corners, depth - _NEAR))[0]

    @property
    def crop_aspect(self) -> float:
        """Height by width of the part of the image that is shown."""
        return self.camera.height * (IMAGE_CROP[1] - IMAGE_CROP[0]) / self.camera.width


def ego_eye(view: Frame) -> Eye | None:
    """The ego's camera in a frame; None: not in the recorded scene."""
    recording, ego = view.run.files.scene, view.run.ego
    if recording is None or ego not in recording.agent_names or view.index >= len(recording):
        return None
    index = recording.agent_names.index(ego)
    pose = recording.agent_position[view.index, index], recording.agent_rotation[view.index, index]
    return Eye(recording.agents[index].camera, *pose)


def draw_camera(axes: Axes, view: Frame, estimate: str, eye: Eye, theme: Theme) -> None:
    """Draw the boxes of one estimate in a frame, as seen by the ego's camera."""
    camera = eye.camera
    axes.set_facecolor(theme.ground)
    for spine in axes.spines.values():
        spine.set_color(theme.building_edge)
    axes.set_xlim(0, camera.width)
    axes.set_ylim(camera.height * IMAGE_CROP[1], camera.height * IMAGE_CROP[0])
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    _draw_ground(axes, eye, theme)
    _draw_buildings(axes, view, eye, theme)
    _draw_boxes(axes, view.boxes[estimate], eye, theme)
    marks = view.marks(estimate)
    for points, marker, size in ((marks.added, "D", 12.0), (marks.removed, "x", 11.0)):
        pixels, depth = eye.pixels(points)
        pixels = pixels[depth > _NEAR]
        axes.plot(*pixels.T, marker, ms=size, mfc="none", mec=theme.adversary, mew=1.5, zorder=5)


def _draw_boxes(axes: Axes, by_outcome: dict[str, Boxes], eye: Eye, theme: Theme) -> None:
    """Boxes, the farthest first; each covers what is behind it, and its front is filled."""
    drawn: list[tuple[float, int, str, Floats, Floats]] = []
    for order, outcome in enumerate(theme.outcomes):
        boxes = by_outcome[outcome]
        corners = box_corners(boxes.position, boxes.size, boxes.yaw)
        to_lens = eye.lens - boxes.position
        horizontal = along_and_across(to_lens, boxes.yaw)
        eyes = np.column_stack([horizontal, to_lens[:, 2]])
        # Of the six faces, in the order of _FACES: whether the camera is on their outer side.
        towards = np.stack([sign * eyes[:, i] > boxes.size[:, i] / 2 for i in range(3) for sign in (1, -1)], axis=1)
        away = np.hypot(*(boxes.position - eye.position)[:, :2].T) > _SELF
        distance = np.linalg.norm(to_lens, axis=1)
        drawn += [(-float(np.rint(distance[i])), order, outcome, corners[i], towards[i]) for i in np.flatnonzero(away)]
    drawn.sort(key=lambda each: each[:2])
    polygons, fills, edges, widths = [], [], [], []
    for _, _, outcome, box, seen in drawn:
        colour = theme.outcomes[outcome]
        error = outcome in ERRORS
        for face in np.argsort(seen, kind="stable"):  # the far side first
            polygon = eye.visible(box[_FACES[face]])
            if len(polygon) < 3:
                continue
            near = bool(seen[face]) or not seen.any()  # all faces of a box around the camera
            if seen[face]:
                polygons.append(polygon)
                fills.append(to_rgba(theme.ground, _COVER))
                edges.append(to_rgba(theme.ground, 0.0))
                widths.append(0.0)
            filled = _FRONT_FILL if face == _FRONT else _ERROR_FILL if error else 0.0
            polygons.append(polygon)
            fills.append(to_rgba(colour, filled if seen[face] else 0.0))
            edges.append(to_rgba(colour, 1.0 if near else _FAR_SIDE))
            widths.append((1.2 if outcome in ("truth matched", "unevaluated") else 1.7) * (1.0 if near else 0.6))
    faces = PolyCollection(polygons, facecolors=fills, edgecolors=edges, linewidths=widths, joinstyle="round", zorder=3)
    axes.add_collection(faces)


def _draw_ground(axes: Axes, eye: Eye, theme: Theme) -> None:
    """Sky, road and a grid of 10 m on the plane under the ego."""
    camera, at = eye.camera, eye.position
    turn = heading(eye.rotation @ camera.mount_rotation)
    pixels, _ = eye.pixels(eye.lens[None] + 1e6 * np.array([[np.cos(turn), np.sin(turn), 0.0]]))
    level = float(np.clip(np.nan_to_num(pixels[0, 1]), 0, camera.height))
    axes.axhspan(0, level, color=theme.sky, zorder=0)
    axes.axhspan(level, camera.height, color=theme.ground, zorder=0)
    axes.axhline(level, color=theme.building_edge, linewidth=0.8, zorder=1)
    steps = np.arange(-80.0, 81.0, 10.0)
    start = np.floor(at[:2] / 10.0) * 10.0
    lines = []
    for step in steps:
        lines.append([[start[0] + step, at[1] - 80, at[2]], [start[0] + step, at[1] + 80, at[2]]])
        lines.append([[at[0] - 80, start[1] + step, at[2]], [at[0] + 80, start[1] + step, at[2]]])
    segments = [eye.visible(np.array(line)) for line in lines]
    segments = [each for each in segments if len(each) > 1]
    axes.add_collection(LineCollection(segments, colors=theme.grid, linewidths=0.7, zorder=1))


def _draw_buildings(axes: Axes, view: Frame, eye: Eye, theme: Theme) -> None:
    """Walls, the farthest first, paler with distance."""
    recording = view.run.files.scene
    if recording is None:
        return
    ground = float(eye.position[2])
    walls: list[tuple[float, Floats]] = []
    for outline, top in zip(recording.buildings, recording.building_height, strict=True):
        for (ax, ay), (bx, by) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
            corners = np.array([[ax, ay, ground], [bx, by, ground], [bx, by, top], [ax, ay, top]])
            distance = float(np.hypot(*((corners[0] + corners[1]) / 2 - eye.position)[:2]))
            face = eye.visible(corners) if distance < 200.0 else np.zeros((0, 2))
            if len(face) > 2:
                walls.append((distance, face))
    walls.sort(key=lambda wall: -wall[0])
    near, far = np.array(to_rgb(theme.building)), np.array(to_rgb(theme.sky))
    shades = [near + (far - near) * min(distance / 140.0, 1.0) for distance, _ in walls]
    faces = [face for _, face in walls]
    axes.add_collection(
        PolyCollection(faces, facecolors=shades, edgecolors=theme.building_edge, linewidths=0.6, zorder=2)
    )
