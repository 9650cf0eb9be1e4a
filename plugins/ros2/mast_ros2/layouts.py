"""Layouts of a run's topics in ROS 2: for RViz, and for Foxglove with its bridge."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from mast_ros2.run_messages import (
    DIAGNOSTICS,
    MAP,
    MARKERS,
    MOUNTS,
    PREDICTED,
    TRACKED,
    TRANSFORMS,
    RunMessages,
)
from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.runs.routes import TRUTH
from mast_zenoh.runs.run import Run
from mast_zenoh.show.export.foxglove import document, from_above, scene_of, split, view_of
from mast_zenoh.show.palette import GROUND, rgb

_HEADER = "# rviz2 -d {path} --ros-args -p use_sim_time:=true\n# Times are those of the scene, on /clock.\n"

#: Displays of the types of objects. Only that of markers comes with RViz; without the others, RViz says so and goes on.
_CLASSES = {
    MARKERS: "rviz_default_plugins/MarkerArray",
    "": "vision_msgs_rviz_plugins/Detection3DArray",
    TRACKED: "autoware_perception_rviz_plugin/TrackedObjects",
    PREDICTED: "autoware_perception_rviz_plugin/PredictedObjects",
}
#: Pixels a metre of RViz's view from above, times the distance of a camera with the same view, m.
_PIXELS = 900.0


class Layouts(NamedTuple):
    """Where the layouts of a run are."""

    rviz: Path
    foxglove: Path


def write_layouts(messages: RunMessages, folder: Path) -> Layouts:
    """Write both layouts of a run into a folder."""
    result = Layouts(folder / "mast.rviz", folder / "mast.foxglove.json")
    text = yaml.safe_dump(rviz_layout(messages), sort_keys=False, allow_unicode=True)
    result.rviz.write_text(_HEADER.format(path=result.rviz) + text, encoding="utf-8")
    result.foxglove.write_text(json.dumps(foxglove_layout(messages), indent=1) + "\n", encoding="utf-8")
    return result


def rviz_layout(messages: RunMessages) -> dict[str, Any]:
    """A configuration of RViz with a display for each topic that it can show; truth and pictures are visible."""
    of_objects = [
        _display_of_topic(kind, topic + ending, visible=ending == MARKERS and series in _shown(messages.run))
        for ending, kind in _CLASSES.items()
        for series, topic in messages.objects.items()
    ]
    of_agents = [
        _display_of_topic("rviz_default_plugins/Odometry", topic, visible=False, Keep=1, Shape={"Value": "Axes"})
        for topic in messages.odometry.values()
    ]
    of_lidars = [
        _display_of_topic("rviz_default_plugins/PointCloud2", topic, visible=agent == messages.run.agents[0])
        for agent, topic in messages.points.items()
    ]
    (x, y), distance = view_of(messages.run)
    grid = {"Cell Size": 20, "Plane Cell Count": 10, "Reference Frame": "<Fixed Frame>"}
    return {
        "Panels": [
            {"Class": "rviz_common/Displays", "Name": "Displays"},
            {"Class": "rviz_common/Views", "Name": "Views"},
            {"Class": "rviz_common/Time", "Name": "Time", "SyncMode": 0, "SyncSource": ""},
        ],
        "Visualization Manager": {
            "Class": "",
            "Displays": [
                _display("rviz_default_plugins/Grid", "Grid") | grid,
                _display("rviz_default_plugins/TF", f"{TRANSFORMS}, {MOUNTS}")
                | {"Show Arrows": False, "Marker Scale": 5},
                *of_objects,
                *of_agents,
                *of_lidars,
            ],
            "Enabled": True,
            "Global Options": {"Background Color": _colour(GROUND), "Fixed Frame": MAP, "Frame Rate": 30},
            "Name": "root",
            "Tools": [
                {"Class": f"rviz_default_plugins/{name}"} for name in ("MoveCamera", "Select", "FocusCamera", "Measure")
            ],
            "Transformation": {"Current": {"Class": "rviz_default_plugins/TF"}},
            "Value": True,
            "Views": {
                "Current": {
                    "Class": "rviz_default_plugins/TopDownOrtho",
                    "Name": "Current View",
                    "Target Frame": "<Fixed Frame>",
                    "Value": "TopDownOrtho (rviz_default_plugins)",
                    "Angle": 0,
                    "Scale": _PIXELS / distance,
                    "X": x,
                    "Y": y,
                },
                "Saved": None,
            },
        },
        "Window Geometry": {"Width": 1400, "Height": 900},
    }


def foxglove_layout(messages: RunMessages) -> dict[str, Any]:
    """A layout with the markers from above, and the diagnostics if there are some."""
    shown = {topic + MARKERS: series in _shown(messages.run) for series, topic in messages.objects.items()}
    space, judged = "3D!objects", "DiagnosticSummary!trust"
    panels: dict[str, Any] = {space: scene_of(shown) | from_above(messages.run, MAP)}
    if DIAGNOSTICS not in {topic.name for topic in messages.topics}:
        return document(panels, space)
    panels[judged] = {"topicToRender": DIAGNOSTICS, "minLevel": 0}
    return document(panels, split("row", space, judged, 70))


def _shown(run: Run) -> list[Any]:
    """The series that are visible at first."""
    return [series for series in run.topics if series == TRUTH or series.estimator == PICTURE]


def _display(kind: str, name: str, *, visible: bool = True) -> dict[str, Any]:
    """A display of RViz."""
    return {"Class": kind, "Name": name, "Enabled": visible, "Value": visible}


def _display_of_topic(kind: str, topic: str, *, visible: bool, **more: Any) -> dict[str, Any]:
    """A display of RViz for a topic, reliable and volatile as the bridge publishes it."""
    policies = {"Depth": 10, "Durability Policy": "Volatile", "History Policy": "Keep Last"}
    source = {"Value": topic, **policies, "Reliability Policy": "Reliable"}
    return _display(kind, topic, visible=visible) | {"Topic": source, **more}


def _colour(name: str) -> str:
    return "; ".join(map(str, rgb(name)))
