"""One agent of a recorded run: the messages that it sent and received."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow

from mast_zenoh.config.resolved import RECORDING
from mast_zenoh.errors import ConfigurationError, RunFolderError, nearest
from mast_zenoh.metrics.estimates import LOCAL, MISSION
from mast_zenoh.runs import messages as decoded
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.wiring.model import Wiring, subject_of


class AgentMessages:
    """The messages that one agent of a run sent and received, by frame."""

    def __init__(self, path: Path, name: str, wiring: Wiring) -> None:
        self.path = path
        self.name = name
        self._wiring = wiring

    @property
    def tracks(self) -> pyarrow.Table:
        """Tracks by frame, as the broker receives them: columns of `Run.truth`, and score."""
        return self._rows(decoded.states, estimate=LOCAL)

    @property
    def mission(self) -> pyarrow.Table:
        """Objects of the mission estimate (own tracks and picture) by frame, as `tracks`.

        Raises ConfigurationError for an agent that does not act on one, as poles do not.
        """
        if self._wiring.wires and self._wiring.find(self.name, estimate=MISSION) is None:
            others = [wire.subject for wire in self._wiring.wires if wire.traits.estimate == MISSION]
            raise ConfigurationError(
                f"{self.path}: {self.name} makes no mission estimate, as it does not act on one; found "
                f"{', '.join(others) or 'none'}: play the run with --set agents.{self.name}.acts=true"
            )
        return self._rows(decoded.states, estimate=MISSION)

    @property
    def detections(self) -> pyarrow.Table:
        """Received detections by frame, in the sensor's frame: columns of `tracks`, no id.

        `time_s` is the time of the measurement. Of several sensors: those of the first.
        """
        return self._rows(decoded.detections, message="detections")

    def detections_of(self, sensor: str) -> pyarrow.Table:
        """As `detections`, of one of several sensors. Raises ConfigurationError for a name that none has."""
        agents = {agent.name: agent for agent in Recording.open(self.path / RECORDING).agents}
        names = [each.name for each in agents[self.name].sensors]
        if sensor not in names:
            raise ConfigurationError(f"{self.name}: no sensor {sensor!r}{nearest(sensor, names)}")
        return self._rows(decoded.detections, sensor if names.index(sensor) else "", message="detections")

    @property
    def pose(self) -> pyarrow.Table:
        """A row per frame: the agent's pose and velocity in the world frame.

        Columns: x y z (m), vx vy vz (m/s) and the quaternion qw qx qy qz.
        """
        return self._rows(decoded.pose, message="pose")

    def _rows(self, rows: Any, part: str = "", *, estimate: str = "", message: str = "") -> pyarrow.Table:
        """The rows of the messages with an estimate or of a type, of the agent or of a part of it."""
        wire = self._wiring.find(subject_of(self.name, part), estimate=estimate, message=message)
        if wire is None:
            raise RunFolderError(f"{self.path}: wiring.json names no wire with {estimate or message} of {self.name}")
        return decoded.table_of(self.path, wire.key, rows)

    def __repr__(self) -> str:
        return f"<Agent {self.name}: tracks, mission, detections, pose; {self.path}>"
