"""Overlap and matching of boxes by plain loops, and random batches: what vectorised code is tested against."""

from collections.abc import Sequence
from itertools import permutations
from math import cos, hypot, pi, sin

import numpy as np
from hypothesis import strategies as st
from integrity_batches import STEP_NS

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.integrity import Batch, SweptView
from mast_zenoh.integrity.base import ClusterBoxes
from mast_zenoh.tracking.view import SensorView

Point = tuple[float, float]
#: x, y, z in m, length, width, height in m, yaw in rad
Box = tuple[float, float, float, float, float, float, float]


def outline(box: Box) -> list[Point]:
    """The corners of a box seen from above, counter-clockwise."""
    x, y, _, length, width, _, yaw = box
    signs = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    return [
        (
            x + 0.5 * (a * length * cos(yaw) - b * width * sin(yaw)),
            y + 0.5 * (a * length * sin(yaw) + b * width * cos(yaw)),
        )
        for a, b in signs
    ]


def area(polygon: Sequence[Point]) -> float:
    """Area of a polygon by the shoelace formula."""
    after = [*polygon[1:], *polygon[:1]]
    return abs(sum(ax * by - bx * ay for (ax, ay), (bx, by) in zip(polygon, after, strict=True))) / 2.0


def clipped(polygon: Sequence[Point], by: Sequence[Point]) -> list[Point]:
    """The part of a polygon that is in a convex one, counter-clockwise (Sutherland and Hodgman)."""
    result = list(polygon)
    for (ax, ay), (bx, by_) in zip(by, [*by[1:], *by[:1]], strict=True):

        def side(p: Point, ax: float = ax, ay: float = ay, bx: float = bx, by_: float = by_) -> float:
            return (bx - ax) * (p[1] - ay) - (by_ - ay) * (p[0] - ax)

        before, result = result, []
        for p, q in zip([*before[-1:], *before[:-1]], before, strict=True):
            sp, sq = side(p), side(q)
            if (sp < 0.0) != (sq < 0.0):
                t = sp / (sp - sq)
                result.append((p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])))
            if sq >= 0.0:
                result.append(q)
    return result


def intersection(one: Box, other: Box) -> float:
    """m² that two boxes share, seen from above."""
    return area(clipped(outline(one), outline(other)) or [(0.0, 0.0)])


def iou(one: Box, other: Box) -> float:
    """Intersection over union, seen from above."""
    common = intersection(one, other)
    return common / (one[3] * one[4] + other[3] * other[4] - common)


def jaccard(one: Sequence[Box], other: Sequence[Box], least_iou: float) -> float:
    """Jaccard index of two sets of boxes: all matchings are tried, so that neither set may be large."""
    if not one or not other:
        return 0.0
    few, many = sorted((one, other), key=len)
    table = [[iou(a, b) for b in many] for a in few]
    best = max(permutations(range(len(many)), len(few)), key=lambda to: sum(table[i][j] for i, j in enumerate(to)))
    matched = sum(table[i][j] >= least_iou for i, j in enumerate(best))
    return matched / (len(one) + len(other) - matched)


def boxes_of(rows: Sequence[Box]) -> ClusterBoxes:
    """The same boxes as arrays, standing still."""
    table = np.array(rows, np.float64).reshape(-1, 7)
    return ClusterBoxes(table[:, :3], np.zeros((len(table), 3)), table[:, 3:6], table[:, 6])


def median_box(batch: Batch, cluster: int, agents: Sequence[int]) -> Box | None:
    """The median of some agents' tracks of an object; None without one."""
    rows = [row for row in range(len(batch.labels)) if batch.labels[row] == cluster and batch.agent[row] in agents]
    if not rows:
        return None
    states = batch.states
    place, size = np.median(states.position[rows], axis=0), np.median(states.size[rows], axis=0)
    double = [2.0 * float(states.yaw[row]) for row in rows]
    yaw = 0.5 * np.arctan2(sum(map(sin, double)), sum(map(cos, double)))
    return (*place.tolist(), *size.tolist(), float(yaw))


def perception(batch: Batch, agents: Sequence[int]) -> list[Box]:
    """What some agents perceive together."""
    found = (median_box(batch, cluster, agents) for cluster in range(batch.clusters))
    return [box for box in found if box is not None]


#: Boxes of vehicles in a small place, so that many overlap.
boxes = st.builds(
    lambda x, y, z, length, width, height, yaw: (x, y, z, length, width, height, yaw),
    *(st.floats(-6.0, 6.0), st.floats(-6.0, 6.0), st.floats(0.0, 1.5)),
    *(st.floats(0.5, 6.0), st.floats(0.5, 2.5), st.floats(0.5, 2.0)),
    st.floats(-pi, pi),
)


def random_batch(seed: int, agents: int, objects: int, *, frame: int = 0, viewed: bool = True) -> Batch:
    """Tracks of some objects, each reported by some of the agents, a few decimetres apart, and their views."""
    random = np.random.default_rng([seed, frame])
    fixed = np.random.default_rng(seed)  # the same in all frames
    place = fixed.uniform(-25.0, 25.0, (objects, 2))
    velocity = fixed.uniform(-8.0, 8.0, (objects, 2))
    size = fixed.uniform((0.5, 0.5, 0.8), (5.0, 2.0, 2.0), (objects, 3))
    yaw = fixed.uniform(-np.pi, np.pi, objects)
    reports = fixed.random((objects, agents)) < 0.6
    cluster, agent = reports.nonzero()
    n = len(cluster)
    position = np.column_stack([place[cluster] + velocity[cluster] * frame * STEP_NS * 1e-9, 0.5 * size[cluster, 2]])
    position[:, :2] += random.normal(0.0, 0.4, (n, 2))
    labels = np.unique(cluster, return_inverse=True)[1].astype(np.int64)
    states = ObjectStates.of(
        position,
        id=labels,
        velocity=np.column_stack([velocity[cluster], np.zeros(n)]),
        size=size[cluster] * random.uniform(0.9, 1.1, (n, 3)),
        yaw=yaw[cluster] + random.normal(0.0, 0.1, n),
        covariance=np.tile(np.eye(9) * 0.05, (n, 1, 1)),
        score=random.uniform(0.2, 1.0, n),
    )
    names = tuple(f"agent_{row}" for row in range(agents))
    views: list[SweptView | None] = [random_view(seed + row, fixed.uniform(-30.0, 30.0, 2)) for row in range(agents)]
    return Batch(
        frame * STEP_NS, states, agent.astype(np.int64), labels, names, tuple(views) if viewed else (None,) * agents
    )


def random_view(seed: int, place: np.ndarray) -> SweptView:
    """A sensor that is turned at random, with random free distances, and a range of 60 m."""
    random = np.random.default_rng(seed)
    turn = random.uniform(-np.pi, np.pi)
    rotation = np.array([[cos(turn), -sin(turn), 0.0], [sin(turn), cos(turn), 0.0], [0.0, 0.0, 1.0]])
    free = np.where(random.random((6, 90)) < 0.5, 60.0, random.uniform(3.0, 60.0, (6, 90)))
    return SweptView(SensorView(np.array([*place, 2.0]), rotation, -2.5, 2.5, -0.8, 0.3, 60.0), free)


def in_square(box: Box, view: SweptView | None, half_m: float) -> bool:
    """Whether the centre of a box is in a square around a sensor that is turned about the vertical axis."""
    if view is None:
        return True
    (x, y, _), (c, s) = view.view.position, view.view.rotation[:2, 0]
    dx, dy = box[0] - x, box[1] - y
    return abs(c * dx + s * dy) <= half_m and abs(c * dy - s * dx) <= half_m


def apart(one: Box, other: Box) -> float:
    """m between two centres on the ground."""
    return hypot(one[0] - other[0], one[1] - other[1])
