"""The command centre's pipeline, from the tracks of all agents to the picture."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.fusion.base import Clusterer, GroupTracker


class Pipeline(ABC):
    """Turns the tracks of all agents into the picture."""

    @abstractmethod
    def step(
        self, time_ns: int, states: ObjectStates, agent: Ints, agents: tuple[str, ...], weights: Floats | None = None
    ) -> tuple[ObjectStates, Ints]:
        """The picture and the support of its objects at `time_ns`.

        The picture is sorted by id; support (n,) is the number of agents with a track in each object's cluster.

        states: n tracks of all agents, world frame, at `time_ns`
        agent: (n,) int64, rows of `agents`, the agents' names
        weights: (n,), see `Fusion.fuse`

        The result does not depend on the order of the rows or of the agents.
        """

    @abstractmethod
    def reset(self) -> None:
        """Return to the initial state."""


class CommandCenterPipeline(Pipeline):
    """Clustering, then fusion and tracking of the clusters.

    clustering: groups tracks by object; group_tracking: turns clusters into the picture
    """

    def __init__(self, *, clustering: Clusterer, group_tracking: GroupTracker) -> None:
        self._clustering = clustering
        self._group_tracking = group_tracking

    def step(
        self, time_ns: int, states: ObjectStates, agent: Ints, agents: tuple[str, ...], weights: Floats | None = None
    ) -> tuple[ObjectStates, Ints]:
        # Sorted by name, because the order of `agents` depends on the arrival of their messages.
        rank = {name: row for row, name in enumerate(sorted(agents))}
        agent = np.array([rank[name] for name in agents], np.int64)[agent]
        labels = self._clustering.cluster(states, agent)
        return self._group_tracking.step(time_ns, states, agent, labels, weights)

    def reset(self) -> None:
        self._group_tracking.reset()
