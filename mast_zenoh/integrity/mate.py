"""MATE: Beta-distributed trust of agents and objects, each the evidence of the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.matching import neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.base import AgentTrust, Assessment, Batch, ClusterBoxes, Integrity, ObjectTrust
from mast_zenoh.integrity.memory import AgentMemory, ObjectMemory
from mast_zenoh.integrity.visibility import sightings
from mast_zenoh.tracking.association import BipartiteAssignment

#: alpha and beta of new agents and objects, to which trust returns without evidence.
PRIOR = 0.5
#: m, within which an object that an agent does not report is the agent itself.
SELF_M = 1.0
#: m, up to which an object in view that an agent does not report is evidence, and beyond which it counts half.
RANGE_M, FULL_RANGE_M, FAR_WEIGHT = 70.0, 60.0, 0.5
#: m, up to which an object in view for more than NEAR_FRAMES frames counts in full, before by NEAR_WEIGHT. Beyond, the
#: weight rises from 0 after FAR_FRAMES frames to 1 after as many again.
NEAR_M, NEAR_FRAMES, NEAR_WEIGHT, FAR_FRAMES = 30.0, 2, 0.25, 3
#: Batches with an object before which it is no evidence against agents that do not report it.
MIN_UPDATES = 2
#: Limits of the confidence of evidence about agents.
CONFIDENCE = (0.0001, 0.9999)
#: Bias n of evidence whose value is below a threshold: agents, objects.
AGENT_BIAS, AGENT_THRESHOLD = 6.0, 0.3
TRACK_BIAS, TRACK_THRESHOLD = 1.0, 0.4

_ASSIGNMENT = BipartiteAssignment()


@dataclass(kw_only=True, eq=False)
class Mate(Integrity):
    """Trust of agents and objects by Bayesian updates, as published by MAST's authors.

    MATE (ACM CCS 2025), read in its code: cpsl-research/lib-avstack-trust, `avtrust/`, with the configuration of its
    experiments on the ground. Each batch, an agent's tracks are assigned to the objects. An assigned pair is evidence
    for the object, as much as the agent is trusted, and for or against the agent, as much as the object is. An object
    in an agent's view that it does not report is evidence against both. An object whose trust is below `keep` is
    withheld. Every constant is the original's; the module's other constants are not parameters there either.

    assign_m: m, between an agent's track and an object
    return_s: s, after which trust is back at its prior without evidence
    keep: least mean trust of an object in the picture
    independent_s: s between independent pieces of evidence; each frame's evidence is scaled by the share of this time
        that has passed. 0: every frame counts in full, as in the original, which at 10 Hz counts some nine times what
        is known, because consecutive errors correlate at 0.8

    What differs from the original: objects are this centre's clusters, followed by position; a view is what the agent
    says that it covers, less what is hidden, instead of the hull of its points.

    Weaknesses, each shown by a test: an object with one witness stays at 0.5 and is accepted; with a memory of one
    second, lying now and then costs nothing; agents are never excluded; an agent's claim near an object is evidence for
    it, whatever the claim's own history.
    """

    assign_m: float = 3.0
    return_s: float = 1.0
    keep: float = 0.4
    independent_s: float = 0.0

    def __post_init__(self) -> None:
        check("more than 0", assign_m=self.assign_m, return_s=self.return_s)
        check("0 or more", independent_s=self.independent_s)
        self.reset()

    def reset(self) -> None:
        self._objects = ObjectMemory(forget_s=self.return_s, trust=(PRIOR, PRIOR))  # alpha, beta
        self._agents = AgentMemory(forget_s=self.return_s, trust=(PRIOR, PRIOR))
        self._frames_in_view: Ints = np.zeros((0, 0), np.int64)  # of each object, for each agent, without a break
        self._last_ns: int | None = None

    def assess(self, batch: Batch) -> Assessment:
        boxes = ClusterBoxes.of(batch)
        elapsed = 0.0 if self._last_ns is None else (batch.time_ns - self._last_ns) * 1e-9
        self._last_ns = batch.time_ns
        objects, agents = self._meet(batch, boxes)
        seen = sightings(boxes.position, boxes.size, boxes.yaw, batch.views)
        frames = np.where(seen.in_view, self._frames_in_view[np.ix_(objects, agents)] + 1, 0)
        self._frames_in_view[np.ix_(objects, agents)] = frames
        assigned = self._assigned(batch, boxes)
        itself = ~assigned & (seen.distance < SELF_M)
        silent = ~assigned & ~itself & seen.in_view & (seen.distance <= RANGE_M)
        weight = silence_weight(frames, seen.distance, self._objects.of.frames[objects])
        scale = min(elapsed / self.independent_s, 1.0) if self.independent_s else 1.0

        object_trust, agent_trust = self._objects.of.trust[objects], self._agents.of.trust[agents]
        about_agents = agent_evidence(object_trust, assigned, silent, weight)
        about_objects = object_evidence(agent_trust, assigned, itself, silent, weight)
        self._objects.of.trust = forgotten(self._objects.of.trust, elapsed / self.return_s)
        self._agents.of.trust = forgotten(self._agents.of.trust, elapsed / self.return_s)
        self._agents.of.trust[agents] += scale * increments(*about_agents, AGENT_BIAS, AGENT_THRESHOLD, axis=0)
        # An object with a single piece of evidence is not updated: an agent must not confirm itself.
        several = (assigned | itself | silent).sum(axis=1) > 1
        gained = increments(*about_objects, TRACK_BIAS, TRACK_THRESHOLD, axis=1)
        self._objects.of.trust[objects] += scale * gained * several[:, None]

        trust = mean(self._objects.of.trust[objects])
        judged = ObjectTrust(
            trust,
            (assigned | itself | silent).sum(axis=1),
            (assigned | itself).sum(axis=1),
            silent.sum(axis=1),
            np.asarray(trust < self.keep),
        )
        return Assessment(None, AgentTrust.of(mean(self._agents.of.trust[agents])), judged)

    def _meet(self, batch: Batch, boxes: ClusterBoxes) -> tuple[Ints, Ints]:
        """Rows of the clusters (c,) and agents (a,); carries what is remembered of them."""
        objects = self._objects.follow(batch.time_ns, boxes.position, boxes.velocity)
        agents = self._agents.meet(batch.time_ns, batch.agents)
        self._frames_in_view = self._agents.carry(self._objects.carry(self._frames_in_view, 0), 0, axis=1)
        return objects, agents

    def _assigned(self, batch: Batch, boxes: ClusterBoxes) -> Bools:
        """(c, a) whether an agent's track is assigned to the object, each to at most one."""
        c, a = batch.reported.shape
        order = np.lexsort((batch.agent, batch.labels))
        position, agent = batch.states.position[order], batch.agent[order]
        i, j, dx, dy = neighbours(position, boxes.position, np.full(len(order), self.assign_m))
        pair = j * a + agent[i]
        chosen = _ASSIGNMENT.match(i, pair, np.hypot(dx, dy) - self.assign_m)
        assigned = np.zeros(c * a, np.bool_)
        assigned[pair[chosen]] = True
        return assigned.reshape(c, a)


def mean(trust: Floats) -> Floats:
    """(m,) means of Beta distributions (m, 2)."""
    return np.asarray(trust[:, 0] / trust.sum(axis=1))


def standard_deviation(trust: Floats) -> Floats:
    """(m,) standard deviations of Beta distributions (m, 2)."""
    total = trust.sum(axis=1)
    return np.asarray(np.sqrt(trust[:, 0] * trust[:, 1] / (total * total * (total + 1.0))))


def forgotten(trust: Floats, share: float) -> Floats:
    """Distributions (m, 2) after a share of the time in which they return to the prior."""
    share = min(max(share, 0.0), 1.0)
    return (1.0 - share) * trust + share * PRIOR


def silence_weight(frames: Ints, distance: Floats, updates: Ints) -> Floats:
    """(c, a) weights of evidence that agents do not report objects in view.

    frames: (c, a) that the object has been in view; distance: (c, a) m; updates: (c,) batches with the object
    """
    near = np.where(frames > NEAR_FRAMES, 1.0, NEAR_WEIGHT)
    far = np.clip((frames - FAR_FRAMES) / FAR_FRAMES, 0.0, 1.0)
    weight = np.where(distance < NEAR_M, near, far) * np.where(distance < FULL_RANGE_M, 1.0, FAR_WEIGHT)
    return np.asarray(weight * (updates >= MIN_UPDATES)[:, None])


def agent_evidence(objects: Floats, assigned: Bools, silent: Bools, weight: Floats) -> tuple[Floats, Floats]:
    """Values and confidences (c, a) of evidence about agents.

    objects: (c, 2) trust before the batch; assigned, silent: (c, a); weight: (c, a) of silence
    """
    value = mean(objects)[:, None]
    certain = (1.0 - 2.0 * standard_deviation(objects))[:, None]
    confidence = np.where(assigned, np.clip(certain, *CONFIDENCE), np.clip(weight * certain, *CONFIDENCE))
    return np.where(assigned, value, 1.0 - value), np.where(assigned | silent, confidence, 0.0)


def object_evidence(
    agents: Floats, assigned: Bools, itself: Bools, silent: Bools, weight: Floats
) -> tuple[Floats, Floats]:
    """Values and confidences (c, a) of evidence about objects.

    agents: (a, 2) trust before the batch; assigned, itself, silent: (c, a); weight: (c, a) of silence
    """
    trusted = mean(agents)[None, :]
    confidence = np.where(assigned, trusted, np.where(itself, 1.0, np.where(silent, weight * trusted, 0.0)))
    return (assigned | itself).astype(np.float64), confidence


def increments(value: Floats, confidence: Floats, bias: float, threshold: float, *, axis: int) -> Floats:
    """(m, 2) what evidence (c, a) adds to alpha and beta, summed along an axis."""
    n = np.where(value < threshold, bias, 1.0)
    alpha = n / (n + 1.0) * confidence * value
    beta = n * n / (n + 1.0) * confidence * (1.0 - value)
    return np.stack([alpha.sum(axis=axis), beta.sum(axis=axis)], axis=1)
