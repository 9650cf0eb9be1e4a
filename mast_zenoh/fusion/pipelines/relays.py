"""Pictures that agents relay: of each object, from which agents' tracks it comes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Bools, Ints, ObjectStates
from mast_zenoh.fusion.pipelines.heard import AgentTracks
from mast_zenoh.fusion.pipelines.origins import Origins
from mast_zenoh.gather import Newest
from mast_zenoh.tracking.kalman import predicted

#: Ending of the name under which what an agent relays is fused, beside what it broadcasts.
RELAY = "/relay"


class Relay(NamedTuple):
    """Objects of another agent's picture.

    states: n objects at `time_ns`, world frame; origin: (n, a) whether each of `agents` is among their origins
    """

    time_ns: int
    states: ObjectStates
    agents: tuple[str, ...]
    origin: Bools

    def without(self, agent: str) -> Relay:
        """The objects that have none of an agent's tracks in them."""
        if agent not in self.agents:
            return self
        kept = ~self.origin[:, self.agents.index(agent)]
        return self._replace(states=self.states.select(kept), origin=self.origin[kept])


class Relays:
    """The newest picture of each other agent, and the origins of an agent's own.

    agent: which of their objects are left out, because its own tracks are in them; max_age_s: of a picture that is used
    """

    def __init__(self, agent: str, max_age_s: float) -> None:
        self._agent = agent
        self._newest: Newest[Relay] = Newest(max_age_s)
        self._origins = Origins()

    def add(self, sender: str, relay: Relay) -> None:
        """Add a picture; one that is older than that before is not used."""
        self._newest.add(sender, relay.time_ns, relay.without(self._agent))

    def at(self, time_ns: int) -> dict[str, Relay]:
        """The pictures predicted to a time, by the names under which they are fused; in the order of names."""
        newest = sorted(self._newest.at(time_ns).items())
        return {
            f"{name}{RELAY}": relay._replace(states=predicted(relay.states, age_ns * 1e-9))
            for name, (age_ns, relay) in newest
        }

    def origins_of(
        self, picture: Ints, members: Ints, tracks: AgentTracks, relays: Mapping[str, Relay]
    ) -> tuple[list[str], Bools]:
        """Names of a agents, sorted, and whether each is among the origins of each object of the picture: (n, a).

        picture: (n,) ids; members: (m,) the row of its object for each of the m tracks that were fused, -1: none
        relays: those that are among the tracks, by their names
        """
        senders = {name: name.partition("/")[0] for name in tracks.names if name not in relays}
        direct = set(senders.values())
        origins = sorted(direct.union(*(relay.agents for relay in relays.values())))
        of_tracks = np.zeros((len(tracks.agent), len(origins)), np.bool_)
        for row, name in enumerate(tracks.names):
            if name in relays:
                columns = [origins.index(agent) for agent in relays[name].agents]
                of_tracks[np.ix_(tracks.agent == row, columns)] = relays[name].origin
            else:
                of_tracks[tracks.agent == row, origins.index(senders[name])] = True
        return origins, self._origins.update(picture, members, of_tracks, origins)
