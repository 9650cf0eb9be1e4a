"""What stands around the objects: buildings, agents with their poses and sensors, and the space that these swept."""

from __future__ import annotations

from typing import Any

import numpy as np

from mast_zenoh.arrays.geometry import heading
from mast_zenoh.arrays.states import Floats
from mast_zenoh.report.playback.columns import Packer
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.interposers import adversaries_by_agent, interposers
from mast_zenoh.scenes.recording import Recording, SceneAgent

#: m, resolution of the swept free space; rad, of directions.
SWEPT, TURN = 0.5, 0.002


def add_surroundings(packer: Packer, run: RunFolder, frames: int) -> dict[str, Any]:
    """Add the columns `agents.*` and `swept`, and return `buildings`, their `tops` and `agents` of the header.

    frames: number of frames of the run; a scene that is shorter keeps its last poses
    """
    recording = run.recording
    if recording is None:
        return {"buildings": [], "tops": [], "agents": []}
    shown = np.minimum(np.arange(frames), len(recording) - 1)
    attacked = adversaries_by_agent(interposers(run))
    agents = [_agent(agent) | {"adversaries": attacked.get(agent.name, ())} for agent in recording.agents]
    position = recording.agent_position[shown]  # frame by frame of one agent: neighbours are alike
    for axis, name in enumerate("xyz"):
        packer.add(f"agents.{name}", position[:, :, axis].T, scale=0.01)
    for name, turn in _turns(recording, shown).items():
        packer.add(f"agents.{name}", turn.T, scale=TURN)
    if recording.sweeps:
        swept = [_swept(recording, index)[shown] for index in range(len(agents))]
        for agent, distances in zip(agents, swept, strict=True):
            agent["sectors"] = distances.shape[1]
        packer.add("swept", np.concatenate([each.T.ravel() for each in swept]), scale=SWEPT)
    outlines = [np.round(outline, 2).tolist() for outline in recording.buildings]
    return {"buildings": outlines, "tops": np.round(recording.building_height, 2).tolist(), "agents": agents}


def _agent(agent: SceneAgent) -> dict[str, Any]:
    sensor, camera = agent.sensor, agent.camera
    return {
        "name": agent.name,
        "kind": agent.kind,
        "object": agent.object_id,
        "range_m": sensor.max_range_m,
        "sector": [float(np.radians(sensor.azimuth_min_deg)), float(np.radians(sensor.azimuth_max_deg))],
        "camera": {
            "position": np.asarray(camera.mount_position, float).tolist(),
            "rotation": np.asarray(camera.mount_rotation, float).ravel().tolist(),
            **{name: getattr(camera, name) for name in ("width", "height", "focal")},
        },
    }


def _turns(recording: Recording, frames: Floats) -> dict[str, Floats]:
    """(f, a) rad: heading of the sensor, and yaw, pitch and roll of the agent."""
    rotation = recording.agent_rotation[frames]
    mounts = np.stack([agent.sensor.mount_rotation for agent in recording.agents])
    headings = np.stack([heading(rotation[:, i] @ mount) for i, mount in enumerate(mounts)], axis=1)
    return {
        "heading": _continuous(headings),
        "yaw": _continuous(np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0])),
        "pitch": np.arcsin(np.clip(-rotation[..., 2, 0], -1.0, 1.0)),
        "roll": np.arctan2(rotation[..., 2, 1], rotation[..., 2, 2]),
    }


def _continuous(angles: Floats) -> Floats:
    return np.unwrap(angles, axis=0)


def _swept(recording: Recording, agent: int) -> Floats:
    """(f, sectors) m, horizontally, to the first obstacle in any band of each sector."""
    sweep, sensor = recording.sweeps[agent].astype(np.float64), recording.agents[agent].sensor
    bands = max(sweep.shape[1], 1)
    edges = np.radians(np.linspace(sensor.elevation_min_deg, sensor.elevation_max_deg, bands + 1))
    across = np.cos((edges[:-1] + edges[1:]) / 2)
    nearest: Floats = (sweep * across[None, :, None]).min(axis=1)
    return nearest
