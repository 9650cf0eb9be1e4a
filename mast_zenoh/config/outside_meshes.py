"""Meshes outside runs, each brought by a plugin: what a scenario says of one, and what publishes a run there."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, ClassVar

from mast_zenoh.config import registry
from mast_zenoh.config.resolved import NodeSpec


class OutsideMesh(ABC):
    """A mesh outside runs, in which nodes of a run take part (`mast_zenoh.outside`), and where it can be published.

    key: of the part of a scenario about it, and of the parameter of its nodes
    no_bridge: a warning, if a run in one process has that part
    """

    key: ClassVar[str]
    no_bridge: ClassVar[str] = ""

    @staticmethod
    @abstractmethod
    def parameter(config: Any, place: str) -> Mapping[str, Any]:
        """The parameter of nodes that have none of their own, from the part of a scenario.

        place: where that part is. Raises ConfigurationError for an invalid one.
        """

    @staticmethod
    @abstractmethod
    def prepare(path: Path, nodes: Mapping[str, NodeSpec], partners: Mapping[str, NodeSpec]) -> None:
        """Check and complete the nodes of a scenario, if some take part. partners: those

        path: of the scenario. Raises ConfigurationError.
        """

    @staticmethod
    def bridge(config: Any) -> AbstractContextManager[Callable[[Any], None]]:
        """What publishes a run on a mesh while it goes on: a callback that gets its `RunContext` before it begins."""
        return nullcontext(lambda context: None)


def outside_meshes(key: str = "") -> dict[str, type[OutsideMesh]]:
    """The meshes of plugins by key; those that are loaded, if that of `key` is among them or it is ""."""
    known = _by_key(registry.known_types(OutsideMesh))
    return _by_key(registry.known_types(OutsideMesh, key)) if key and key not in known else known


def _by_key(classes: Mapping[str, type[Any]]) -> dict[str, type[OutsideMesh]]:
    return {cls.key: cls for cls in classes.values()}
