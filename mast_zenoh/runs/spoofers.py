"""Where the spoofers of lidars were in a run."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.attacks import Surroundings
from mast_zenoh.attacks.point_attacks import PointAttack
from mast_zenoh.config import registry
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.runs.run import Run
from mast_zenoh.sensing.sensors import sensor_pose


def spoofers(run: Run, frames: Ints) -> dict[str, Floats]:
    """By adversary, (n, 3) m, world frame: where its spoofer is in n frames, whether it attacks then or not.

    Without adversaries of several agents, and attacks that have no place or whose class is not loaded.
    """
    scene, places = run.files.scene, dict[str, Floats]()
    if scene is None:
        return places
    kinds = registry.known_types(PointAttack)
    for name in run.files.scenario.get("nodes", {}):
        config = run.node_spec(name).get("config") or {}
        kind = (config.get("attack") or {}).get("type")
        if kind not in kinds or config.get("agent") not in scene.agent_names:
            continue
        try:
            attack = registry.build(config["attack"], PointAttack, f"{name}.attack")
            known = registry.built(config.get("surroundings", {}), Surroundings, f"{name}.surroundings")
        except ConfigurationError:
            continue
        if attack.place is None:
            continue
        row = scene.agent_names.index(config["agent"])
        lidar = scene.agents[row].sensor
        places[name] = np.zeros((len(frames), 3))
        for index, (frame, time_s) in enumerate(zip(frames.tolist(), run.times(frames).tolist(), strict=True)):
            here = scene.nearest(frame)
            pose = scene.agent_position[here, row], scene.agent_rotation[here, row]
            mount = sensor_pose(*pose, lidar.mount_position, lidar.mount_rotation)
            places[name][index] = attack.place.position(time_s, mount, known)
    return places
