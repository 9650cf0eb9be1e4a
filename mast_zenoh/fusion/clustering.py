"""Clusterers of the command centre, which group tracks by object.

Rows are first sorted by (agent, id), so the result does not depend on the order in which they arrive.
"""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.clustering import isolated_groups, merge_pairs_apart, pairs_near
from mast_zenoh.arrays.ordering import by_agent
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.fusion.base import Clusterer
from mast_zenoh.fusion.joint_gate import BIAS_M, BIAS_MPS, SAME_ORIGIN_GATE, JointGate, motion_of


class SampledAssignmentClusterer(Clusterer):
    """Clusters tracks within a radius, nearest pairs first.

    assign_radius: m, in the bird's-eye view, maximum distance between the centres of two clusters to be merged

    gate, bias_m, bias_mps: see `JointGate`

    Pairs of tracks are merged by distance, unless both clusters have a track of the same agent, their centres are too
    far apart, or two tracks within the radius differ too much in position, height and velocity to be of one object.
    Where tracks near each other do so, the likeliest pair is merged first, not the nearest. The original takes tracks
    in the order of arrival, so its result depends on that order, and two tracks of one agent may merge.
    """

    def __init__(
        self,
        *,
        assign_radius: float = 2.0,
        gate: float = SAME_ORIGIN_GATE,
        bias_m: float = BIAS_M,
        bias_mps: float = BIAS_MPS,
    ) -> None:
        if not assign_radius > 0.0:
            raise ValueError(f"assign_radius: found {assign_radius}, expected more than 0")
        self._radius = assign_radius
        self._gate = JointGate(gate, bias_m, bias_mps)

    def cluster(self, states: ObjectStates, agent: Ints) -> Ints:
        order = by_agent(states, agent)
        motion, agent = motion_of(states).take(order, 0), agent.take(order)
        root, isolated = isolated_groups(motion, agent, self._gate.inverse_bias, self._radius, self._gate.gate)
        # All other tracks are far from those of isolated groups, so they are clustered as if they were alone.
        contested = (~isolated).nonzero()[0]
        if len(contested):
            label = self._merged(states, order.take(contested), motion.take(contested, 0)[:, :2], agent.take(contested))
            root[contested] = contested[np.unique(label, return_index=True)[1]].take(label)
        labels = np.empty(len(order), np.int64)
        labels[order] = ((root == np.arange(len(order))).cumsum() - 1).take(root)
        return labels

    def _merged(self, states: ObjectStates, rows: Ints, position: Floats, agent: Ints) -> Ints:
        """(k,) clusters of the tracks in `rows` (k,), by their pairs; position (k, 2), agent (k,): theirs."""
        pairs = pairs_near(position, self._radius)
        pairs = pairs.select((agent.take(pairs.i) != agent.take(pairs.j)).nonzero()[0])
        i, j = rows.take(pairs.i), rows.take(pairs.j)

        def cost(chosen: Ints) -> Floats:
            return self._gate.cost(states, i.take(chosen), j.take(chosen))

        return merge_pairs_apart(position, agent, pairs, self._radius, self._gate.apart(states, i, j), cost)


class DBSCANClusterer(Clusterer):
    """Density-based clusters, with at most one track of each agent.

    Ester, Kriegel, Sander, Xu: DBSCAN, KDD 1996.

    eps: m, in the bird's-eye view, within which tracks are neighbours
    min_samples: number of tracks within `eps` of a track, including itself, that make it a core of a cluster
    gate, bias_m, bias_mps: see `JointGate`

    Tracks of different agents are neighbours only if they can be of one object by position, height and velocity, and
    only then share a cluster. Neighbouring cores share a cluster, other tracks join their nearest core, and a track
    without one is its own cluster. Where two tracks of one agent would share a cluster, the nearest are merged first,
    as in `SampledAssignmentClusterer`.
    """

    def __init__(
        self,
        *,
        eps: float = 2.0,
        min_samples: int = 2,
        gate: float = SAME_ORIGIN_GATE,
        bias_m: float = BIAS_M,
        bias_mps: float = BIAS_MPS,
    ) -> None:
        if not eps > 0.0 or min_samples < 1:
            raise ValueError(f"eps, min_samples: found {eps}, {min_samples}, expected more than 0, and 1 or more")
        self._eps = eps
        self._min_samples = min_samples
        self._gate = JointGate(gate, bias_m, bias_mps)

    def cluster(self, states: ObjectStates, agent: Ints) -> Ints:
        order = by_agent(states, agent)
        position, agent = states.position.take(order, 0)[:, :2], agent.take(order)
        pairs = pairs_near(position, self._eps)
        apart = agent.take(pairs.i) != agent.take(pairs.j)
        apart &= self._gate.apart(states, order.take(pairs.i), order.take(pairs.j))
        near = (~apart).nonzero()[0]
        i, j, distance = pairs.select(near)
        core = 1 + np.bincount(i, minlength=len(order)) + np.bincount(j, minlength=len(order)) >= self._min_samples
        linked = core[i] & core[j]
        linked[_to_nearest_core(i, j, distance, core)] = True
        considered = apart.copy()
        considered[near[linked]] = True
        kept = considered.nonzero()[0]
        pairs = pairs.select(kept)

        def cost(chosen: Ints) -> Floats:
            return self._gate.cost(states, order.take(pairs.i.take(chosen)), order.take(pairs.j.take(chosen)))

        labels = np.empty(len(order), np.int64)
        labels[order] = merge_pairs_apart(position, agent, pairs, np.inf, apart[kept], cost)
        return labels


def _to_nearest_core(i: Ints, j: Ints, distance: Floats, core: Bools) -> Ints:
    """Pairs that join each border track to its nearest core, the first in a tie."""
    pair = np.concatenate([(core[j] & ~core[i]).nonzero()[0], (core[i] & ~core[j]).nonzero()[0]])
    border = np.where(core[i], j, i)[pair]
    by_distance = np.lexsort((np.where(core[i], i, j)[pair], distance[pair], border))
    _, first = np.unique(border[by_distance], return_index=True)
    return np.asarray(pair[by_distance][first])
