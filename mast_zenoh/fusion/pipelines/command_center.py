"""The command centre's pipeline, from the tracks of all agents to the picture.

The base of nodes that fuse the tracks of many agents: command centre, regional centre and peer.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.fusion.base import Clusterer, GroupTracker
from mast_zenoh.fusion.clustering import believed_first, without_contradicted
from mast_zenoh.fusion.covariance_check import CheckedCovariances, CovarianceCheck
from mast_zenoh.integrity import Assessment, Batch, Integrity, SweptView, trust_columns
from mast_zenoh.integrity.base import SUSPENDED, problem_of
from mast_zenoh.integrity.views import check_view
from mast_zenoh.messages.schemas import Body, text
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.tracking.base import Innovations
from mast_zenoh.tracking.kalman import make_positive_definite


class Pipeline(ABC):
    """Turns the tracks of all agents into the picture."""

    #: columns of the last step's `trust` message; None: the pipeline judges nobody
    trust: Mapping[str, Any] | None = None

    @property
    def innovations(self) -> Innovations | None:
        """How far clusters were from what was expected, see `Tracker`; None: it does not tell."""
        return None

    @property
    def members(self) -> Ints:
        """(n,) int64, for each track of the last step the row of its object in the picture; -1: none.

        Peers that relay objects need it. Raises NotImplementedError by default.
        """
        raise NotImplementedError(f"{type(self).__name__} does not define `members`, which relays need")

    def bind(self, seed: int, name: str) -> None:  # noqa: B027 (a hook: most pipelines draw no random numbers)
        """Set the run's seed and the name of the node, which select random streams; called before the first step."""

    def facts(self) -> dict[str, Any]:
        """What the pipeline counted, for the results of its node; empty by default."""
        return {}

    def results(self) -> dict[str, Any]:
        """What it counted, and how far clusters were from what was expected, if they tell; of its node."""
        innovations = self.innovations
        return self.facts() | ({} if innovations is None else {"innovations": innovations.summary()})

    def look(self, views: Mapping[str, SweptView]) -> None:  # noqa: B027 (a hook: most pipelines need no views)
        """Set what the agents' sensors cover, by agent, for the next step.

        Called only where agents send views (keyexpr_maps/views.toml).
        """

    def hear(self, listener: str, trusts: Mapping[str, Mapping[str, float]]) -> None:  # noqa: B027 (a hook)
        """Set what other agents say about whom they trust, for the next step; see `Integrity.hear`."""

    @abstractmethod
    def step(
        self, time_ns: int, states: ObjectStates, agent: Ints, agents: tuple[str, ...], weights: Floats | None = None
    ) -> tuple[ObjectStates, Ints]:
        """The picture and the support of its objects at `time_ns`.

        The picture is sorted by id; support (n,) is the number of reporters with a track in each object's
        cluster: an agent counts once for each of its wires that are fused.

        states: n tracks of all agents, world frame, at `time_ns`
        agent: (n,) int64, rows of `agents`, the agents' names
        weights: (n,), see `Fusion.fuse`

        The result does not depend on the order of the rows or of the agents.
        """

    @abstractmethod
    def reset(self) -> None:
        """Return to the initial state."""


@dataclass(kw_only=True, eq=False)
class CommandCenterPipeline(Pipeline):
    """Clustering, then integrity, then fusion and tracking of the clusters.

    clustering: groups tracks by object; group_tracking: turns clusters into the picture
    integrity: judges agents and objects; None: nobody is judged, and no trust is published
    covariances: how far the covariances of tracks are believed; None: CheckedCovariances()

    An object that is withheld is tracked on, so that it is in the picture as soon as it is trusted.
    """

    clustering: Clusterer
    group_tracking: GroupTracker
    integrity: Integrity | None = None
    covariances: CovarianceCheck | None = None

    def __post_init__(self) -> None:
        self._covariances = self.covariances or CheckedCovariances()
        self._views: Mapping[str, SweptView] = {}
        self._withheld: dict[int, bool] = {}  # by id of the object
        self._suspended: set[str] = set()  # agents that cannot divide the objects of others
        self._members = np.zeros(0, np.int64), np.zeros(0, np.int64)  # label of each track; cluster of each object

    @property
    def members(self) -> Ints:
        labels, clusters = self._members
        row = np.full(int(max(labels.max(initial=-1), clusters.max(initial=-1))) + 1, -1, np.int64)
        row[clusters[clusters >= 0]] = np.flatnonzero(clusters >= 0)
        return row[labels]

    @property
    def innovations(self) -> Innovations | None:
        return self.group_tracking.innovations

    def bind(self, seed: int, name: str) -> None:
        if self.integrity is not None:
            self.integrity.bind(seed, name)

    def facts(self) -> dict[str, Any]:
        counted = {} if self.integrity is None else self.integrity.facts()
        return {"integrity": counted} if counted else {}

    def look(self, views: Mapping[str, SweptView]) -> None:
        self._views = views

    def hear(self, listener: str, trusts: Mapping[str, Mapping[str, float]]) -> None:
        if self.integrity is not None:
            self.integrity.hear(listener, trusts)

    def step(
        self, time_ns: int, states: ObjectStates, agent: Ints, agents: tuple[str, ...], weights: Floats | None = None
    ) -> tuple[ObjectStates, Ints]:
        # Sorted by name, because the order of `agents` depends on the arrival of their messages.
        names = tuple(sorted(agents))
        rank = {name: row for row, name in enumerate(names)}
        agent = np.array([rank[name] for name in agents], np.int64)[agent]
        states = self._covariances.floored(states)
        if self.integrity is None:
            labels = self.clustering.cluster(states, agent)
            return self._fused(time_ns, states, agent, names, labels, weights)
        states = states.with_(covariance=make_positive_definite(states.covariance))  # a stage may invert them
        states, corrected_views = self.integrity.correct(time_ns, states, agent, names, self._views)
        self._views = {}
        believed = np.array([name not in self._suspended for name in names], np.bool_)[agent]
        labels = believed_first(self.clustering, states, agent, believed)
        views = tuple(corrected_views.get(name) for name in names)
        batch = Batch(time_ns, states, agent, labels, names, views)
        assessment = self.integrity.assess(batch)
        if problem := problem_of(assessment, len(states), len(names), batch.clusters):
            raise ValueError(f"{type(self.integrity).__name__}.assess: {problem}")
        states_of = zip(names, assessment.agents.state.tolist(), strict=True)
        self._suspended = {name for name, state in states_of if state == SUSPENDED}
        weights = combined(weights, assessment.weights)
        picture, support = self._fused(time_ns, states, agent, names, labels, weights)
        return self._published(picture, support, names, assessment)

    def _fused(
        self,
        time_ns: int,
        states: ObjectStates,
        agent: Ints,
        names: tuple[str, ...],
        labels: Ints,
        weights: Floats | None,
    ) -> tuple[ObjectStates, Ints]:
        """The picture of clusters, without those that others contradict."""
        weights = without_contradicted(states, agent, labels, weights)
        states = self._covariances.inflated(time_ns, states, agent, names, labels, weights)
        self.group_tracking.name_agents(names)
        picture, support = self.group_tracking.step(time_ns, states, agent, labels, weights)
        self._members = labels, self.group_tracking.clusters
        return picture, support

    def _published(
        self, picture: ObjectStates, support: Ints, names: tuple[str, ...], assessment: Assessment
    ) -> tuple[ObjectStates, Ints]:
        """The objects that are not withheld; updates `trust`."""
        clusters = self.group_tracking.clusters
        before = np.array([self._withheld.get(id_, False) for id_ in picture.id.tolist()], np.bool_)
        withheld = before.copy()
        matched = clusters >= 0
        withheld[matched] = assessment.objects.withheld[clusters[matched]]
        self._withheld = dict(zip(picture.id.tolist(), withheld.tolist(), strict=True))
        self.trust = {
            "agents": names,
            "reason": assessment.agents.reason,
            **trust_columns(assessment.agents, picture, clusters, assessment.objects, withheld),
        }
        if not withheld.any():
            return picture, support
        self._members = self._members[0], clusters[~withheld]
        return picture.select(~withheld), support[~withheld]

    def reset(self) -> None:
        self.group_tracking.reset()
        self._covariances.reset()
        self._withheld = {}
        self._suspended = set()
        self._members = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self._views = {}
        self.trust = None
        if self.integrity is not None:
            self.integrity.reset()


def combined(one: Floats | None, other: Floats | None) -> Floats | None:
    """Products (n,) of weights; None stands for ones."""
    if one is None or other is None:
        return other if one is None else one
    return one * other


def is_view(received: Received, context: Context) -> bool:
    """Whether a message describes a field of view; rejects any other."""
    try:
        check_view(received.body)
    except ValueError as error:
        context.reject(f"implausible: view: {error}")
        return False
    return True


class FusingNode(Node):
    """Publishes the pictures of a pipeline, which never goes back in time, and its trust in agents and objects."""

    fuses = ("picture", "trust")
    pipeline: Pipeline
    newest_ns = 0  # time of the pipeline's last step

    def start(self, context: Context) -> None:
        """Give the pipeline its random streams."""
        self.pipeline.bind(context.seed, context.name)

    def advances(self, time_ns: int, context: Context, subject: str, least: str = "{}") -> bool:
        """Whether a time is not before that of the last step, and is from now on; rejects an older message.

        subject: what has the time; least: what is expected, with a place for the last step's time
        """
        if time_ns < self.newest_ns:
            context.reject(f"old: {subject}: time_ns is {time_ns}, expected {least.format(self.newest_ns)}")
            return False
        self.newest_ns = time_ns
        return True

    def publish_trust(self, frame: int, time_ns: int, context: Context) -> Body | None:
        """Publish the trust of the pipeline's last step; returns it. None: the pipeline judges nobody."""
        trust = self.pipeline.trust
        if trust is None:
            return None
        body = {**trust, **{name: text(list(trust[name])) for name in ("agents", "reason")}}
        context.publish("trust", body, frame=frame, time_ns=time_ns)
        return body

    def finish(self, context: Context) -> dict[str, Any]:
        """What the pipeline counted, and how far tracks were from what its tracker expected, if they tell."""
        return self.pipeline.results()
