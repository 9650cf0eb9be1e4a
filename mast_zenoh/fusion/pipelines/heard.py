"""What an agent has heard from others: the newest tracks of each, at any later time; and tracks of several agents.

Pictures that agents relay: of each object, from which agents' tracks it comes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Ints, ObjectStates, concatenate
from mast_zenoh.fusion.input_limit import ClaimedObjects
from mast_zenoh.fusion.pipelines.collation import Admission, Origins
from mast_zenoh.gather import MAX_AGE_S, Newest
from mast_zenoh.tracking.kalman import predicted


class AgentTracks(NamedTuple):
    """Tracks of several agents at one time.

    names: of the agents; states: n tracks, world frame; agent: (n,) rows of `names`
    """

    names: tuple[str, ...]
    states: ObjectStates
    agent: Ints

    @classmethod
    def of(cls, name: str, states: ObjectStates) -> AgentTracks:
        """The tracks of one agent."""
        return cls((name,), states, np.zeros(len(states), np.int64))

    def joined(self, *others: AgentTracks) -> AgentTracks:
        """These and those of others; an agent may have tracks in several."""
        if not others:
            return self
        parts = (self, *others)
        names = list(dict.fromkeys(name for part in parts for name in part.names))
        row_of = {name: row for row, name in enumerate(names)}
        agent = [np.array([row_of[name] for name in part.names], np.int64)[part.agent] for part in parts]
        return AgentTracks(tuple(names), concatenate([part.states for part in parts]), np.concatenate(agent))

    def admitted(self, admission: Admission, beyond: Mapping[str, int]) -> AgentTracks:
        """Those that an input limit keeps. beyond: rows that messages of agents had besides, where there were any"""
        rows = {name: np.flatnonzero(self.agent == row) for row, name in enumerate(self.names)}
        ids, score = self.states.id, self.states.score
        selected = admission.select(
            {name: ClaimedObjects(ids[own], score[own], beyond.get(name, 0)) for name, own in rows.items()}
        )
        if not selected:
            return self
        kept = np.sort(np.concatenate([own[selected.get(name, slice(None))] for name, own in rows.items()]))
        return self._replace(states=self.states.select(kept), agent=self.agent[kept])


class HeardTracks:
    """The newest tracks of each sender.

    memory_s: how long an object is kept that a newer message of its sender left out, as generation rules do; 0: not at
        all, a message has all objects of its sender
    max_age_s: the greatest age of a track that is used
    """

    def __init__(self, memory_s: float = 0.0, max_age_s: float = MAX_AGE_S) -> None:
        check("0 to 60 s", memory_s=memory_s, max_age_s=max_age_s)
        self._memory_ns, self._max_age_ns = round(memory_s * 1e9), round(max_age_s * 1e9)
        self._newest: dict[str, int] = {}  # time of the newest message of each sender, ns
        self._known = Known([], ObjectStates.empty(), *np.zeros((2, 0), np.int64))
        self._added: list[tuple[str, int, ObjectStates]] = []  # since then: sender, time, tracks

    def add(self, sender: str, time_ns: int, states: ObjectStates) -> None:
        """Add a message; a second one about the same time, and an older one, are not used.

        states: n tracks at `time_ns`, world frame, with different ids
        """
        if time_ns > self._newest.get(sender, time_ns - 1):
            self._newest[sender] = time_ns
            self._added.append((sender, time_ns, states))

    def at(self, time_ns: int) -> AgentTracks:
        """The tracks of all senders, predicted to a time; names are sorted.

        Those of a sender are sorted by time, the newest first, and then as in their messages.
        """
        self._newest = {
            sender: newest for sender, newest in self._newest.items() if abs(time_ns - newest) <= self._max_age_ns
        }
        self._known, self._added = self._merged(), []
        names, states, sender, times_ns = self._known
        age_ns = time_ns - times_ns
        used = np.abs(age_ns) <= self._max_age_ns
        if not used.all():
            states, sender, age_ns = states.select(used), sender[used], age_ns[used]
        groups = [np.flatnonzero(age_ns == age) for age in np.unique(age_ns)]
        parts = [predicted(states.select(rows), float(age_ns[rows[0]]) * 1e-9) for rows in groups]
        if len(parts) > 1:
            states = concatenate(parts).select(np.argsort(np.concatenate(groups)))
        return AgentTracks(tuple(names), parts[0] if len(parts) == 1 else states, sender)

    def _merged(self) -> Known:
        """What is known with the messages added since, of senders that are not too old."""
        names = sorted(self._newest)
        row_of = {name: row for row, name in enumerate(names)}
        added = [each for each in self._added if each[0] in row_of]
        counts = [len(states) for _, _, states in added]
        before = np.array([row_of.get(name, -1) for name in self._known.names], np.int64)[self._known.sender]
        sender = np.concatenate([before, np.repeat([row_of[each] for each, _, _ in added], counts).astype(np.int64)])
        times_ns = np.concatenate([self._known.time_ns, np.repeat([each for _, each, _ in added], counts)])
        states = concatenate([self._known.states, *(each for _, _, each in added)])
        newest = np.array([self._newest[name] for name in names], np.int64)
        kept = np.flatnonzero(sender >= 0)
        kept = kept[newest[sender[kept]] - times_ns[kept] <= self._memory_ns]
        order = kept[np.lexsort((-times_ns[kept], sender[kept]))]
        if self._memory_ns:  # an object in several messages: the newest counts
            by_object = order[np.lexsort((states.id[order], sender[order]))]
            again = np.zeros(len(states), bool)
            again[by_object[1:]] = (np.diff(states.id[by_object]) == 0) & (np.diff(sender[by_object]) == 0)
            order = order[~again[order]]
        return Known(names, states.select(order), sender[order], times_ns[order])


class Known(NamedTuple):
    """Tracks of all senders.

    names:  of the senders, sorted; states: n tracks, each at its time; by sender, then by time, the newest first
    sender: (n,) rows of `names`; time_ns: (n,) int64
    """

    names: list[str]
    states: ObjectStates
    sender: Ints
    time_ns: Ints


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
