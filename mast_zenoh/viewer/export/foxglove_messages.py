"""Messages of Foxglove's schemas, made of the objects of a frame."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from foxglove.messages import (
    Color,
    CubePrimitive,
    KeyValuePair,
    LinePrimitive,
    LinePrimitiveLineType,
    Point3,
    Quaternion,
    SceneEntity,
    SceneEntityDeletion,
    SceneEntityDeletionType,
    SceneUpdate,
    SpherePrimitive,
    Timestamp,
    Vector3,
)
from foxglove.messages import Pose as PoseMessage
from PIL import Image

from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import Camera
from mast_zenoh.viewer.export.cameras import WORLD
from mast_zenoh.viewer.export.columns import class_names, quaternions, wall_lines
from mast_zenoh.viewer.frame import Frame
from mast_zenoh.viewer.palette import ADVERSARY, BUILDING_EDGE, rgb


def replacement(time_ns: int, entities: list[SceneEntity]) -> SceneUpdate:
    """Replaces all entities of a topic."""
    everything = SceneEntityDeletion(timestamp=time(time_ns), type=SceneEntityDeletionType.All)
    return SceneUpdate(deletions=[everything], entities=entities)


def buildings(scene: Recording, time_ns: int) -> SceneEntity:
    """The edges of the buildings of a scene."""
    lines = LinePrimitive(
        type=LinePrimitiveLineType.LineList,
        thickness=0.15,
        points=[Point3(x=x, y=y, z=z) for x, y, z in wall_lines(scene).reshape(-1, 3).tolist()],
        color=_colour(rgb(BUILDING_EDGE)),
    )
    return SceneEntity(timestamp=time(time_ns), frame_id=WORLD, id="0", lines=[lines])


def changes(frame: Frame) -> list[SceneEntity]:
    """A mark for everything that an adversary inserted, removed or moved; none for the effects of links."""
    made, entities = frame.changes, []
    colour = _colour(rgb(ADVERSARY), 0.6)
    for k in range(len(made.effect)):
        places = [place[k] for place in (made.before, made.after) if np.isfinite(place[k]).all()]
        if not places or made.role[k] == "link":
            continue
        spheres = [SpherePrimitive(pose=_pose(places[-1]), size=Vector3(x=1.0, y=1.0, z=1.0), color=colour)]
        ends = [Point3(x=x, y=y, z=z) for x, y, z in np.array(places).tolist()]
        lines = [LinePrimitive(thickness=0.2, points=ends, color=colour)] if len(ends) == 2 else []
        words = [KeyValuePair(key=name, value=str(getattr(made, name)[k])) for name in ("interposer", "wire", "effect")]
        entities.append(
            SceneEntity(
                timestamp=time(frame.time_ns),
                frame_id=WORLD,
                id=str(k),
                metadata=words,
                spheres=spheres,
                lines=lines,
            )
        )
    return entities


def boxes(frame: Frame, states: ObjectStates, colour: Ints, outcomes: Sequence[str]) -> list[SceneEntity]:
    """An entity for each object, named by its id: its box, a line ahead, and its other values as text."""
    turns, kinds = quaternions(states.yaw), class_names(states)
    ahead = np.stack([np.cos(states.yaw), np.sin(states.yaw), 0 * states.yaw], axis=1) * (states.size[:, :1] / 2 + 1.2)
    lines = np.stack([states.position, states.position + ahead], axis=1).tolist()
    entities = []
    for k, number in enumerate(states.id.tolist()):
        words = {
            "class": kinds[k],
            "outcome": outcomes[k],
            "score": f"{states.score[k]:.3f}",
            "velocity": " ".join(f"{value:.3f}" for value in states.velocity[k]),
        }
        entities.append(
            SceneEntity(
                timestamp=time(frame.time_ns),
                frame_id=WORLD,
                id=str(number),
                metadata=[KeyValuePair(key=key, value=value) for key, value in words.items()],
                cubes=[
                    CubePrimitive(
                        pose=_pose(states.position[k], turns[k]),
                        size=vector(states.size[k]),
                        color=_colour(colour[k], 0.5),
                    )
                ],
                lines=[
                    LinePrimitive(
                        thickness=0.1, points=[Point3(x=x, y=y, z=z) for x, y, z in lines[k]], color=_colour(colour[k])
                    )
                ],
            )
        )
    return entities


def blank_image(camera: Camera) -> bytes:
    """An empty image, because image panels draw boxes only on an image."""
    buffer = io.BytesIO()
    Image.new("P", (camera.width, camera.height)).save(buffer, format="png", optimize=True)
    return buffer.getvalue()


def time(time_ns: int) -> Timestamp:
    """A time of the scene."""
    return Timestamp(sec=time_ns // 10**9, nsec=time_ns % 10**9)


def vector(values: Floats) -> Vector3:
    """values: (3,)"""
    x, y, z = values.tolist()
    return Vector3(x=x, y=y, z=z)


def quaternion(values: Floats) -> Quaternion:
    """values: (4,) x y z w"""
    x, y, z, w = values.tolist()
    return Quaternion(x=x, y=y, z=z, w=w)


def _pose(position: Floats, turn: Floats | None = None) -> PoseMessage:
    return PoseMessage(position=vector(position), orientation=Quaternion(w=1.0) if turn is None else quaternion(turn))


def _colour(values: Sequence[int] | Ints, opacity: float = 1.0) -> Color:
    r, g, b = (float(value) / 255 for value in values)
    return Color(r=r, g=g, b=b, a=opacity)
