"""What a scene is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path

from mast_zenoh.scenes.recording import Recording


class Scene(ABC):
    """Where the truth comes from. A subclass takes its parameters as keywords and makes a `Recording` of itself."""

    @abstractmethod
    def record(self, seed: int, frames: int | None) -> Recording:
        """The scene's first `frames` frames (None: all it has or its usual number), a function of (self, seed) alone.

        Raises SceneError when data is missing, truncated or inconsistent, naming file, place and reason, and
        ConfigurationError when a parameter makes no sense.
        """

    def inputs(self) -> Sequence[Path]:
        """The files and folders that the recording is made from; the disk cache watches their identity."""
        return ()
