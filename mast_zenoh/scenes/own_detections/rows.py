"""Detections as rows of a file, and the columns of a recording that they become."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import CLASSES, Detections, Floats, Ints
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.making.assembly import DetectionColumns


@dataclass(frozen=True, eq=False)
class DetectionRows:
    """D detections of all frames and agents, in any order; in the frame of the sensor that made them.

    place:    (D,) text, where each is in its file, for messages
    frame:    (D,) int64, row of the scene's frames;  agent: (D,) int64, row of its agents
    position: (D, 3) m, middle of the box;  size: (D, 3) m, length, width, height;  yaw: (D,) rad
    score:    (D,) 0 to 1
    class_id: (D,) uint8, index into CLASSES;  covariance: (D, 3, 3) m², all zero if not given
    truth_id: (D,) int64, id of the detected object, -1 if it is clutter or not known; for scoring only
    """

    place: Sequence[str]
    frame: Ints
    agent: Ints
    position: Floats
    size: Floats
    yaw: Floats
    score: Floats
    class_id: NDArray[np.uint8]
    covariance: Floats
    truth_id: Ints

    def before(self, frames: int) -> DetectionRows:
        """The rows of the first frames only."""
        kept = np.flatnonzero(self.frame < frames)
        arrays = {field.name: getattr(self, field.name)[kept] for field in fields(self) if field.name != "place"}
        return DetectionRows(place=[self.place[row] for row in kept.tolist()], **arrays)

    def columns(self, frames: int, agents: int, path: Path) -> DetectionColumns:
        """The columns of a recording; the rows of a frame and an agent stay in their order.

        Raises SceneError for the first row that cannot be. path: of the file, for the message.
        """
        self._check(frames, agents, path)
        group = self.frame * agents + self.agent
        order = np.argsort(group, kind="stable")
        yaw = wrap_angle(self.yaw)
        unordered = Detections(self.position, self.size, yaw, self.score, self.class_id, self.covariance)
        detections = unordered.select(order)
        start = np.searchsorted(group[order], np.arange(frames * agents + 1)).astype(np.int64)
        return detections, start, self.truth_id[order]

    def _check(self, frames: int, agents: int, path: Path) -> None:
        covariance = self.covariance
        symmetric = np.abs(covariance - np.swapaxes(covariance, 1, 2)).max(axis=(1, 2), initial=0.0) <= 1e-9
        smallest = np.linalg.eigvalsh(np.nan_to_num(covariance)).min(axis=1, initial=0.0)
        for name, valid, expected in (
            ("frame", (self.frame >= 0) & (self.frame < frames), f"0 to {frames - 1}"),
            ("agent", (self.agent >= 0) & (self.agent < agents), f"0 to {agents - 1}"),
            ("position", np.isfinite(self.position).all(axis=1), "finite numbers, m"),
            ("size", (np.isfinite(self.size) & (self.size > 0)).all(axis=1), "finite numbers above 0, m"),
            ("yaw", np.isfinite(self.yaw), "a finite number, rad"),
            ("score", (self.score >= 0) & (self.score <= 1), "0 to 1"),
            ("class_id", self.class_id < len(CLASSES), f"0 to {len(CLASSES) - 1}"),
            ("covariance", np.isfinite(covariance).all(axis=(1, 2)), "finite numbers, m²"),
            ("covariance", symmetric & (smallest >= -1e-9), "a symmetric matrix without negative eigenvalues"),
        ):
            if not valid.all():
                row = int(np.flatnonzero(~valid)[0])
                raise SceneError(
                    f"{path}: {self.place[row]}: {name} is {getattr(self, name)[row].tolist()}, expected {expected}"
                )
