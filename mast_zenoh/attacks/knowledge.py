"""What an attacker knows of the command centre's assessment."""

from __future__ import annotations

from abc import ABC
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Floats, ObjectStates
from mast_zenoh.attacks.surroundings import Surroundings
from mast_zenoh.gather import LatestBefore
from mast_zenoh.integrity.base import SUSPENDED
from mast_zenoh.wiring.received import Received


@dataclass(frozen=True, slots=True, eq=False)
class Trust:
    """The command centre's trust in a agents and n objects, as in a `trust` message.

    agents: names, sorted; mean: (a,) 0 to 1; state: (a,) uint8, index into integrity.STATES
    position: (n, 3) m, world frame; trust: (n,) 0 to 1; withheld: (n,) uint8, 1: not in the picture
    """

    agents: tuple[str, ...]
    mean: Floats
    state: NDArray[np.uint8]
    position: Floats
    trust: Floats
    withheld: NDArray[np.uint8]

    @classmethod
    def of_columns(cls, columns: Mapping[str, NDArray[Any]]) -> Trust:
        """The trust in the columns of a `trust` message; further columns are left out."""
        names = ("mean", "state", "position", "trust", "withheld")
        return cls(tuple(map(str, columns["agents"])), *(columns[name] for name in names))


class Attacker(ABC):  # noqa: B024 (attacks and coordinators have their own `step`)
    """What attacks and coordinators of several have in common: random streams and knowledge."""

    def bind(self, seed: int, name: str) -> None:  # noqa: B027 (a hook: without random numbers it needs no streams)
        """Set the seed and the node's name, which identify the random streams."""

    def inform(self, surroundings: Surroundings) -> None:  # noqa: B027 (a hook)
        """Set the prior knowledge of the scene; called before `bind`."""

    def hear_picture(self, frame: int, time_ns: int, objects: ObjectStates) -> None:  # noqa: B027 (a hook)
        """Take note of a picture that arrived in an earlier frame: n fused objects, world frame.

        For adversaries that listen to the picture (`keyexpr_maps/knowledge_picture.toml`).
        """

    def hear_trust(self, frame: int, time_ns: int, trust: Trust) -> None:  # noqa: B027 (a hook)
        """Take note of the command centre's trust, which arrived in an earlier frame.

        For adversaries that listen to it (`keyexpr_maps/knowledge_trust.toml`).
        """

    def counts(self) -> dict[str, int]:
        """Numbers of selected targets (`Campaign.counts`) or of scans (`PointAttack.counts`); {}: neither."""
        return {}


class CentreMessages:
    """Pictures and trust of a command centre, as attackers overhear them: known from the next frame on."""

    def __init__(self) -> None:
        self._newest: dict[str, LatestBefore[Received]] = {"picture": LatestBefore(), "trust": LatestBefore()}

    def add(self, frame: int, received: Received) -> None:
        """Keep a picture or a trust message that arrived in a frame."""
        self._newest[received.schema].add(frame, received, received.frame)

    def tell(self, listener: Attacker, heard: dict[str, int], frame: int) -> None:
        """Tell a listener the newest of each from before a frame, once each.

        heard: by type, frames of arrival of the last ones that it was told; updated
        """
        for name, messages in self._newest.items():
            newest = messages.get(frame)
            if newest is None or newest[0] == heard.get(name, -1):
                continue
            heard[name], received = newest
            about = received.frame, received.time_ns
            if name == "picture":
                listener.hear_picture(*about, ObjectStates.from_columns(received.body))
            else:
                listener.hear_trust(*about, Trust.of_columns(received.body))


class TrustWatch:
    """Tells whether the trust in an attacker's own agents has fallen.

    tolerance: 0 to 1, fall of the mean below its highest value that is accepted

    Raises ValueError for a tolerance outside 0 to 1.
    """

    def __init__(self, tolerance: float) -> None:
        check("0 to 1", tolerance=tolerance)
        self._tolerance = tolerance
        self._highest: dict[str, float] = {}
        self.fallen = False

    def hear(self, trust: Trust, own: Collection[str]) -> None:
        """Compare the trust in the agents `own` with the highest so far; those without any are skipped."""
        fallen = []
        for name, mean, state in zip(trust.agents, trust.mean.tolist(), trust.state.tolist(), strict=True):
            if name in own:
                highest = self._highest[name] = max(mean, self._highest.get(name, mean))
                fallen.append(mean < highest - self._tolerance or state == SUSPENDED)
        if fallen:
            self.fallen = any(fallen)


class TrustWatcher(Attacker):
    """Base of attackers that watch the trust in their own agents.

    _watch, _surroundings: set by the attacker
    """

    _watch: TrustWatch
    _surroundings: Surroundings

    def hear_trust(self, frame: int, time_ns: int, trust: Trust) -> None:
        self._watch.hear(trust, self._surroundings.victims)
