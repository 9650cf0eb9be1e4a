"""When may the next frame begin? Lock-step by quiescence, as a state machine without I/O.

Every runtime reports how many messages its node has sent and has handled, per key, both at once, whenever its inbox
is empty. The mesh is quiet when every subscriber of every key has handled all that its publisher has sent. A report
is made after everything that the counted messages caused has been sent, so reports that balance cannot hide a message
under way.

Nodes that publish nothing (an evaluator, a recorder) cause nothing: they are not waited for in every frame, only now
and then, so that they do not fall behind without bound, and at the end.

Counting is by epoch. When a node dies or joins, a new epoch begins: all counters start from zero, and a message
counts only in the epoch in which it was sent.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping

from mast_zenoh.config.resolved import DRIVER_ROLE
from mast_zenoh.wiring.model import Wiring


class Pacer:
    """Judges quiescence among the members of the current epoch.

    members: name to role of the nodes that take part, the driving node included
    """

    def __init__(self, wiring: Wiring) -> None:
        self.epoch = 0
        self.members: dict[str, str] = {}
        self._reports: dict[str, tuple[Mapping[str, int], Mapping[str, int]]] = {}
        self._speaks: defaultdict[str, set[str]] = defaultdict(set)
        self._hears: defaultdict[str, set[str]] = defaultdict(set)
        self.rewire(wiring)

    def rewire(self, wiring: Wiring) -> None:
        """From the next epoch on messages flow like this."""
        self._flows = list(wiring.flows())
        self._publishers = {leg.publisher.node for _, leg in wiring.legs()}
        self._causes = [flow for flow in self._flows if flow[2] in self._publishers]
        # Keys of earlier wirings stay: what was sent and handled on them counts.
        for key, publisher, subscriber in self._flows:
            self._hears[subscriber].add(key)
            self._speaks[publisher].add(key)
        for _, leg in wiring.legs():
            self._speaks[leg.publisher.node].add(leg.key)

    def begin_epoch(self, members: Mapping[str, str]) -> int:
        """A new epoch with these members; nobody has reported in it yet. Returns its number."""
        self.epoch += 1
        self.members = dict(members)
        self._reports.clear()
        return self.epoch

    def report(self, node: str, epoch: int, sent: Mapping[str, int], handled: Mapping[str, int]) -> str:
        """A node's counters by key. Those of another epoch or of a stranger say nothing.

        Returns why they cannot be true, if they name a key on which the node does not speak, or that it does not hear.
        """
        if epoch != self.epoch or node not in self.members:
            return ""
        if not self._speaks[node].issuperset(sent):
            return f"{node} reports messages sent on {_first(sent, self._speaks[node])}, on which it does not speak"
        if not self._hears[node].issuperset(handled):
            return f"{node} reports messages handled on {_first(handled, self._hears[node])}, which it does not hear"
        self._reports[node] = (sent, handled)
        return ""

    def drop(self, nodes: Iterable[str]) -> None:
        """These members are gone: the rest of the epoch goes on without waiting for them."""
        for node in nodes:
            self.members.pop(node, None)
            self._reports.pop(node, None)

    @property
    def silent(self) -> set[str]:
        """Members that have not reported in this epoch."""
        return self.members.keys() - self._reports.keys()

    def quiet(self, *, everyone: bool = False) -> bool:
        """Whether nothing is under way to those who may answer it; with `everyone`, to anyone at all."""
        reports = self._reports
        awaited = self.members.keys() if everyone else self.members.keys() & self._publishers
        if not awaited <= reports.keys():
            return False
        for key, publisher, subscriber in self._flows if everyone else self._causes:
            both = publisher in awaited and subscriber in awaited
            if both and reports[publisher][0].get(key, 0) != reports[subscriber][1].get(key, 0):
                return False
        return True

    def implausible(self) -> str:
        """Who has reported what cannot be, in words; to be asked when no report has come for a while.

        A report is late only while its node is busy: with what was sent to it, or with what a busy node before it may
        have sent since its own report. The count of a publisher that is not busy is final, and nobody can have handled
        more. Where all who hear a key have, and these are several, it is the publisher that does not tell the truth;
        where there is only one, it is one of the two. The node that drives the scene counts as truthful.
        """
        reports = self._reports
        behind, over, agree = set[str](), dict[str, list[tuple[str, str, int, int]]](), defaultdict[str, int](int)
        for key, publisher, subscriber in self._flows:
            if publisher not in reports or subscriber not in reports:
                continue
            sent, handled = reports[publisher][0].get(key, 0), reports[subscriber][1].get(key, 0)
            if handled < sent:
                behind.add(subscriber)
            if handled > sent:
                over.setdefault(key, []).append((publisher, subscriber, sent, handled))
            else:
                agree[key] += 1
        busy = behind | self.silent
        while more := {subscriber for _, publisher, subscriber in self._flows if publisher in busy} - busy:
            busy |= more
        for key, lies in over.items():
            publisher, subscriber, sent, handled = lies[0]
            if publisher in busy:
                continue
            if len(lies) > 1 and not agree[key]:
                heard = ", ".join(f"{name} {n}" for _, name, _, n in lies[:3])
                return f"{publisher} reports {sent} messages sent on {key}, of which more have been handled ({heard})"
            if not agree[key] and self.members.get(publisher) != DRIVER_ROLE:
                both = f"{publisher} reports {sent} messages sent on {key}, {subscriber} {handled} handled"
                return f"{both}: one of the two does not tell the truth"
            return f"{subscriber} reports {handled} messages of {publisher} handled on {key}, of which {sent} were sent"
        return ""

    def unsettled(self) -> Iterable[str]:
        """Why the mesh is not quiet, in words: for the error when it stays so."""
        for node in sorted(self.silent):
            yield f"{node} has not reported"
        unequal: dict[tuple[str, str, int], dict[str, int]] = {}
        hearers = defaultdict[str, int](int)
        for key, publisher, subscriber in self._flows:
            if publisher in self._reports and subscriber in self._reports:
                sent = self._reports[publisher][0].get(key, 0)
                handled = self._reports[subscriber][1].get(key, 0)
                hearers[key] += 1
                if sent != handled:
                    unequal.setdefault((key, publisher, sent), {})[subscriber] = handled
        for (key, publisher, sent), counts in unequal.items():
            if len(counts) == hearers[key] > 1 and len({*counts.values()}) == 1:  # perhaps it has not sent them
                handled, names = next(iter(counts.values())), ", ".join(counts)
                yield (
                    f"{publisher} reports {sent} messages sent on {key}, of which all who hear it "
                    f"have handled {handled} ({names})"
                )
                continue
            for subscriber, handled in counts.items():
                yield f"{subscriber} has handled {handled} of {sent} messages of {publisher} on {key}"


def _first(counters: Mapping[str, int], known: Collection[str]) -> str:
    """The first key that is not known, cut off."""
    return repr(min(counters.keys() - set(known))[:80])
