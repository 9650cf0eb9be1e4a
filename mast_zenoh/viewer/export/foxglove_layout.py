"""The layout of a run for Foxglove and Lichtblick, which show nothing without one.

This is the format that both import from a file (`configById`), not that of Foxglove's `layouts` module, which
Lichtblick does not read.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mast_zenoh.metrics.record import PICTURE, Series
from mast_zenoh.viewer.export import foxglove_topics as topics
from mast_zenoh.viewer.export.cameras import WORLD
from mast_zenoh.viewer.frame import FrameSource
from mast_zenoh.viewer.palette import GROUND
from mast_zenoh.viewer.routes import TRUTH

_FROM_ABOVE, _CAMERA, _FALSE, _MISSED, _LOG = (
    "3D!objects",
    "Image!camera",
    "Plot!false",
    "Plot!missed",
    "RosOut!changes",
)


def layout(run: FrameSource) -> dict[str, Any]:
    """A layout with the truth, the picture and what it misses from above and in the main agent's camera; and series."""
    shown = {topic: series.estimator in (PICTURE, TRUTH.estimator) for series, topic in topics.objects(run).items()}
    shown |= {topic: series.estimator == PICTURE for series, topic in topics.missed(run).items()}
    shown |= {topics.BUILDINGS: True, topics.CHANGES: True}
    centre, distance = _view(run)
    scene = {
        "topics": {topic: {"visible": visible} for topic, visible in shown.items()},
        "layers": {
            "grid": {"layerId": "foxglove.Grid", "instanceId": "grid", "visible": True, "size": 200, "divisions": 10}
            | {"color": "#2a3340ff"}
        },
        "transforms": {},
        # without lines from the world's origin to every agent
        "scene": {"backgroundColor": GROUND, "transforms": {"lineWidth": 0}},
    }
    panels: dict[str, Any] = {
        _FROM_ABOVE: scene
        | {
            "followMode": "follow-none",
            "followTf": WORLD,
            "cameraState": {
                "perspective": False,
                "distance": distance,
                "phi": 0,
                "thetaOffset": 0,
                "fovy": 45,
                "near": 0.5,
                "far": 5000,
                "target": [0, 0, 0],
                "targetOrientation": [0, 0, 0, 1],
                "targetOffset": [*centre, 0],
            },
        },
        _CAMERA: scene
        | {"imageMode": {"calibrationTopic": topics.camera(run.ego), "imageTopic": topics.image(run.ego)}},
        _FALSE: _plot(run, "false objects", "fp"),
        _MISSED: _plot(run, "missed objects", "fn"),
        _LOG: {"topicToRender": topics.LOG, "minLogLevel": 1},
    }
    right = _split("column", _CAMERA, _split("column", _FALSE, _split("column", _MISSED, _LOG, 50), 33), 40)
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split("row", _FROM_ABOVE, right, 62),
    }


def _split(direction: str, first: Any, second: Any, percentage: int) -> dict[str, Any]:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percentage}


def _plot(run: FrameSource, title: str, field: str) -> dict[str, Any]:
    """A plot of a score of the main agent's estimates over time."""
    series: list[Series] = [each for each in run.scored if each.agent == run.ego]
    paths = [
        {"value": f"{topics.scores(each)}.{field}", "label": each.estimator, "enabled": True}
        | {"timestampMethod": "receiveTime"}
        for each in series
    ]
    return {"title": title, "paths": paths, "showLegend": True, "xAxisVal": "timestamp", "isSynced": True}


def _view(run: FrameSource) -> tuple[list[float], float]:
    """The centre of the view, m, and a distance from which it holds all agents, m."""
    if run.scene is None:
        return [0.0, 0.0], 150.0
    places = run.scene.agent_position[..., :2].reshape(-1, 2)
    low, high = places.min(axis=0), places.max(axis=0)
    return ((low + high) / 2).tolist(), max(float(np.ptp(places, axis=0).max()), 60.0) * 1.5
