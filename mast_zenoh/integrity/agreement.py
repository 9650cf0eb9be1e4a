"""How far two sets of boxes agree: matched boxes, and their share in all of them."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.boxes import intersection_area
from mast_zenoh.arrays.matching import min_cost_matching, neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.base import ClusterBoxes


def select(boxes: ClusterBoxes, rows: Bools | Ints) -> ClusterBoxes:
    """The boxes of a mask (c,) or of rows (k,)."""
    return ClusterBoxes(boxes.position[rows], boxes.velocity[rows], boxes.size[rows], boxes.yaw[rows])


def moved(boxes: ClusterBoxes, elapsed_s: float) -> ClusterBoxes:
    """The boxes where their velocities take them in `elapsed_s` s."""
    return ClusterBoxes(boxes.position + boxes.velocity * elapsed_s, boxes.velocity, boxes.size, boxes.yaw)


def matched_boxes(one: ClusterBoxes, other: ClusterBoxes, least_iou: float) -> tuple[Ints, Ints]:
    """Rows (k,) of `one` and (k,) of `other` that are matched one to one.

    The matching with the greatest sum of intersection over union of the outlines seen from above; of it, the pairs with
    `least_iou` or more, as in ROBOSAC (ICCV 2023; `associate_2_detections` in its code).
    """
    half = 0.5 * np.hypot(one.size[:, 0], one.size[:, 1])
    reach = 0.5 * np.hypot(other.size[:, 0], other.size[:, 1]).max(initial=0.0)
    i, j, dx, dy = neighbours(one.position, other.position, half + reach)
    offset = np.column_stack([dx, dy])
    iou = outline_iou(offset, one.size[i], one.yaw[i], other.size[j], other.yaw[j])
    overlapping = iou > 0.0
    i, j, iou = i[overlapping], j[overlapping], iou[overlapping]
    chosen = min_cost_matching(i, j, -iou) & (iou >= least_iou)
    return i[chosen], j[chosen]


def outline_iou(offset: Floats, size: Floats, yaw: Floats, other_size: Floats, other_yaw: Floats) -> Floats:
    """(p,) intersection over union of pairs of outlines, seen from above.

    offset: (p, 2) m, from the first to the second; size, other_size: (p, >= 2) m; yaw, other_yaw: (p,) rad. 0 where
    both have no area.
    """
    intersection = intersection_area(offset, size, yaw, other_size, other_yaw)
    union = size[:, 0] * size[:, 1] + other_size[:, 0] * other_size[:, 1] - intersection
    return np.divide(intersection, union, out=np.zeros(len(offset)), where=union > 0.0)


def jaccard(one: int, other: int, matched: int) -> float:
    """Share of the matched among all boxes of two sets of `one` and `other` boxes.

    0 if one of the sets is empty, as in ROBOSAC: nothing confirms the other one.
    """
    if not one or not other:
        return 0.0
    return matched / (one + other - matched)


def agreement(one: ClusterBoxes, other: ClusterBoxes, least_iou: float) -> float:
    """Jaccard index of two sets of boxes; see `matched_boxes` and `jaccard`."""
    matched, _ = matched_boxes(one, other, least_iou)
    return jaccard(len(one.yaw), len(other.yaw), len(matched))
