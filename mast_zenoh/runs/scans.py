"""The recorded scans of the agents' lidars, as detectors received them: after all interposers on their wire."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import MessageError
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Body
from mast_zenoh.metrics.record import Series
from mast_zenoh.run_folder.recording.format import records_scans
from mast_zenoh.run_folder.recording.reader import read
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.routes import POINTS, scan_keys
from mast_zenoh.runs.run import Run
from mast_zenoh.sensing.points import Points

#: A point as point clouds of other programs have it: m, 0 to 1, s from the time of the scan, and the channel.
CLOUD = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("t", "<f4"), ("ring", "<u2")], align=True
)


class LidarScan(NamedTuple):
    """One scan of an agent's lidar.

    points:   in the lidar's frame
    position: (3,) m, of the lidar in the agent's frame;  rotation: (3, 3) active, lidar to agent
    """

    points: Points
    position: Floats
    rotation: Floats

    def cloud(self) -> NDArray[np.void]:
        """(n,) of CLOUD."""
        points, result = self.points, np.zeros(len(self.points), CLOUD)
        columns = *points.position.T, points.intensity, points.time_s, points.channel
        for name, column in zip(CLOUD.names or (), columns, strict=True):
            result[name] = column
        return result


def scanned_agents(run: Run) -> tuple[str, ...]:
    """The agents of a finished run whose scans were recorded."""
    recorder = run.node_spec("recorder").get("config")
    if run.files.is_live or not isinstance(recorder, dict):
        return ()
    wires = [wire for _, wiring in run.files.wirings for wire in wiring.wires]
    with_points = {wire.subject for wire in wires if records_scans(wire, recorder.get("points"))}
    return tuple(agent for agent in run.agents if agent in with_points)


def scans_of(run: Run, agent: str, frames: range) -> Iterator[tuple[int, LidarScan]]:
    """Frame and scan of an agent in some frames of a recorded run, in order; frames without one are left out.

    Raises RunFolderError if there is no recording, or if it is damaged before its end.
    """
    known = [(frame, scan_keys(wiring, (agent,))) for frame, wiring in run.files.wirings]
    last = -1
    for message in read(run.path, lambda channel: channel.get("message") == POINTS):
        keys = next(of for frame, of in reversed(known) if frame < message.step or frame < 0)
        if message.key in keys and not message.malformed and message.frame in frames and message.frame > last:
            with suppress(MessageError):  # receivers refuse it
                scan = _scan(codec.decode(message.payload, message.type).body)
                last = message.frame
                yield last, scan


def scans_in(frame: Frame) -> dict[str, LidarScan]:
    """By agent, its scan in a frame of a recorded run; an agent without one is absent."""
    bodies = {agent: frame.bodies.get(Series(agent, POINTS)) for agent in frame.run.agents}
    return {agent: _scan(body) for agent, body in bodies.items() if body is not None}


def _scan(body: Body) -> LidarScan:
    """The scan of the columns of a message."""
    turn = rotation_from_quaternion(body["mount_rotation"])
    return LidarScan(Points.from_columns(body), body["mount_position"], turn)
