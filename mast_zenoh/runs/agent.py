"""One agent of a recorded run: the messages that it sent and received."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow

from mast_zenoh.config.resolved import RECORDING
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.run_folder import json_or_empty
from mast_zenoh.runs import messages as decoded
from mast_zenoh.scenes.recording import Recording


class Agent:
    """The messages that one agent of a run sent and received, by frame."""

    def __init__(self, path: Path, name: str) -> None:
        self.path = path
        self.name = name

    @property
    def tracks(self) -> pyarrow.Table:
        """Tracks by frame, as the broker receives them: columns of `Run.truth`, and score."""
        return self._rows("tracks", decoded.states)

    @property
    def mission(self) -> pyarrow.Table:
        """Objects of the mission estimate (own tracks and picture) by frame, as `tracks`.

        Raises ConfigurationError for an agent that does not act on one, as poles do not.
        """
        wires = [wire["key"] for wire in json_or_empty(self.path / "wiring.json").get("wires", ())]
        if wires and f"agent/{self.name}/mission" not in wires:
            others = [key.split("/")[1] for key in wires if key.startswith("agent/") and key.endswith("/mission")]
            raise ConfigurationError(
                f"{self.path}: {self.name} makes no mission estimate, as it does not act on one; found "
                f"{', '.join(others) or 'none'}: play the run with --set agents.{self.name}.acts=true"
            )
        return self._rows("mission", decoded.states)

    @property
    def detections(self) -> pyarrow.Table:
        """Received detections by frame, in the sensor's frame: columns of `tracks`, no id.

        `time_s` is the time of the measurement. Of several sensors: those of the first.
        """
        return self._rows("detections", decoded.detections)

    def detections_of(self, sensor: str) -> pyarrow.Table:
        """As `detections`, of one of several sensors. Raises ConfigurationError for a name that none has."""
        agents = {agent.name: agent for agent in Recording.open(self.path / RECORDING).agents}
        names = [each.name for each in agents[self.name].sensors]
        if sensor not in names:
            raise ConfigurationError(f"{self.name}: no sensor {sensor!r}{nearest(sensor, names)}")
        return self._rows(f"detections/{sensor}" if names.index(sensor) else "detections", decoded.detections)

    @property
    def pose(self) -> pyarrow.Table:
        """A row per frame: the agent's pose and velocity in the world frame.

        Columns: x y z (m), vx vy vz (m/s) and the quaternion qw qx qy qz.
        """
        return self._rows("pose", decoded.pose)

    def _rows(self, port: str, rows: Any) -> pyarrow.Table:
        return decoded.table_of(self.path, f"agent/{self.name}/{port}", rows)

    def __repr__(self) -> str:
        return f"<Agent {self.name}: tracks, mission, detections, pose; {self.path}>"
