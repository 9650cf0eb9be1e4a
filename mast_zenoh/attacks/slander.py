"""An attack on what agents say about whom they trust."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Floats
from mast_zenoh.attacks.attack import Attack, ObjectsUnchanged
from mast_zenoh.attacks.campaign import NANOSECONDS


@dataclass(kw_only=True, eq=False)
class Slander(ObjectsUnchanged, Attack):
    """Changes what an agent says about whom it trusts, on its way to others (keyexpr_maps/on_gossip.toml).

    It tells no trust in some agents, and full trust in the teller and in others: bad-mouthing and ballot stuffing
    (Dellarocas, Immunizing Online Reputation Reporting Systems, EC 2000).

    slandered, praised: names of agents
    start_s: s of scene time at which it begins
    """

    slandered: tuple[str, ...] = ()
    praised: tuple[str, ...] = ()
    start_s: float = 4.0

    def __post_init__(self) -> None:
        check("0 or more, finite", start_s=self.start_s)

    def forge_trust(self, time_ns: int, teller: str, agents: tuple[str, ...], trust: Floats) -> Floats:
        if time_ns < self.start_s * NANOSECONDS:
            return trust
        praised = np.isin(agents, (*self.praised, teller))
        return np.where(praised, 1.0, np.where(np.isin(agents, self.slandered), 0.0, trust))
