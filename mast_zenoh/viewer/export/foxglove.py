"""MCAP with Foxglove's schemas, and a layout, for Foxglove and Lichtblick."""

from __future__ import annotations

import json
from pathlib import Path

import foxglove
import numpy as np
from foxglove import channels
from foxglove.messages import (
    CameraCalibration,
    CompressedImage,
    FrameTransform,
    FrameTransforms,
    Log,
    LogLevel,
    SceneEntity,
)

from mast_zenoh.metrics.record import Series
from mast_zenoh.viewer.evaluated import Score
from mast_zenoh.viewer.export import foxglove_messages as messages
from mast_zenoh.viewer.export import foxglove_topics as topics
from mast_zenoh.viewer.export.cameras import cameras, transforms_of
from mast_zenoh.viewer.export.columns import colours, missed
from mast_zenoh.viewer.export.foxglove_layout import layout
from mast_zenoh.viewer.frame import Frame, FrameSource
from mast_zenoh.viewer.palette import OUTCOME_COLOURS, rgb
from mast_zenoh.viewer.routes import TRUTH

_MISSED = rgb(OUTCOME_COLOURS["truth missed"])
_NUMBERS = {name: {"type": "number"} for name in Score._fields}
_SCORE = foxglove.Schema(
    name="mast.Score",
    encoding="jsonschema",
    data=json.dumps({"type": "object", "properties": _NUMBERS}).encode(),
)


def write(run: FrameSource, path: Path) -> None:
    """Write the file, and next to it a layout, STEM.layout.json.

    Times are those of the scene, from 0.
    """
    context = foxglove.Context()
    with foxglove.open_mcap(path, context=context):
        channels_of_run = RunChannels(run, context)
        for number, frame in enumerate(run):
            if number == 0:
                channels_of_run.write_buildings(frame.time_ns)
            channels_of_run.write(frame)
    write_layout(run, path.with_name(f"{path.stem}.layout.json"))


def write_layout(run: FrameSource, path: Path) -> None:
    """Write the layout of a run."""
    path.write_text(json.dumps(layout(run), indent=1) + "\n", encoding="utf-8")


class RunChannels:
    """The channels of a run, to which frames are written: of a file, or of a server.

    context: holds the channels
    """

    def __init__(self, run: FrameSource, context: foxglove.Context) -> None:
        self.run = run
        self.objects, self.missed = topics.objects(run), topics.missed(run)
        scene = [*self.objects.values(), *self.missed.values(), topics.BUILDINGS, topics.CHANGES]
        self.scenes = {topic: channels.SceneUpdateChannel(topic, context=context) for topic in scene}
        self.transforms = channels.FrameTransformsChannel(topics.TRANSFORMS, context=context)
        self.log = channels.LogChannel(topics.LOG, context=context)
        self.cameras = cameras(run)
        self.calibrations = {
            agent: channels.CameraCalibrationChannel(topics.camera(agent), context=context) for agent in run.agents
        }
        self.image = channels.CompressedImageChannel(topics.image(run.ego), context=context)
        self.blank = messages.blank_image(self.cameras[run.ego])
        self.scores = {
            series: foxglove.Channel(topics.scores(series), message_encoding="json", schema=_SCORE, context=context)
            for series in run.scored
        }

    def write(self, frame: Frame) -> None:
        """Write a frame."""
        self._poses(frame)
        for series in self.run.topics:
            self._objects(frame, series)
        self._changes(frame)
        for series, score in frame.scores.items():
            if series in self.scores:
                values = {name: None if np.isnan(value) else value for name, value in score._asdict().items()}
                self.scores[series].log(values, log_time=frame.time_ns)

    def write_buildings(self, time_ns: int) -> None:
        """Write what does not change with the frame."""
        if self.run.scene is not None:
            self._replace(topics.BUILDINGS, time_ns, [messages.buildings(self.run.scene, time_ns)])

    def _objects(self, frame: Frame, series: Series) -> None:
        """The objects of a series, and those that it misses; nothing where no message was recorded."""
        entities: list[SceneEntity] = []
        if series in frame.objects:
            outcomes = frame.outcomes[series].names
            entities = messages.boxes(frame, frame.objects[series], colours(frame, series), outcomes)
        self._replace(self.objects[series], frame.time_ns, entities)
        if series != TRUTH:
            lost = missed(frame, series)
            colour = np.tile(_MISSED, (len(lost), 1))
            entities = messages.boxes(frame, lost, colour, ["missed"] * len(lost))
            self._replace(self.missed[series], frame.time_ns, entities)

    def _replace(self, topic: str, time_ns: int, entities: list[SceneEntity]) -> None:
        self.scenes[topic].log(messages.replacement(time_ns, entities), log_time=time_ns)

    def _poses(self, frame: Frame) -> None:
        """The poses of the agents and of their cameras, in one message; the calibrations, and the blank image."""
        time, transforms = messages.time(frame.time_ns), []
        for agent, pose in frame.poses.items():
            camera = self.cameras[agent]
            for parent, child, position, turn in transforms_of(agent, pose, camera):
                transforms.append(
                    FrameTransform(
                        timestamp=time,
                        parent_frame_id=parent,
                        child_frame_id=child,
                        translation=messages.vector(position),
                        rotation=messages.quaternion(turn),
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
        self._replace(topics.CHANGES, frame.time_ns, messages.changes(frame))
        for name, sentence in zip(frame.changes.interposer.tolist(), frame.changes.sentences(), strict=True):
            message = Log(
                timestamp=messages.time(frame.time_ns), level=LogLevel.Warning, name=str(name), message=sentence
            )
            self.log.log(message, log_time=frame.time_ns)
