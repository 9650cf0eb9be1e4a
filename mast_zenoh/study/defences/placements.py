"""Which agents of a scenario are compromised or faulty, and the scenes that have a number of agents."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mast_zenoh import scenes
from mast_zenoh.config import registry
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.scenario import choose_scene, victims_of
from mast_zenoh.streams import stream

#: By name, an entry of a scenario's `faults`, without its time and its targets.
FAULTS: dict[str, dict[str, Any]] = {
    "pose": {"type": "Impair", "rule": {"type": "PoseError", "bias_m": (0.7, 0.4), "bias_yaw_rad": 0.01}},
    "delay": {"type": "Delay", "mean_s": 0.2, "jitter_s": 0.05},
    "skew": {"type": "Impair", "rule": {"type": "ClockSkew", "offset_s": 0.1}},
    "loss": {"type": "BurstLoss", "good_to_bad": 0.1, "bad_to_good": 0.3},
    "blind": {"type": "BlindSector", "azimuth_min_deg": -20.0, "azimuth_max_deg": 20.0},
    "ghosts": {"type": "GhostDetections", "frame": "sensor", "places": [(25.0, 4.0, 0.75), (35.0, -6.0, 0.75)]},
}

#: poles: static agents first, as in the other scenarios; random: by the seed; worst: those that cover the most objects.
PLACEMENTS = ("poles", "random", "worst")
#: Lidar returns from which an agent sees an object.
MIN_RETURNS = 5


def check_fault(name: str) -> None:
    """Raise ConfigurationError for an unknown fault."""
    if name not in FAULTS:
        raise ConfigurationError(f"fault: found {name!r}{nearest(name, FAULTS)}")


def faults_of(name: str | None, agents: Sequence[str], at_s: float) -> list[dict[str, Any]]:
    """The `faults` of a scenario in which agents have the fault from a time, s, on; None, or no agents: none."""
    if name is None or not agents:
        return []
    check_fault(name)
    return [FAULTS[name] | {"at": at_s, "nodes": list(agents)}]


def place(
    scene: str | Mapping[str, Any], count: int, placement: str = "poles", seed: int = 0, frames: int | None = None
) -> tuple[str, ...]:
    """The names of `count` agents to compromise, never the ego.

    placement: one of PLACEMENTS;  seed, frames: of the run. With the same seed, fewer agents are always among more.
    Raises ConfigurationError for an unknown placement, or if the scene has too few agents.
    """
    if placement not in PLACEMENTS:
        raise ConfigurationError(f"placement: found {placement!r}{nearest(str(placement), PLACEMENTS)}")
    poles = victims_of(scene, count)
    if placement == "poles" or count == 0:  # without recording the scene
        return poles
    spec = choose_scene(scene)
    built = registry.build(spec, scenes.Scene, "scene")
    if placement == "random":
        names = scenes.prepare(built, 0, 1, json.dumps(spec, sort_keys=True)).agent_names[1:]
        order = stream(seed, "placement").permutation(len(names))
    else:
        recording = scenes.prepare(built, seed, frames, json.dumps(spec, sort_keys=True))
        names = recording.agent_names[1:]
        order = by_coverage(recording.points[:, 1:])
    return _chosen(names, order, count)


def by_coverage(points: NDArray[np.int32]) -> NDArray[np.int64]:
    """(a,) agents from the one that covers the most objects to the one that covers the fewest; ties in their order.

    points: (n, a) lidar returns of n objects, over all frames, at a agents
    """
    covered = (np.asarray(points) >= MIN_RETURNS).sum(axis=0)
    return np.argsort(-covered, kind="stable").astype(np.int64)


def _chosen(names: Sequence[str], order: NDArray[Any], count: int) -> tuple[str, ...]:
    return tuple(names[index] for index in order[:count].tolist())


def honest_majority(points: ArrayLike, malicious: ArrayLike) -> float:
    """Share of objects that more honest agents see than malicious ones, of those that any agent sees; NaN: none.

    points:    (n, a) lidar returns of n objects, over all frames, at a agents
    malicious: (a,) bool
    """
    sees = np.asarray(points) >= MIN_RETURNS
    lying = np.asarray(malicious, bool)
    seen = sees[sees.any(axis=1)]
    if not len(seen):
        return float("nan")
    return float((seen[:, ~lying].sum(axis=1) > seen[:, lying].sum(axis=1)).mean())
