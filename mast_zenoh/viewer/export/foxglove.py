"""MCAP with Foxglove's schemas, and a layout, for Foxglove and Lichtblick."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from pathlib import Path

import foxglove
import numpy as np
from foxglove import channels
from foxglove.messages import (
    CameraCalibration,
    Color,
    CompressedImage,
    CubePrimitive,
    FrameTransform,
    FrameTransforms,
    KeyValuePair,
    LinePrimitive,
    LinePrimitiveLineType,
    Log,
    LogLevel,
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
from mast_zenoh.metrics.record import Series
from mast_zenoh.sensing import Camera
from mast_zenoh.viewer.evaluated import Score
from mast_zenoh.viewer.export.cameras import WORLD, cameras, transforms_of
from mast_zenoh.viewer.export.columns import class_names, colours, missed, quaternions, wall_lines
from mast_zenoh.viewer.export.foxglove_layout import layout
from mast_zenoh.viewer.frames import Frame, RunFrames
from mast_zenoh.viewer.palette import ADVERSARY, BUILDING_EDGE, OUTCOME_COLOURS, rgb
from mast_zenoh.viewer.routes import TRUTH

TRANSFORMS, BUILDINGS, CHANGES, LOG, SCORES = "/tf", "/scene/buildings", "/changes", "/log", "/scores"
#: Appended to the topic of an estimate: the objects that it misses.
MISSED = "/missed"
_MISSED = rgb(OUTCOME_COLOURS["truth missed"])
_CHANGED = rgb(ADVERSARY)
_NUMBERS = {name: {"type": "number"} for name in Score._fields}
_SCORE = foxglove.Schema(
    name="mast.Score",
    encoding="jsonschema",
    data=json.dumps({"type": "object", "properties": _NUMBERS}).encode(),
)


def write(run: RunFrames, path: Path) -> None:
    """Write the file, and next to it a layout, STEM.layout.json.

    Times are those of the scene, from 0.
    """
    context = foxglove.Context()
    with foxglove.open_mcap(path, context=context):
        _Writer(run, context).write()
    path.with_name(f"{path.stem}.layout.json").write_text(json.dumps(layout(run), indent=1) + "\n", encoding="utf-8")


class _Writer:
    """Writes the messages of a run to the channels of a context."""

    def __init__(self, run: RunFrames, context: foxglove.Context) -> None:
        self.run, self.context = run, context
        scene = [*(f"/{topic}" for topic in run.topics.values()), BUILDINGS, CHANGES]
        scene += [f"/{topic}{MISSED}" for series, topic in run.topics.items() if series != TRUTH]
        self.scenes = {topic: channels.SceneUpdateChannel(topic, context=context) for topic in scene}
        self.transforms = channels.FrameTransformsChannel(TRANSFORMS, context=context)
        self.log = channels.LogChannel(LOG, context=context)
        self.cameras = cameras(run)
        self.calibrations = {
            agent: channels.CameraCalibrationChannel(f"/agent/{agent}/camera", context=context) for agent in run.agents
        }
        self.image = channels.CompressedImageChannel(f"/agent/{run.ego}/camera/image", context=context)
        self.blank = _blank(self.cameras[run.ego])
        self.scores = {
            series: foxglove.Channel(
                f"{SCORES}/{'/'.join(series)}", message_encoding="json", schema=_SCORE, context=context
            )
            for series in run.scored
        }

    def write(self) -> None:
        """Write all frames."""
        first = True
        for frame in self.run:
            if first:
                self._buildings(frame.time_ns)
                first = False
            self._poses(frame)
            for series in self.run.topics:
                self._objects(frame, series)
            self._changes(frame)
            for series, score in frame.scores.items():
                values = {name: None if np.isnan(value) else value for name, value in score._asdict().items()}
                self.scores[series].log(values, log_time=frame.time_ns)

    def _objects(self, frame: Frame, series: Series) -> None:
        """The objects of a series, and those that it misses; nothing where no message was recorded."""
        topic, lost = f"/{self.run.topics[series]}", missed(frame, series)
        entities: list[SceneEntity] = []
        if series in frame.objects:
            outcomes = frame.outcomes[series].names
            entities = _entities(frame, frame.objects[series], colours(frame, series), outcomes)
        self._update(topic, frame.time_ns, entities)
        if series != TRUTH:
            colour = np.tile(_MISSED, (len(lost), 1))
            self._update(topic + MISSED, frame.time_ns, _entities(frame, lost, colour, ["missed"] * len(lost)))

    def _update(self, topic: str, time_ns: int, entities: list[SceneEntity]) -> None:
        """Replace all entities of a topic."""
        everything = SceneEntityDeletion(timestamp=_time(time_ns), type=SceneEntityDeletionType.All)
        self.scenes[topic].log(SceneUpdate(deletions=[everything], entities=entities), log_time=time_ns)

    def _buildings(self, time_ns: int) -> None:
        if self.run.scene is None:
            return
        lines = LinePrimitive(
            type=LinePrimitiveLineType.LineList,
            thickness=0.15,
            points=[Point3(x=x, y=y, z=z) for x, y, z in wall_lines(self.run.scene).reshape(-1, 3).tolist()],
            color=_colour(rgb(BUILDING_EDGE)),
        )
        self._update(BUILDINGS, time_ns, [SceneEntity(timestamp=_time(time_ns), frame_id=WORLD, id="0", lines=[lines])])

    def _poses(self, frame: Frame) -> None:
        """The poses of the agents and of their cameras, in one message; the calibrations, and the blank image."""
        time, transforms = _time(frame.time_ns), []
        for agent, pose in frame.poses.items():
            camera = self.cameras[agent]
            for parent, child, position, turn in transforms_of(agent, pose, camera):
                transforms.append(
                    FrameTransform(
                        timestamp=time,
                        parent_frame_id=parent,
                        child_frame_id=child,
                        translation=_vector(position),
                        rotation=_quaternion(turn),
                    )
                )
            k = [camera.focal, 0.0, camera.width / 2, 0.0, camera.focal, camera.height / 2, 0.0, 0.0, 1.0]
            calibration = CameraCalibration(
                timestamp=time,
                frame_id=f"{agent}/camera",
                width=camera.width,
                height=camera.height,
                K=k,
                R=np.eye(3).ravel().tolist(),
                P=[*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0],
            )
            self.calibrations[agent].log(calibration, log_time=frame.time_ns)
            if agent == self.run.ego:
                image = CompressedImage(timestamp=time, frame_id=f"{agent}/camera", data=self.blank, format="png")
                self.image.log(image, log_time=frame.time_ns)
        self.transforms.log(FrameTransforms(transforms=transforms), log_time=frame.time_ns)

    def _changes(self, frame: Frame) -> None:
        """What adversaries inserted, removed and moved, as marks and as lines of a log."""
        changes, entities = frame.changes, []
        for k in range(len(changes.effect)):
            spheres, lines = [], []
            places = [place[k] for place in (changes.before, changes.after) if np.isfinite(place[k]).all()]
            if places and changes.role[k] != "link":
                colour = _colour(_CHANGED, 0.6)
                spheres = [SpherePrimitive(pose=_pose(places[-1]), size=Vector3(x=1.0, y=1.0, z=1.0), color=colour)]
                ends = [Point3(x=x, y=y, z=z) for x, y, z in np.array(places).tolist()]
                lines = [LinePrimitive(thickness=0.2, points=ends, color=colour)] if len(ends) == 2 else []
                words = [
                    KeyValuePair(key=name, value=str(getattr(changes, name)[k]))
                    for name in ("interposer", "wire", "effect")
                ]
                entities.append(
                    SceneEntity(
                        timestamp=_time(frame.time_ns),
                        frame_id=WORLD,
                        id=str(k),
                        metadata=words,
                        spheres=spheres,
                        lines=lines,
                    )
                )
        self._update(CHANGES, frame.time_ns, entities)
        for name, sentence in zip(changes.interposer.tolist(), changes.sentences(), strict=True):
            message = Log(timestamp=_time(frame.time_ns), level=LogLevel.Warning, name=str(name), message=sentence)
            self.log.log(message, log_time=frame.time_ns)


def _entities(frame: Frame, states: ObjectStates, colour: Ints, outcomes: Sequence[str]) -> list[SceneEntity]:
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
                timestamp=_time(frame.time_ns),
                frame_id=WORLD,
                id=str(number),
                metadata=[KeyValuePair(key=key, value=value) for key, value in words.items()],
                cubes=[
                    CubePrimitive(
                        pose=_pose(states.position[k], turns[k]),
                        size=_vector(states.size[k]),
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


def _blank(camera: Camera) -> bytes:
    """An empty image, because image panels draw boxes only on an image."""
    buffer = io.BytesIO()
    Image.new("P", (camera.width, camera.height)).save(buffer, format="png", optimize=True)
    return buffer.getvalue()


def _time(time_ns: int) -> Timestamp:
    return Timestamp(sec=time_ns // 10**9, nsec=time_ns % 10**9)


def _vector(values: Floats) -> Vector3:
    x, y, z = values.tolist()
    return Vector3(x=x, y=y, z=z)


def _quaternion(values: Floats) -> Quaternion:
    x, y, z, w = values.tolist()
    return Quaternion(x=x, y=y, z=z, w=w)


def _pose(position: Floats, turn: Floats | None = None) -> PoseMessage:
    return PoseMessage(position=_vector(position), orientation=Quaternion(w=1.0) if turn is None else _quaternion(turn))


def _colour(values: Sequence[int] | Ints, opacity: float = 1.0) -> Color:
    r, g, b = (float(value) / 255 for value in values)
    return Color(r=r, g=g, b=b, a=opacity)
