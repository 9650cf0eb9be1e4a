"""MCAP with Foxglove's schemas, and a layout, for Foxglove and Lichtblick.

Layouts of Foxglove and Lichtblick, and the names of the topics that they show.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import foxglove
import numpy as np
from foxglove import channels
from foxglove import messages as fox
from PIL import Image

from mast_zenoh.arrays.geometry import scalar_last_quaternions
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.metrics.record import Series
from mast_zenoh.runs.evaluated import Score
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.recorded import frames_of
from mast_zenoh.runs.routes import TRUTH
from mast_zenoh.runs.run import Run
from mast_zenoh.runs.scans import CLOUD, LidarScan, scanned_agents, scans_in
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import Camera
from mast_zenoh.show.export import columns
from mast_zenoh.show.export.columns import scene_frame
from mast_zenoh.show.palette import ADVERSARY, BUILDING_EDGE, GROUND, OUTCOME_COLOURS, rgb


def replacement(time_ns: int, entities: list[fox.SceneEntity]) -> fox.SceneUpdate:
    """Replaces all entities of a topic."""
    everything = fox.SceneEntityDeletion(timestamp=timestamp_of(time_ns), type=fox.SceneEntityDeletionType.All)
    return fox.SceneUpdate(deletions=[everything], entities=entities)


def building_entity(run: Run, scene: Recording, time_ns: int) -> fox.SceneEntity:
    """The edges of the buildings of a scene."""
    points = _points(columns.wall_lines(scene).reshape(-1, 3) - run.origin)
    look: dict[str, Any] = {"thickness": 0.15, "color": _colour(rgb(BUILDING_EDGE))}
    lines = fox.LinePrimitive(type=fox.LinePrimitiveLineType.LineList, points=points, **look)
    return _entity(run, time_ns, 0, lines=[lines])


def change_entities(run: Run, frame: Frame) -> list[fox.SceneEntity]:
    """A mark for everything that an adversary inserted, removed or moved; none for the effects of links."""
    made, entities = frame.changes, []
    colour = _colour(rgb(ADVERSARY), 0.6)
    for k in range(len(made.effect)):
        places = [place[k] - run.origin for place in (made.before, made.after) if np.isfinite(place[k]).all()]
        if not places or made.role[k] == "link":
            continue
        spheres = [fox.SpherePrimitive(pose=_pose(places[-1]), size=fox.Vector3(x=1.0, y=1.0, z=1.0), color=colour)]
        lines = [fox.LinePrimitive(thickness=0.2, points=_points(np.array(places)), color=colour)] * (len(places) == 2)
        words = [
            fox.KeyValuePair(key=name, value=str(getattr(made, name)[k])) for name in ("interposer", "wire", "effect")
        ]
        entities.append(_entity(run, frame.time_ns, k, metadata=words, spheres=spheres, lines=lines))
    return entities


def box_entities(
    run: Run, frame: Frame, states: ObjectStates, colour: Ints, outcomes: Sequence[str]
) -> list[fox.SceneEntity]:
    """An entity for each object, named by its id: its box, a line ahead, and its other values as text."""
    positions = states.position - run.origin
    turns, kinds = scalar_last_quaternions(states.yaw), columns.class_names(states)
    ahead = np.stack([np.cos(states.yaw), np.sin(states.yaw), 0 * states.yaw], axis=1) * (states.size[:, :1] / 2 + 1.2)
    lines = np.stack([positions, positions + ahead], axis=1)
    entities = []
    for k, number in enumerate(states.id.tolist()):
        words = {
            "class": kinds[k],
            "outcome": outcomes[k],
            "score": f"{states.score[k]:.3f}",
            "velocity": " ".join(f"{value:.3f}" for value in states.velocity[k]),
        }
        box = fox.CubePrimitive(
            pose=_pose(positions[k], turns[k]), size=vector(states.size[k]), color=_colour(colour[k], 0.5)
        )
        line = fox.LinePrimitive(thickness=0.1, points=_points(lines[k]), color=_colour(colour[k]))
        metadata = [fox.KeyValuePair(key=key, value=value) for key, value in words.items()]
        entities.append(_entity(run, frame.time_ns, number, metadata=metadata, cubes=[box], lines=[line]))
    return entities


def _entity(run: Run, time_ns: int, number: int, **parts: Any) -> fox.SceneEntity:
    return fox.SceneEntity(timestamp=timestamp_of(time_ns), frame_id=columns.scene_frame(run), id=str(number), **parts)


def _points(rows: Floats) -> list[fox.Point3]:
    return [fox.Point3(x=x, y=y, z=z) for x, y, z in rows.tolist()]


def point_cloud(time_ns: int, frame_id: str, scan: LidarScan) -> fox.PointCloud:
    """A scan. frame_id: of the lidar"""
    kinds = {"<f4": fox.PackedElementFieldNumericType.Float32, "<u2": fox.PackedElementFieldNumericType.Uint16}
    columns_of_point = [
        fox.PackedElementField(name=name, offset=offset, type=kinds[dtype.str])
        for name, (dtype, offset, *_) in (CLOUD.fields or {}).items()
    ]
    return fox.PointCloud(
        timestamp=timestamp_of(time_ns),
        frame_id=frame_id,
        pose=_pose(np.zeros(3)),
        point_stride=CLOUD.itemsize,
        fields=columns_of_point,
        data=scan.cloud().tobytes(),
    )


def blank_image(camera: Camera) -> bytes:
    """An empty image, because image panels draw boxes only on an image."""
    buffer = io.BytesIO()
    Image.new("P", (camera.width, camera.height)).save(buffer, format="png", optimize=True)
    return buffer.getvalue()


def timestamp_of(time_ns: int) -> fox.Timestamp:
    """A time of the scene."""
    return fox.Timestamp(sec=time_ns // 10**9, nsec=time_ns % 10**9)


def vector(values: Floats) -> fox.Vector3:
    """values: (3,)"""
    x, y, z = values.tolist()
    return fox.Vector3(x=x, y=y, z=z)


def quaternion(values: Floats) -> fox.Quaternion:
    """values: (4,) x y z w"""
    x, y, z, w = values.tolist()
    return fox.Quaternion(x=x, y=y, z=z, w=w)


def _pose(position: Floats, turn: Floats | None = None) -> fox.Pose:
    return fox.Pose(position=vector(position), orientation=fox.Quaternion(w=1.0) if turn is None else quaternion(turn))


def _colour(values: Sequence[int] | Ints, opacity: float = 1.0) -> fox.Color:
    r, g, b = (float(value) / 255 for value in values)
    return fox.Color(r=r, g=g, b=b, a=opacity)


_MISSED = rgb(OUTCOME_COLOURS["truth missed"])
_NUMBERS = {name: {"type": "number"} for name in Score._fields}
_SCORE = foxglove.Schema(
    name="mast.Score",
    encoding="jsonschema",
    data=json.dumps({"type": "object", "properties": _NUMBERS}).encode(),
)


def write(run: Run, path: Path) -> None:
    """Write the file, and next to it a layout, STEM.layout.json.

    Times are those of the scene, from 0.
    """
    context = foxglove.Context()
    with foxglove.open_mcap(path, context=context):
        channels_of_run = RunChannels(run, context)
        for number, frame in enumerate(frames_of(run)):
            if number == 0:
                channels_of_run.write_buildings(frame.time_ns)
            channels_of_run.write(frame)
    text = json.dumps(layout(run), indent=1) + "\n"
    path.with_name(f"{path.stem}.layout.json").write_text(text, encoding="utf-8")


class RunChannels:
    """The channels of a run, to which frames are written.

    context: holds the channels
    """

    def __init__(self, run: Run, context: foxglove.Context) -> None:
        self.run = run
        self.objects, self.missed = object_topics(run), missed_topics(run)
        scene = [*self.objects.values(), *self.missed.values(), BUILDINGS, CHANGES]
        self.scenes = {topic: channels.SceneUpdateChannel(topic, context=context) for topic in scene}
        self.transforms = channels.FrameTransformsChannel(TRANSFORMS, context=context)
        self.log = channels.LogChannel(LOG, context=context)
        self.cameras = columns.cameras(run)
        self.calibrations = {
            agent: channels.CameraCalibrationChannel(camera_topic(agent), context=context) for agent in run.agents
        }
        self.points = {
            agent: channels.PointCloudChannel(points_topic(agent), context=context) for agent in scanned_agents(run)
        }
        self.image = channels.CompressedImageChannel(image_topic(run.agents[0]), context=context)
        self.blank = blank_image(self.cameras[run.agents[0]])
        self.scores = {
            series: foxglove.Channel(score_topic(series), message_encoding="json", schema=_SCORE, context=context)
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
        if self.run.files.scene is not None:
            self._replace(BUILDINGS, time_ns, [building_entity(self.run, self.run.files.scene, time_ns)])

    def _objects(self, frame: Frame, series: Series) -> None:
        """The objects of a series, and those that it misses; nothing where no message was recorded."""
        entities: list[fox.SceneEntity] = []
        if series in frame.objects:
            outcomes = frame.outcomes[series].names
            entities = box_entities(self.run, frame, frame.objects[series], columns.colours(frame, series), outcomes)
        self._replace(self.objects[series], frame.time_ns, entities)
        if series != TRUTH:
            lost = columns.missed(frame, series)
            colour = np.tile(_MISSED, (len(lost), 1))
            entities = box_entities(self.run, frame, lost, colour, ["missed"] * len(lost))
            self._replace(self.missed[series], frame.time_ns, entities)

    def _replace(self, topic: str, time_ns: int, entities: list[fox.SceneEntity]) -> None:
        self.scenes[topic].log(replacement(time_ns, entities), log_time=time_ns)

    def _poses(self, frame: Frame) -> None:
        """The poses of the agents and of their cameras, in one message; the calibrations, and the blank image."""
        time, transforms = timestamp_of(frame.time_ns), []

        def add(parent: str, child: str, position: Floats, turn: fox.Quaternion) -> None:
            place: dict[str, Any] = {"translation": vector(position), "rotation": turn}
            transforms.append(fox.FrameTransform(timestamp=time, parent_frame_id=parent, child_frame_id=child, **place))

        if columns.scene_frame(self.run) != columns.WORLD:
            add(columns.WORLD, columns.scene_frame(self.run), self.run.origin, fox.Quaternion(w=1.0))
        for agent, pose in frame.poses.items():
            camera = self.cameras[agent]
            for parent, child, position, turn in columns.transforms_of(agent, pose, camera):
                add(parent, child, position, quaternion(turn))
            k = [camera.focal, 0.0, camera.width / 2, 0.0, camera.focal, camera.height / 2, 0.0, 0.0, 1.0]
            calibration = fox.CameraCalibration(
                timestamp=time,
                frame_id=f"{agent}/camera",
                width=camera.width,
                height=camera.height,
                K=k,
                R=np.eye(3).ravel().tolist(),
                P=[*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0],
            )
            self.calibrations[agent].log(calibration, log_time=frame.time_ns)
            if agent == self.run.agents[0]:
                image = fox.CompressedImage(timestamp=time, frame_id=f"{agent}/camera", data=self.blank, format="png")
                self.image.log(image, log_time=frame.time_ns)
        for agent, scan in scans_in(frame).items():
            add(agent, f"{agent}/lidar", scan.position, quaternion(columns.scalar_last(scan.rotation)))
            if agent in self.points:
                cloud = point_cloud(frame.time_ns, f"{agent}/lidar", scan)
                self.points[agent].log(cloud, log_time=frame.time_ns)
        self.transforms.log(fox.FrameTransforms(transforms=transforms), log_time=frame.time_ns)

    def _changes(self, frame: Frame) -> None:
        """What adversaries inserted, removed and moved, as marks and as lines of a log."""
        self._replace(CHANGES, frame.time_ns, change_entities(self.run, frame))
        for name, sentence in zip(frame.changes.interposer.tolist(), frame.changes.sentences, strict=True):
            message = fox.Log(
                timestamp=timestamp_of(frame.time_ns), level=fox.LogLevel.Warning, name=str(name), message=sentence
            )
            self.log.log(message, log_time=frame.time_ns)


TRANSFORMS, BUILDINGS, CHANGES, LOG = "/tf", "/scene/buildings", "/changes", "/log"


def object_topics(run: Run) -> dict[Series, str]:
    """The topic of the objects of each series."""
    return {series: f"/{topic}" for series, topic in run.topics.items()}


def missed_topics(run: Run) -> dict[Series, str]:
    """The topic of the objects that each estimate misses."""
    return {series: f"{topic}/missed" for series, topic in object_topics(run).items() if series != TRUTH}


def score_topic(series: Series) -> str:
    """The topic of the scores of an estimate."""
    return f"/scores/{series.agent}/{series.estimator}"


def camera_topic(agent: str) -> str:
    """The topic of the calibration of an agent's camera."""
    return f"/agent/{agent}/camera"


def image_topic(agent: str) -> str:
    """The topic of the image of an agent's camera."""
    return f"{camera_topic(agent)}/image"


def points_topic(agent: str) -> str:
    """The topic of the scans of an agent's lidar."""
    return f"/agent/{agent}/points"


_FROM_ABOVE, _CAMERA, _FALSE, _MISSED_PLOT, _LOG = (
    "3D!objects",
    "Image!camera",
    "Plot!false",
    "Plot!missed",
    "RosOut!changes",
)


def layout(run: Run) -> dict[str, Any]:
    """A layout with the truth, the picture and what it misses from above and in the main agent's camera; and series."""
    shown = {topic: series.estimator in (PICTURE, TRUTH.estimator) for series, topic in object_topics(run).items()}
    shown |= {topic: series.estimator == PICTURE for series, topic in missed_topics(run).items()}
    shown |= {BUILDINGS: True, CHANGES: True}
    shown |= {points_topic(agent): agent == run.agents[0] for agent in scanned_agents(run)}
    main = run.agents[0]
    scene = scene_of(shown)
    panels: dict[str, Any] = {
        _FROM_ABOVE: scene | from_above(run, scene_frame(run)),
        _CAMERA: scene | {"imageMode": {"calibrationTopic": camera_topic(main), "imageTopic": image_topic(main)}},
        _FALSE: _plot(run, "false objects", "fp"),
        _MISSED_PLOT: _plot(run, "missed objects", "fn"),
        _LOG: {"topicToRender": LOG, "minLogLevel": 1},
    }
    right = split("column", _CAMERA, split("column", _FALSE, split("column", _MISSED_PLOT, _LOG, 50), 33), 40)
    return document(panels, split("row", _FROM_ABOVE, right, 62))


def document(panels: Mapping[str, Any], arrangement: Any) -> dict[str, Any]:
    """A layout of panels by their ids, arranged by `split`."""
    return {
        "configById": dict(panels),
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": arrangement,
    }


def scene_of(shown: Mapping[str, bool]) -> dict[str, Any]:
    """The part of a panel that shows topics in space. shown: by topic, whether it is visible at first"""
    return {
        "topics": {topic: {"visible": visible} for topic, visible in shown.items()},
        "layers": {
            "grid": {"layerId": "foxglove.Grid", "instanceId": "grid", "visible": True, "size": 200, "divisions": 10}
            | {"color": "#2a3340ff"}
        },
        "transforms": {},
        # without lines from the world's origin to every agent
        "scene": {"backgroundColor": GROUND, "transforms": {"lineWidth": 0}},
    }


def from_above(run: Run, frame_id: str) -> dict[str, Any]:
    """The part of a panel that shows all agents from above."""
    centre, distance = view_of(run)
    camera = dict(perspective=False, distance=distance, phi=0, thetaOffset=0, fovy=45, near=0.5, far=5000)
    target = dict(target=[0, 0, 0], targetOrientation=[0, 0, 0, 1], targetOffset=[*centre, 0])
    return {"followMode": "follow-none", "followTf": frame_id, "cameraState": camera | target}


def split(direction: str, first: Any, second: Any, percentage: int) -> dict[str, Any]:
    """Two panels, or arrangements of some, side by side (row) or above each other (column)."""
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percentage}


def _plot(run: Run, title: str, field: str) -> dict[str, Any]:
    """A plot of a score of the main agent's estimates over time."""
    series: list[Series] = [each for each in run.scored if each.agent == run.agents[0]]
    paths = [
        {"value": f"{score_topic(each)}.{field}", "label": each.estimator, "enabled": True}
        | {"timestampMethod": "receiveTime"}
        for each in series
    ]
    return {"title": title, "paths": paths, "showLegend": True, "xAxisVal": "timestamp", "isSynced": True}


def view_of(run: Run) -> tuple[list[float], float]:
    """The centre of the view, m, from the run's origin, and a distance from which it holds all agents, m."""
    if run.files.scene is None:
        return [0.0, 0.0], 150.0
    places = run.files.scene.agent_position[..., :2].reshape(-1, 2) - run.origin[:2]
    low, high = places.min(axis=0), places.max(axis=0)
    return ((low + high) / 2).tolist(), max(float(np.ptp(places, axis=0).max()), 60.0) * 1.5
