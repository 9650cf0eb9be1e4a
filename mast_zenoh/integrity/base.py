"""Base class of integrity stages: judge the agents' tracks between clustering and group tracking."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.kernels import kernel

#: What the command centre thinks of an agent; trust messages contain indices into this tuple.
STATES = ("unknown", "trusted", "faulty", "suspended", "undecided")
UNKNOWN, TRUSTED, FAULTY, SUSPENDED, UNDECIDED = range(5)


@dataclass(frozen=True, eq=False)
class Batch:
    """The tracks of all agents at one time, clustered: `n` tracks of `a` agents in `c` clusters.

    time_ns: ns, of all tracks
    states: n tracks, world frame
    agent:  (n,) int64, rows of `agents`
    labels: (n,) int64, cluster of each track, 0 to c-1
    agents: names of a agents, sorted
    views:  (a) what each agent's sensor covers; None: unknown
    """

    time_ns: int
    states: ObjectStates
    agent: Ints
    labels: Ints
    agents: tuple[str, ...]
    views: tuple[SweptView | None, ...]

    @cached_property
    def clusters(self) -> int:
        """Number of clusters, c."""
        return int(self.labels.max()) + 1 if len(self.labels) else 0

    @cached_property
    def member(self) -> Ints:
        """(c, a) row of the track that each agent has in each cluster; -1: none."""
        member = np.full((self.clusters, len(self.agents)), -1, np.int64)
        member[self.labels, self.agent] = np.arange(len(self.labels))
        return member

    @cached_property
    def reported(self) -> Bools:
        """(c, a) whether the agent reports the object."""
        return np.asarray(self.member >= 0)

    def weights(self, believed: Bools) -> Floats:
        """(n,) 1 for tracks that are believed, else 0.

        believed: (c, a) which agents' tracks of each cluster. A cluster without any keeps all members, or it could
        not be tracked on.
        """
        kept = believed | ~believed.any(axis=1, keepdims=True)
        return kept[self.labels, self.agent].astype(np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class AgentTrust:
    """Trust of a stage in `a` agents.

    mean: (a,) 0 to 1; log_odds: (a,) that the agent is honest
    state: (a,) uint8, index into STATES; reason: (a) of the state, "" if there is none
    offset: (a, 2) m, turn: (a,) rad, delay: (a,) s, loss: (a,) 0 to 1: estimated fault, see `FaultOrLie`
    """

    mean: Floats
    log_odds: Floats
    state: NDArray[np.uint8]
    reason: tuple[str, ...]
    offset: Floats
    turn: Floats
    delay: Floats
    loss: Floats

    @classmethod
    def of(
        cls,
        mean: Floats,
        state: NDArray[np.uint8] | None = None,
        reason: tuple[str, ...] | None = None,
        **other: Floats,
    ) -> AgentTrust:
        """Trust with a mean (a,) and no estimated fault; the log-odds default to those of the mean."""
        a = len(mean)
        clipped = np.clip(mean, 1e-12, 1.0 - 1e-12)
        defaults: dict[str, Floats] = {
            "log_odds": np.log(clipped / (1.0 - clipped)),
            "offset": np.zeros((a, 2)),
            "turn": np.zeros(a),
            "delay": np.zeros(a),
            "loss": np.zeros(a),
        }
        return cls(
            mean=mean,
            state=np.full(a, UNKNOWN, np.uint8) if state is None else state,
            reason=("",) * a if reason is None else reason,
            **defaults | other,
        )


@dataclass(frozen=True, slots=True, eq=False)
class ObjectTrust:
    """Trust of a stage in `c` clusters.

    trust: (c,) 0 to 1
    expected, confirming, contradicting: (c,) int64, agents that should see the object, report it, and see through it
    withheld: (c,) whether it stays out of the picture
    """

    trust: Floats
    expected: Ints
    confirming: Ints
    contradicting: Ints
    withheld: Bools

    @classmethod
    def of(cls, expected: Ints, confirming: Ints, contradicting: Ints, withheld: Bools) -> ObjectTrust:
        """Trust by how many of the agents that say something confirm the object; 0.5 if none does."""
        trust = (1.0 + confirming) / (2.0 + confirming + contradicting)
        return cls(trust, expected, confirming, contradicting, withheld)


@dataclass(frozen=True, slots=True, eq=False)
class Assessment:
    """The result of a stage.

    weights: (n,) >= 0, how far each track is trusted, see `Fusion.fuse`; None: all equal
    """

    weights: Floats | None
    agents: AgentTrust
    objects: ObjectTrust


class Integrity(ABC):
    """Judges agents and objects of each batch. Random numbers come from the named streams of `mast_zenoh.streams`.

    needs_views: whether it judges by what agents' sensors cover; a run in which it gets no views has a notice
    """

    needs_views: ClassVar[bool] = True

    def bind(self, seed: int, name: str) -> None:  # noqa: B027 (a hook: most stages draw no random numbers)
        """Set the run's seed and the name of the node, which select the random streams; called before the first batch.

        `reset` does not change them.
        """

    def facts(self) -> dict[str, Any]:
        """What the stage counted since it was made or reset, for the results of its node; empty by default."""
        return {}

    def correct(
        self, time_ns: int, states: ObjectStates, agent: Ints, agents: tuple[str, ...], views: Mapping[str, SweptView]
    ) -> tuple[ObjectStates, Mapping[str, SweptView]]:
        """Return tracks and views with known faults removed; unchanged by default.

        Called before clustering, once for each batch.

        states: n tracks of all agents, world frame; agent: (n,) rows of `agents`; views: by agent
        """
        return states, views

    def excuse(self, agent: str) -> None:  # noqa: B027 (a hook)
        """Forget evidence that a newly found fault of an agent explains; the fault is corrected from now on.

        Must not release an agent that was suspended earlier for another reason.
        """

    def await_faults(self, agents: frozenset[str]) -> None:  # noqa: B027 (a hook)
        """Note the agents whose tracks differ from others' by what may be a fault; called before each `assess`.

        A stage should not act on them at once: when the fault is found, it excuses them.
        """

    def hear(self, listener: str, trusts: Mapping[str, Mapping[str, float]]) -> None:  # noqa: B027 (a hook)
        """Set what other agents say about whom they trust, for the next batch.

        listener: the agent whose receiver this is; trusts: by teller, their trust in agents, 0 to 1

        Called only where agents tell it to each other (keyexpr_maps/gossip.toml).
        """

    @abstractmethod
    def assess(self, batch: Batch) -> Assessment:
        """Assess the agents and clusters of a batch; called once for each, in order of time.

        The result does not depend on the order of the rows.
        """

    @abstractmethod
    def reset(self) -> None:
        """Return to the initial state."""


class NoIntegrity(Integrity):
    """Trusts all agents."""

    needs_views = False

    def assess(self, batch: Batch) -> Assessment:
        confirming = batch.reported.sum(axis=1)
        none = np.zeros(batch.clusters, np.int64)
        everything = ObjectTrust(
            np.ones(batch.clusters), confirming, confirming, none, np.zeros(batch.clusters, np.bool_)
        )
        return Assessment(None, AgentTrust.of(np.ones(len(batch.agents))), everything)

    def reset(self) -> None:
        pass


def trust_columns(
    trust: AgentTrust,
    objects: ObjectStates,
    cluster: Ints,
    of_clusters: ObjectTrust,
    withheld: Bools,
) -> dict[str, Any]:
    """The columns of a `trust` message, except the text.

    objects: n tracked objects; cluster: (n,) of each, -1: none in this batch; withheld: (n,)
    """
    seen = cluster >= 0

    def of_objects(values: NDArray[Any]) -> NDArray[Any]:
        column = np.zeros(len(objects), values.dtype)
        column[seen] = values[cluster[seen]]
        return column

    return {
        "mean": trust.mean,
        "log_odds": trust.log_odds,
        "state": trust.state,
        "fault_offset": trust.offset,
        "fault_turn": trust.turn,
        "fault_delay": trust.delay,
        "fault_loss": trust.loss,
        "id": objects.id,
        "position": objects.position,
        "size": objects.size,
        "yaw": objects.yaw,
        "trust": of_objects(of_clusters.trust),
        "expected": of_objects(of_clusters.expected),
        "confirming": of_objects(of_clusters.confirming),
        "contradicting": of_objects(of_clusters.contradicting),
        "withheld": withheld.astype(np.uint8),
    }


#: m², side of a car that a sensor sees least of: width times height.
_CAR_M2 = 1.8 * 1.5


@dataclass(frozen=True, slots=True, eq=False)
class ClusterBoxes:
    """Median boxes of `c` clusters (circular mean of the axes), world frame.

    position: (c, 3) m, velocity: (c, 3) m/s, size: (c, 3) m, yaw: (c,) rad, of the length axis, in either direction

    A member shifts the mean of two by half its error, which the clusterer's radius limits.
    """

    position: Floats
    velocity: Floats
    size: Floats
    yaw: Floats

    @classmethod
    def of(cls, batch: Batch, use: Bools | None = None) -> ClusterBoxes:
        """The median boxes of the clusters of a batch.

        use: (c, a) which agents' tracks count; None: all. A cluster without any uses all its members.
        """
        states = batch.states
        present: Bools = batch.reported
        if use is not None:
            used = present & use
            present = np.asarray(np.where(used.any(axis=1, keepdims=True), used, present), np.bool_)
        return cls(*median_boxes(states.position, states.velocity, states.size, states.yaw, batch.member, present))

    def select(self, rows: Bools | Ints) -> ClusterBoxes:
        """The boxes of a mask (c,) or of rows (k,)."""
        return ClusterBoxes(self.position[rows], self.velocity[rows], self.size[rows], self.yaw[rows])

    def moved(self, elapsed_s: float) -> ClusterBoxes:
        """The boxes where their velocities take them in `elapsed_s` s."""
        return ClusterBoxes(self.position + self.velocity * elapsed_s, self.velocity, self.size, self.yaw)

    def cover(self, points: Floats) -> Bools:
        """(n, c) which points (n, 2) m are on which boxes, seen from above."""
        dx, dy = (points[:, None] - self.position[:, :2]).transpose(2, 0, 1)
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        along, across = np.abs(dx * cos + dy * sin), np.abs(dy * cos - dx * sin)
        return np.asarray((along <= 0.5 * self.size[:, 0]) & (across <= 0.5 * self.size[:, 1]))

    def sight_range(self, range_m: float) -> Floats:
        """(c,) m up to which a box gives a lidar as many returns as a car does at `range_m`, at most `range_m`.

        The number of returns goes with the area of the smaller side over the squared distance.
        """
        area = np.minimum(self.size[:, 0], self.size[:, 1]) * self.size[:, 2]
        return np.asarray(range_m * np.sqrt(np.clip(area / _CAR_M2, 0.0, 1.0)))


@kernel
def median_boxes(
    position: Floats, velocity: Floats, size: Floats, yaw: Floats, member: Ints, present: Bools
) -> tuple[Floats, Floats, Floats, Floats]:
    """Medians of the positions, velocities and sizes (c, 3) of the members of c clusters, and their mean yaws (c,).

    member: (c, a) rows of n tracks; present: (c, a) which count, at least one in each cluster
    """
    count = present.sum(axis=1)
    # Summed by agent, so that rounding does not depend on the order of the rows.
    double = np.where(present[..., None], np.stack([np.cos(2.0 * yaw), np.sin(2.0 * yaw)], axis=-1)[member], 0.0)
    east, north = (double.sum(axis=1) / count[:, None]).T
    values = np.concatenate([position, velocity, size], axis=1)
    ordered = np.sort(np.where(present[..., None], values[member], np.inf), axis=1)
    low, high = ((count - 1) // 2)[:, None, None], (count // 2)[:, None, None]
    middle = 0.5 * (np.take_along_axis(ordered, low, axis=1) + np.take_along_axis(ordered, high, axis=1))[:, 0]
    return middle[:, :3].copy(), middle[:, 3:6].copy(), middle[:, 6:].copy(), 0.5 * np.arctan2(north, east)


_AGENTS = {"mean": (), "log_odds": (), "state": (), "offset": (2,), "turn": (), "delay": (), "loss": ()}
_COUNTS = ("expected", "confirming", "contradicting")


def problem_of(assessment: Assessment, n: int, a: int, c: int) -> str:
    """What is wrong with an assessment of n tracks of a agents in c clusters; "" if nothing is."""
    weights, agents, objects = assessment.weights, assessment.agents, assessment.objects
    columns = {
        **{f"agents.{name}": (getattr(agents, name), (a, *more)) for name, more in _AGENTS.items()},
        **{f"objects.{name}": (getattr(objects, name), (c,)) for name in ("trust", *_COUNTS, "withheld")},
    }
    if weights is not None:
        columns["weights"] = weights, (n,)
    for name, (values, shape) in columns.items():
        if values.shape != shape:
            return f"{name} has the shape {values.shape}, expected {shape}"
        if values.dtype.kind == "f" and not np.isfinite(values.sum()):
            return f"{name} has numbers that are not finite"
    if weights is not None and (weights < 0.0).any():
        return "a weight is below 0"
    if len(agents.reason) != a:
        return f"found {len(agents.reason)} reasons, expected {a}"
    if (agents.state >= len(STATES)).any():
        return "a state is not an index into STATES"
    for name, values in (("agents.mean", agents.mean), ("objects.trust", objects.trust)):
        if len(values) and not 0.0 <= values.min() <= values.max() <= 1.0:
            return f"{name} is not from 0 to 1"
    for name in _COUNTS:
        counts = getattr(objects, name)
        if counts.dtype != np.int64:
            return f"objects.{name} is {counts.dtype}, expected int64"
        if len(counts) and not 0 <= counts.min() <= counts.max() <= a:
            return f"objects.{name} is not from 0 to {a}, all agents"
    if objects.withheld.dtype != np.bool_:
        return f"objects.withheld is {objects.withheld.dtype}, expected bool"
    return ""
