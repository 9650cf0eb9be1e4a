"""The part `points` of a scenario: how its lidars scan, and where objects are detected in their points."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mast_zenoh.config import bundle, registry
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.scenes.making.scanning import ScannedPoints
from mast_zenoh.scenes.recording import Recording

#: The map of the wires of points; added where these leave the simulator.
MAP = "points.toml"
#: Where objects are detected in points: by a node between sensor and agent, by the agent, or where they are made.
DETECTED_BY = ("detector", "agent", "simulator")
#: How many detections of a frame a detector of points may have beyond those of the detection model.
MORE_DETECTIONS = 64
#: Keys of the part: those of `ScannedPoints`; the others with their defaults, and with their meanings.
SCANS = ("lidar", "returns", "clutter", "moving")
OTHERS: dict[str, Any] = {
    "detector": {"type": "ClusterDetector"},
    "detected_by": "detector",
    "late_frames": 0,
    "node": {},
    "recorded": None,
}
KEYS = {
    "detector": "finds objects in the points, a `PointDetector`; each lidar has one of its own",
    "detected_by": f"where that is done, one of {', '.join(DETECTED_BY)}: in a node `detector_AGENT` between lidar and "
    "agent; in the agent; or where the points are made, so that none are sent",
    "late_frames": "frames, by which the detections of nodes are late; in real time, the time that they take is added",
    "node": "of the nodes that detect: keys that every node may have, such as `python`, and parameters of their class",
    "recorded": "whether points are recorded, 21 bytes each before compression; None: on wires with an interposer",
}


def described(path: Path, scenario: Mapping[str, Any]) -> dict[str, Any]:
    """The `points` of a scenario with its defaults; empty: none, detections are modelled.

    Raises ConfigurationError for an unknown key, and for a value that its key cannot have.
    """
    options = scenario.get("points")
    if options is None:
        return {}
    for key in options:
        if key not in (*SCANS, *OTHERS):
            raise ConfigurationError(f"{path}: points.{key}: unknown key{nearest(key, (*SCANS, *OTHERS))}")
    complete: dict[str, Any] = {**OTHERS, **options}
    by = complete["detected_by"]
    if by not in DETECTED_BY:
        raise ConfigurationError(f"{path}: points.detected_by: found {by!r}{nearest(str(by), DETECTED_BY)}")
    if by != "detector" and complete["node"]:
        raise ConfigurationError(
            f"{path}: points.node: found {complete['node']!r}, expected it with detected_by=detector"
        )
    late = complete["late_frames"]
    if type(late) is not int or late < 0 or (late and by != "detector"):
        expected = "a whole number from 0" if by == "detector" else "0, as detected_by is not detector"
        raise ConfigurationError(f"{path}: points.late_frames: found {late!r}, expected {expected}")
    if complete["recorded"] not in (None, True, False):
        raise ConfigurationError(
            f"{path}: points.recorded: found {complete['recorded']!r}, expected True, False or None"
        )
    return complete


def simulator_config(options: Mapping[str, Any]) -> dict[str, Any]:
    """The simulator's parameters: how to scan and, if it detects objects itself, how. options: as `described`"""
    if not options:
        return {}
    detector = {"detector": options["detector"]} if options["detected_by"] == "simulator" else {}
    scans = {key: options[key] for key in SCANS if key in options}
    return {"points": {"type": ScannedPoints.__name__, **scans, **detector}}


def equipped(path: Path, options: Mapping[str, Any], recording: Recording) -> Recording:
    """The recording with the lidars that scan; unchanged if none does. options: as `described`"""
    if not options:
        return recording
    scans: ScannedPoints = registry.build(simulator_config(options)["points"], ScannedPoints, f"{path}: points")
    try:
        return scans.equipped(recording)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: points: {error}") from None


def agent_config(options: Mapping[str, Any]) -> dict[str, Any]:
    """An agent's parameters: its detector, or how late the detections of a node may be."""
    return {"detector": options["detector"]} if options.get("detected_by") == "agent" else _late(options)


def _late(options: Mapping[str, Any]) -> dict[str, Any]:
    """The parameter of both nodes by which they know that detections are late."""
    return {"late_frames": options["late_frames"]} if options.get("late_frames") else {}


def detector_config(options: Mapping[str, Any], agent: str) -> dict[str, Any]:
    """The configuration of the node that detects objects for an agent; empty: there is none."""
    if options.get("detected_by") != "detector":
        return {}
    node = options["node"]
    if not {"file", "type"} & node.keys():  # a user's detector may well be in a file detector.py
        node = {"file": str(bundle.ROOT / "nodes" / "detector.py"), **node}
    return {"agent": agent, "detector": options["detector"], **_late(options), **node}


def rewrites(options: Mapping[str, Any]) -> list[str]:
    """The map of points, if any leave the simulator."""
    return [MAP] if options.get("detected_by", "simulator") != "simulator" else []
