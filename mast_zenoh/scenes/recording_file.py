"""Recordings in files as scenes: all of one, its first frames, or some of its agents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.states import Ints
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.recording import Recording


def first_frames(recording: Recording, frames: int | None) -> Recording:
    """The first frames of a recording; None: all. Raises ConfigurationError for more than there are."""
    if frames is None or frames == len(recording):
        return recording
    if not 1 <= frames < len(recording):
        raise ConfigurationError(f"{recording.name}: {frames} frames requested, the scene has {len(recording)}")
    truth = slice(int(recording.truth_start[frames]))
    sensors = len(recording.sensor_names)
    detections = slice(int(recording.detection_start[frames * sensors]))
    return replace(
        recording,
        times_ns=recording.times_ns[:frames],
        truth=recording.truth.select(truth),
        truth_start=recording.truth_start[: frames + 1],
        points=recording.points[truth],
        agent_position=recording.agent_position[:frames],
        agent_rotation=recording.agent_rotation[:frames],
        agent_velocity=recording.agent_velocity[:frames],
        detections=recording.detections.select(detections),
        detection_start=recording.detection_start[: frames * sensors + 1],
        detection_truth_id=recording.detection_truth_id[detections],
        sweeps=tuple(sweep[:frames] for sweep in recording.sweeps),
        measurements=recording.measurements and recording.measurements.select(slice(frames), slice(None)),
        scans=recording.scans and recording.scans.select(frames, np.arange(len(recording.agents))),
    )


def check_counts(
    place: object,
    mobile: tuple[int | None, int],
    static: tuple[int | None, int],
    kinds: tuple[str, str] = ("mobile agents besides the ego", "static agents"),
) -> None:
    """Raise ConfigurationError for a request for more agents than a scene has.

    place: for the message; mobile, static: (`n_mobile` or `n_infrastructure`, number of them in the scene); kinds: what
    they are called
    """
    for name, (requested, available), kind in zip(
        ("n_mobile", "n_infrastructure"), (mobile, static), kinds, strict=True
    ):
        if requested is not None and not 0 <= requested <= available:
            raise ConfigurationError(
                f"{place}: {name} is {requested}, expected 0 to {available}: the scene has {available} {kind}"
            )


def fewer_agents(recording: Recording, n_mobile: int | None, n_infrastructure: int | None) -> Recording:
    """A recording with the ego and the first mobile and static agents; None: all of a kind.

    Raises ConfigurationError for more than there are.
    """
    mobile, static = (
        [row for row, agent in enumerate(recording.agents) if row and agent.kind == kind]
        for kind in ("mobile", "static")
    )
    check_counts(recording.name, (n_mobile, len(mobile)), (n_infrastructure, len(static)))
    kept = [0, *mobile[:n_mobile], *static[:n_infrastructure]]
    return recording if len(kept) == len(recording.agents) else _with_agents(recording, np.array(sorted(kept)))


def _with_agents(recording: Recording, rows: Ints) -> Recording:
    """A recording with the agents of some rows, ascending."""
    frames, sensors = len(recording), len(recording.sensor_names)
    columns = np.array([recording.column(row, k) for row in rows for k in range(len(recording.agents[row].sensors))])
    counts = np.diff(recording.detection_start).reshape(frames, sensors)
    owner = np.repeat(np.tile(np.arange(sensors), frames), counts.ravel())
    kept = np.flatnonzero(np.isin(owner, columns))
    return replace(
        recording,
        agents=tuple(recording.agents[row] for row in rows),
        points=recording.points[:, rows],
        agent_position=recording.agent_position[:, rows],
        agent_rotation=recording.agent_rotation[:, rows],
        agent_velocity=recording.agent_velocity[:, rows],
        detections=recording.detections.select(kept),
        detection_start=np.concatenate([[0], np.cumsum(counts[:, columns])]),
        detection_truth_id=recording.detection_truth_id[kept],
        sweeps=tuple(recording.sweeps[row] for row in rows) if recording.sweeps else (),
        measurements=recording.measurements and recording.measurements.select(slice(None), columns),
        scans=recording.scans and recording.scans.select(frames, rows),
    )


class RecordingFile(Scene):
    """A recording in a file: of `mast scene convert`, of `PreparedScene.save`, or scene.npz of a run.

    path:             the file, see docs/ref-detections-and-arrays.md
    n_infrastructure: number of static agents to use, the first ones; None: all
    n_mobile:         number of mobile agents besides the ego to use, the first ones; None: all

    Detections are in the file, so the seed makes no difference to the scene.
    """

    short_name = "recording"

    @classmethod
    def recognises(cls, path: Path) -> bool:
        return path.is_file() and path.suffix == ".npz"

    def __init__(self, *, path: str, n_infrastructure: int | None = None, n_mobile: int | None = None) -> None:
        self.path = Path(path)
        self.n_infrastructure = n_infrastructure
        self.n_mobile = n_mobile

    def inputs(self) -> Sequence[Path]:
        """The file."""
        return (self.path,)

    def record(self, seed: int, frames: int | None) -> Recording:
        return fewer_agents(
            first_frames(Recording.load(self.path.resolve()), frames), self.n_mobile, self.n_infrastructure
        )
