"""Boxes of cars with a lidar, in labels that do not say which object carries it."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.geometry import along_and_across, heading
from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Floats
from mast_zenoh.scenes.making.boxes import Boxes

#: Of a car without a label: an assumption, as the data set does not give its size.
CAR_SIZE = np.array([4.8, 1.9, 1.7])
_ABOVE_ROOF_M = 0.2  # of the lidar of such a car
_MAX_ABOVE_ROOF_M = 1.5  # of the lidar of a labelled car


def own_object(boxes: Boxes, position: Floats, rotation: Floats) -> tuple[Boxes, int]:
    """The boxes with one of the car below a lidar in every frame, and its id.

    position: (F, 3) m, and rotation: (F, 3, 3), of the lidar in the world

    The car is the one track whose box is below the lidar in every frame. If there is none, boxes below the lidar are
    left out, and boxes of CAR_SIZE take their place.
    """
    below = _below(boxes, position[boxes.frame])
    ids, count = np.unique(boxes.id[below], return_counts=True)
    throughout = ids[count == len(position)]
    if len(throughout) == 1:
        return boxes, int(throughout[0])
    own = int(boxes.id.max(initial=0)) + 1
    middle = position - [0.0, 0.0, _ABOVE_ROOF_M + CAR_SIZE[2] / 2]
    added = Boxes.throughout(own, middle, CAR_SIZE, heading(rotation), CLASS_INDEX["car"])
    return Boxes.concatenate([boxes.select(~below), added]), own


def _below(boxes: Boxes, lidar: Floats) -> Bools:
    """(N,) whether a box is below a lidar. lidar: (N, 3) m, its position in the frame of each box"""
    offset = lidar - boxes.position
    half = boxes.size / 2
    below: Bools = np.asarray((np.abs(along_and_across(offset, boxes.yaw)) <= half[:, :2]).all(axis=1))
    return below & (offset[:, 2] >= -half[:, 2]) & (offset[:, 2] <= half[:, 2] + _MAX_ABOVE_ROOF_M)
