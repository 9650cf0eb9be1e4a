"""Scenes in our own file format: a recording that was saved."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.scenes.selection import fewer_agents, first_frames


class RecordingFile(Scene):
    """A recording in a file: of `mast scene convert`, of `PreparedScene.save`, or scene.npz of a run.

    path:             the file, see docs/scene_arrays.md
    n_infrastructure: number of static agents to use, the first ones; None: all
    n_mobile:         number of mobile agents besides the ego to use, the first ones; None: all

    Detections are in the file, so the seed makes no difference to the scene.
    """

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
