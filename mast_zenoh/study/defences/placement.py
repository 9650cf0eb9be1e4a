"""Numbers of agents, and which of them are compromised."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh import scenes
from mast_zenoh.config import registry
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.scenario import choose_scene, victims_of
from mast_zenoh.streams import stream

#: poles: static agents first, as in the other scenarios; random: by the seed; worst: those that cover the most objects.
PLACEMENTS = ("poles", "random", "worst")
#: Lidar returns from which an agent sees an object.
MIN_RETURNS = 5
#: Up to so many agents, all but the ego stand on poles.
_POLES_ALONE = 5
_MAX_AGENTS = 29


def sensors_of(agents: int) -> dict[str, int]:
    """The parameters of a generated junction with this number of agents, the ego included.

    Poles, and above five agents cars, too: 8 and 4 for 13 agents, 12 and 8 for 21. Raises ConfigurationError for a
    number of agents that a junction cannot have.
    """
    if type(agents) is not int or not 2 <= agents <= _MAX_AGENTS:
        raise ConfigurationError(f"agents: found {agents!r}, expected whole numbers from 2 to {_MAX_AGENTS}")
    cars = max(0, (agents - _POLES_ALONE) // 2)
    return {"n_infrastructure": agents - 1 - cars, "n_mobile": cars}


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
