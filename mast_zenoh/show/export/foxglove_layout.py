"""Layouts of Foxglove and Lichtblick, and the names of the topics that they show."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.metrics.record import Series
from mast_zenoh.runs.routes import TRUTH
from mast_zenoh.runs.run import Run
from mast_zenoh.show.export.columns import scene_frame
from mast_zenoh.show.palette import GROUND

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
