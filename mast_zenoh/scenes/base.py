"""Base class of scenes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path

from mast_zenoh.scenes.recording import Recording


class Scene(ABC):
    """A source of ground truth, which prepares a `Recording`.

    A subclass takes its parameters as keywords.
    """

    @abstractmethod
    def record(self, seed: int, frames: int | None) -> Recording:
        """Record the scene's first `frames` frames (None: all, or its default number).

        The result depends on (self, seed) alone. Raises SceneError with file, place and reason when data is missing,
        truncated or inconsistent, and ConfigurationError for an invalid parameter.
        """

    def inputs(self) -> Sequence[Path]:
        """Files and folders that the recording depends on; the disk cache tracks them."""
        return ()
