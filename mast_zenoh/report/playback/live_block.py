"""Frames of a running run as blocks for the page, one block a frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.arrays.states import Detections, Floats
from mast_zenoh.launch.tables import as_read, to_arrow
from mast_zenoh.messages.schemas import Body
from mast_zenoh.metrics.record import Series
from mast_zenoh.report.playback.block import pack_frames
from mast_zenoh.report.playback.boxes import boxes_of
from mast_zenoh.report.playback.columns import Packer
from mast_zenoh.report.playback.conduct import spans
from mast_zenoh.report.playback.motion import motion_of
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.scenes.recording import Recording, truth_states
from mast_zenoh.viewer.live.measurement import MeasuredFrame
from mast_zenoh.viewer.live.observer import Observer
from mast_zenoh.viewer.routes import POSE, TRUTH
from mast_zenoh.wiring.model import Wiring

#: Parts of the header that rarely change: the page gets them once, and again when they change.
LASTING = (
    *("format", "id", "label", "ego", "scored", "gate_m", "range_m", "classes", "colours", "estimates"),
    *("buildings", "tops", "agents", "states", "flags", "judged", "effects", "recorded"),
)
_TRACKS = frozenset(("local", "received", "mission", "picture", "picture_received"))


@dataclass
class LiveBlocks:
    """Makes blocks of the frames of an observed run; keeps what later frames may not repeat.

    poses: by agent, its latest position (3,) m and rotation (3, 3);  trust: latest rows of the trust table
    """

    observer: Observer
    poses: dict[str, tuple[Floats, Floats]]
    trust: Mapping[str, Any] | None = None
    _written: tuple[Wiring, dict[str, Any]] | None = None

    @classmethod
    def of(cls, observer: Observer) -> LiveBlocks:
        """Of a run that is being observed."""
        scene = observer.run.scene
        if scene is None:
            return cls(observer, {})
        first = zip(scene.agent_names, scene.agent_position[0], scene.agent_rotation[0], strict=True)
        return cls(observer, {name: (position, rotation) for name, position, rotation in first})

    def header_and_block(self, frame: MeasuredFrame) -> tuple[dict[str, Any], bytes]:
        """The lasting part of the header of a frame, and the block with everything else.

        Raises ValueError if a number is too large for a block.
        """
        run = self._run(frame)
        bodies = {series: body for series, body in frame.bodies.items() if series.estimator in _TRACKS}
        boxes = boxes_of(to_arrow(_renumbered(frame.tables["objects"])), run.recording)
        motion = motion_of(boxes, ((0, body) for body in bodies.values()), run.recording)
        packer = Packer()
        time_s = frame.time_ns * 1e-9
        packer.add("time", np.array([time_s]), scale=1e-3)
        header = pack_frames(packer, run, boxes, motion, np.zeros(1))
        header |= {"label": run.label, "recorded": True, "scored": None}
        header |= self._happening(run, frame, time_s)
        lasting = {name: header.pop(name) for name in LASTING}
        return lasting, packer.block(header)

    def _happening(self, run: RunFolder, frame: MeasuredFrame, time_s: float) -> dict[str, Any]:
        """What is said of the run as a whole, up to this frame."""
        observer = self.observer
        periods = spans(run, np.array([time_s]))
        for each in observer.insertions:
            until = time_s if each.until_s is None else each.until_s
            wires = ", ".join(each.wires)
            words = {"begins": f"{each.node} inserted on {wires}", "ends": f"{each.node} removed from {wires}"}
            period = {"from_s": each.since_s, "until_s": until, **words, "nodes": [each.node]}
            periods.append({"label": f"{each.node} inserted live", "kind": "interception", **period})
        return {
            "number": frame.number,
            "spans": sorted(periods, key=lambda each: (each["from_s"], each["label"])),
            "newest": observer.frame,
            "refused": frame.refused,
            "down": observer.down,
            "notes": observer.meter.notes,
            "wires": [
                {"key": wire.key, "legs": [leg._asdict() for leg in wire.legs], "to": wire.subscribers}
                for wire in observer.wires()
            ],
        }

    def _run(self, frame: MeasuredFrame) -> RunFolder:
        """The frame as if it were a whole run: its tables, and a scene of one frame, number 0."""
        resolved = self.observer.run.resolved
        tables = {name: _renumbered(table) for name, table in frame.tables.items()}
        if "trust" in tables:
            self.trust = tables["trust"]
        down = [{"node": node, "action": "kill", "frame": 0} for node in self.observer.down]
        return RunFolder(
            path=Path(),
            run={"id": self.observer.run.id, "name": resolved.name, "steps": down},
            scenario=self._scenario,
            wiring=self._wiring_json(),
            metrics={"agents": dict.fromkeys(self.observer.meter.agents), "same_as": frame.same_as},
            counts=as_read(tables["metrics"]),
            objects=None,
            effects=as_read(tables["attacks"]),
            recording=self._scene(frame),
            missing=(),
            trust=None if self.trust is None else as_read(self.trust),
            trust_objects=as_read(tables["trust_objects"]) if "trust_objects" in tables else None,
        )

    @cached_property
    def _scenario(self) -> dict[str, Any]:
        return self.observer.run.resolved.to_json()

    def _wiring_json(self) -> dict[str, Any]:
        """The current wiring as in wiring.json; made anew when it has changed."""
        current = self.observer.wiring
        if self._written is None or self._written[0] is not current:
            self._written = current, current.to_json()
        return self._written[1]

    def _scene(self, frame: MeasuredFrame) -> Recording | None:
        """The scene of a frame as the messages have it, with the sensors and buildings of the prepared one."""
        scene = self.observer.run.scene
        if scene is None:
            return None
        for name in self.poses:
            if (body := frame.bodies.get(Series(name, POSE))) is not None:
                self.poses[name] = body["position"], rotation_from_quaternion(body["rotation"])
        poses = [self.poses[name] for name in scene.agent_names]
        truth_body: Body = frame.bodies.get(TRUTH, {})
        truth = truth_states(truth_body) if truth_body else scene.truth.select(slice(0, 0))
        number = min(frame.number, len(scene) - 1)  # a shorter scene keeps its last sweeps
        return replace(
            scene,
            times_ns=np.zeros(1, np.int64),
            truth=truth,
            truth_start=np.array([0, len(truth)]),
            points=np.zeros((len(truth), len(scene.agents)), np.int32),
            agent_position=np.array([[position for position, _ in poses]]),
            agent_rotation=np.array([[rotation for _, rotation in poses]]),
            agent_velocity=np.zeros((1, len(poses), 3)),
            detections=Detections.empty(),
            detection_start=np.zeros(1 + len(scene.sensor_names), np.int64),
            detection_truth_id=np.zeros(0, np.int64),
            sweeps=tuple(sweep[number : number + 1] for sweep in scene.sweeps),
            measurements=None,
        )


def _renumbered(table: Mapping[str, Any]) -> dict[str, Any]:
    """A table whose rows are all of frame 0."""
    return {**table, "frame": np.zeros(len(table["frame"]), np.int64)}
