"""The scene of a run whose cars were driven, as it happened: in place of the prepared one, for what shows the run."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.arrays.states import DETECTION_COLUMNS, Detections
from mast_zenoh.config.resolved import RECORDING, Resolved, driver_of
from mast_zenoh.errors import MessageError, RunFolderError, SceneError
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Body
from mast_zenoh.run_folder.recording.reader import read
from mast_zenoh.scenes.recording import TRUTH_COLUMNS, Recording, truth_states
from mast_zenoh.wiring.model import Wiring, subject_of

_TYPES = ("truth", "pose", "detections", "sweep")
#: The messages of the simulator by type and subject: bodies by frame.
_Sent = Mapping[tuple[str, str], Mapping[int, Body]]


def write(folder: Path, resolved: Resolved) -> str:
    """Write the scene as it happened into a run folder whose cars were driven; returns why not, or "".

    It is made of the recorded messages of the simulator, so of no run without a recording.
    """
    if all(spec.role != "driver" for spec in resolved.nodes.values()):
        return ""
    try:
        prepared = resolved.recording or Recording.load(folder / RECORDING)
        happened = _recording(prepared, _messages(folder, resolved))
        happened.validate()
        unfinished = folder / f".{RECORDING}"
        happened.save(unfinished)
        unfinished.replace(folder / RECORDING)
    except (RunFolderError, MessageError, SceneError, ValueError, KeyError) as error:  # of a world of the user's own
        return f"figures, films and views of this run show its prepared scene, in which nobody drives: {error}"
    return ""


def _messages(folder: Path, resolved: Resolved) -> _Sent:
    """What the simulator sent."""
    simulator = driver_of(resolved.nodes)
    legs = [
        (wire, leg)
        for wire, leg in Wiring.from_json(resolved.wiring).legs()
        if leg.publisher.node == simulator and wire.message in _TYPES
    ]
    keys = {leg.key: (wire.message, wire.subject) for wire, leg in legs}
    wires = {wire.key for wire, _ in legs}
    sent: dict[tuple[str, str], dict[int, Body]] = defaultdict(dict)
    for message in read(folder, lambda channel: channel.get("wire") in wires):
        if message.key in keys:  # not what interposers forward
            body = codec.decode(message.payload, message.message).body
            sent[keys[message.key]].setdefault(message.frame, body)
    return sent


def _recording(prepared: Recording, sent: _Sent) -> Recording:
    """The prepared scene with the truth, poses and detections that were sent; the frames that are whole."""
    agents = [agent.name for agent in prepared.agents]
    sensors = [
        subject_of(agent.name, sensor.name if row else "")
        for agent in prepared.agents
        for row, sensor in enumerate(agent.sensors)
    ]
    wires = [("truth", ""), *(("pose", name) for name in agents), *(("detections", name) for name in sensors)]
    whole = set.intersection(*(set(sent.get(wire, {})) for wire in wires))
    frames = range(next((k for k in range(len(prepared)) if k not in whole), len(prepared)))
    if not frames:
        raise SceneError("no frame is whole in its recording")

    def of(port: str, name: str, subjects: list[str]) -> np.ndarray:
        return np.array([[sent[port, subject][k][name] for subject in subjects] for k in frames])

    truth = [sent["truth", ""][k] for k in frames]
    detected = [sent["detections", sensor][k] for k in frames for sensor in sensors]
    swept = [("sweep", name) for name in agents]
    sweeps: tuple[Any, ...] = ()
    if all(set(frames) <= sent.get(wire, {}).keys() for wire in swept):
        sweeps = tuple(np.array([sent[wire][k]["free"] for k in frames], np.float32) for wire in swept)
    detections = {name: np.concatenate([body[name] for body in detected]) for name in DETECTION_COLUMNS}
    return replace(
        prepared,
        times_ns=prepared.times_ns[: len(frames)],
        truth=truth_states({name: np.concatenate([body[name] for body in truth]) for name in TRUTH_COLUMNS}),
        truth_start=np.cumsum([0, *(len(body["id"]) for body in truth)]),
        points=np.concatenate([body["points"] for body in truth]),
        agent_position=of("pose", "position", agents),
        agent_rotation=rotation_from_quaternion(of("pose", "rotation", agents)),
        agent_velocity=of("pose", "velocity", agents),
        detections=Detections(*(detections[name] for name in DETECTION_COLUMNS)),
        detection_start=np.cumsum([0, *(len(body["score"]) for body in detected)]),
        detection_truth_id=np.full(len(detections["score"]), -1, np.int64),  # nobody says of what they are
        sweeps=sweeps,
    )
