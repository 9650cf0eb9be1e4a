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
        """(picture, support): objects at `time_ns`, sorted by id, and how many agents' tracks are now in each (n,).

        states: n tracks of all agents, world frame, at `time_ns`
        agent: (n,) int64, rows of `agents`, the agents' names
        weights: (n,), see `Fusion.fuse`

        The result does not depend on the order of the rows, nor on that of the agents.
        """

    @abstractmethod
    def reset(self) -> None:
        """Back to the state of a newly made one."""


class CommandCenterPipeline(Pipeline):
    """Clustering, then fusion and tracking of the clusters.

    clustering: which tracks are of one object; group_tracking: what becomes of a cluster
    """

    def __init__(self, *, clustering: Clusterer, group_tracking: GroupTracker) -> None:
        self._clustering = clustering
        self._group_tracking = group_tracking

    def step(
        self, time_ns: int, states: ObjectStates, agent: Ints, agents: tuple[str, ...], weights: Floats | None = None
    ) -> tuple[ObjectStates, Ints]:
        # By name, not by row: agents are listed as their messages come in.
        rank = {name: row for row, name in enumerate(sorted(agents))}
        agent = np.array([rank[name] for name in agents], np.int64)[agent]
        labels = self._clustering.cluster(states, agent)
        return self._group_tracking.step(time_ns, states, agent, labels, weights)

    def reset(self) -> None:
        self._group_tracking.reset()
