"""The stages of a command centre: clustering, fusion and group tracking."""

from __future__ import annotations

from abc import ABC, abstractmethod

from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.tracking.innovations import Innovations


class Clusterer(ABC):
    """Groups the tracks of different agents by object."""

    @abstractmethod
    def cluster(self, states: ObjectStates, agent: Ints) -> Ints:
        """(n,) int64: the cluster of each track, 0 to c-1.

        states: n tracks in the world frame at one time; agent: (n,) int64, which agent each track came from

        (agent, id) must be unique. A cluster has at most one member of an agent. The order of the rows does not
        matter: clusters are numbered in the order of their least member by (agent, id).
        """


class Fusion(ABC):
    """Fuses the members of each cluster into one state."""

    @abstractmethod
    def fuse(self, states: ObjectStates, labels: Ints, weights: Floats | None = None) -> ObjectStates:
        """One row per cluster, in the order of the labels 0 to c-1; ids are the labels.

        states: n tracks, world frame, one time; labels: (n,) int64
        weights: (n,) >= 0, how far each member is trusted; 0 excludes it; a cluster without members is left
        out of the result. None: all equal.
        """


class GroupTracker(ABC):
    """Turns clusters of tracks into the picture: objects with persistent ids."""

    @property
    def innovations(self) -> Innovations | None:
        """How far clusters were from what was expected, see `Tracker`; None: it does not tell."""
        return None

    @abstractmethod
    def step(
        self, time_ns: int, states: ObjectStates, agent: Ints, labels: Ints, weights: Floats | None = None
    ) -> tuple[ObjectStates, Ints]:
        """The picture and the support of its objects at `time_ns`.

        The picture is sorted by id; support (n,) is the number of agents with a track in each object's cluster.
        """

    @property
    def clusters(self) -> Ints:
        """(n,) int64: the cluster behind each object of the last picture; -1: none.

        Integrity stages need it to withhold objects from the picture. Raises NotImplementedError by default.
        """
        raise NotImplementedError(f"{type(self).__name__} does not define `clusters`, which integrity stages need")

    @abstractmethod
    def reset(self) -> None:
        """Return to the initial state."""
