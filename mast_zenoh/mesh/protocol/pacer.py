"""Participating nodes, and lock-step by quiescence: decides when the next frame may begin; without I/O.

Whenever its inbox is empty, every node's process reports how many messages it has sent and handled by key. The mesh is
quiet when every subscriber of every key has handled all messages that the key's publisher has sent. A report follows
everything that the counted messages caused, so balanced reports cannot hide a message in transit.

Nodes that publish nothing (an evaluator, a recorder) cause no messages. They are waited for only every few frames, so
that they do not fall behind without bound, and at the end.

Counting is by epoch. When a node dies or joins, a new epoch begins: all counters start from zero, and a message
counts only in the epoch in which it was sent.

The process steps of a run by frame, for both runtimes; without I/O.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Container, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from mast_zenoh.config.resolved import ACTIONS, DRIVER_ROLE, LEAVING, REALTIME, ProcessStep, Resolved
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.run_folder.recording.churn import BACK, LOST
from mast_zenoh.wiring.model import Wiring

#: Frames after which the driver also waits for nodes that publish nothing.
SETTLE_EVERY = 50


def waits_for_listeners(frames: int) -> bool:
    """Whether the driver waits for nodes that publish nothing, too, after this many frames."""
    return frames % SETTLE_EVERY == 0


class Pacer:
    """Detects quiescence among the members of the current epoch.

    members: name to role of the participating nodes, including the driver
    heard:   nodes that have reported in any epoch
    """

    def __init__(self, wiring: Wiring) -> None:
        self.epoch = 0
        self.members: dict[str, str] = {}
        self.heard: set[str] = set()
        self._reports: dict[str, tuple[Mapping[str, int], Mapping[str, int]]] = {}
        self._publishes: defaultdict[str, set[str]] = defaultdict(set)
        self._subscribes: defaultdict[str, set[str]] = defaultdict(set)
        self.rewire(wiring)

    def rewire(self, wiring: Wiring) -> None:
        """Use this wiring from the next epoch onwards."""
        self._flows = list(wiring.flows())
        self._publishers = {leg.publisher.node for _, leg in wiring.legs()}
        self._causes = [flow for flow in self._flows if flow[2] in self._publishers]
        # Keys of earlier wirings stay: messages on them still count.
        for key, publisher, subscriber in self._flows:
            self._subscribes[subscriber].add(key)
            self._publishes[publisher].add(key)
        for _, leg in wiring.legs():
            self._publishes[leg.publisher.node].add(leg.key)

    def begin_epoch(self, members: Mapping[str, str]) -> int:
        """Begin an epoch with these members, without any reports; returns its number."""
        self.epoch += 1
        self.members = dict(members)
        self._reports.clear()
        return self.epoch

    def report(self, node: str, epoch: int, sent: Mapping[str, int], handled: Mapping[str, int]) -> str:
        """Take a node's counters by key; ignores other epochs and non-members.

        Returns an error if they contain a key that the node neither publishes nor receives, else "".
        """
        if epoch != self.epoch or node not in self.members:
            return ""
        if not self._publishes[node].issuperset(sent):
            return (
                f"{node} reports messages sent on {_first(sent, self._publishes[node])}, which it does not publish on"
            )
        if not self._subscribes[node].issuperset(handled):
            key = _first(handled, self._subscribes[node])
            return f"{node} reports messages handled on {key}, which it does not receive"
        self._reports[node] = (sent, handled)
        self.heard.add(node)
        return ""

    def drop(self, nodes: Iterable[str]) -> None:
        """Remove members that have gone: the current epoch no longer waits for them."""
        for node in nodes:
            self.members.pop(node, None)
            self._reports.pop(node, None)

    @property
    def silent(self) -> set[str]:
        """Members that have not reported in this epoch."""
        return self.members.keys() - self._reports.keys()

    def quiet(self, *, include_listeners: bool = False) -> bool:
        """Whether no message is in transit to a node that publishes.

        include_listeners: nor to any other node
        """
        reports = self._reports
        awaited = self.members.keys() if include_listeners else self.members.keys() & self._publishers
        if not awaited <= reports.keys():
            return False
        for key, publisher, subscriber in self._flows if include_listeners else self._causes:
            awaits_both = publisher in awaited and subscriber in awaited
            if awaits_both and reports[publisher][0].get(key, 0) != reports[subscriber][1].get(key, 0):
                return False
        return True

    def implausible(self) -> str:
        """Describe an impossible report; "" for none.

        Call this after a while without reports. A report is outdated only while its node is busy: with messages sent to
        it, or with those that a busy node upstream may have sent since its own report. The count of a publisher that is
        not busy is final, and no subscriber can have handled more. If all of several subscribers claim to have, the
        publisher's report is false; if the only one does, it is one of the two. The driver's report counts as true.
        """
        reports = self._reports
        behind, excess, plausible = set[str](), dict[str, list[tuple[str, str, int, int]]](), defaultdict[str, int](int)
        for key, publisher, subscriber in self._flows:
            if publisher not in reports or subscriber not in reports:
                continue
            sent, handled = reports[publisher][0].get(key, 0), reports[subscriber][1].get(key, 0)
            if handled < sent:
                behind.add(subscriber)
            if handled > sent:
                excess.setdefault(key, []).append((publisher, subscriber, sent, handled))
            else:
                plausible[key] += 1
        busy = behind | self.silent
        while downstream := {subscriber for _, publisher, subscriber in self._flows if publisher in busy} - busy:
            busy |= downstream
        for key, claims in excess.items():
            publisher, subscriber, sent, handled = claims[0]
            if publisher in busy:
                continue
            if len(claims) > 1 and not plausible[key]:
                counts = ", ".join(f"{name} {n}" for _, name, _, n in claims[:3])
                return f"{publisher} reports {sent} messages sent on {key}, of which more have been handled ({counts})"
            if not plausible[key] and self.members.get(publisher) != DRIVER_ROLE:
                reports_differ = f"{publisher} reports {sent} messages sent on {key}, {subscriber} {handled} handled"
                return f"{reports_differ}: one of the two reports is false"
            return f"{subscriber} reports {handled} messages of {publisher} handled on {key}, of which {sent} were sent"
        return ""

    def unsettled(self) -> Iterable[str]:
        """Reasons why the mesh is not quiet, as text for errors."""
        for node in sorted(self.silent):
            yield f"{node} has not reported"
        differing: dict[tuple[str, str, int], dict[str, int]] = {}
        n_subscribers = defaultdict[str, int](int)
        for key, publisher, subscriber in self._flows:
            if publisher in self._reports and subscriber in self._reports:
                sent = self._reports[publisher][0].get(key, 0)
                handled = self._reports[subscriber][1].get(key, 0)
                n_subscribers[key] += 1
                if sent != handled:
                    differing.setdefault((key, publisher, sent), {})[subscriber] = handled
        for (key, publisher, sent), counts in differing.items():
            if len(counts) == n_subscribers[key] > 1 and len({*counts.values()}) == 1:  # perhaps they were not sent
                handled, names = next(iter(counts.values())), ", ".join(counts)
                yield (
                    f"{publisher} reports {sent} messages sent on {key}, of which all its subscribers "
                    f"have handled {handled} ({names})"
                )
                continue
            for subscriber, handled in counts.items():
                yield f"{subscriber} has handled {handled} of {sent} messages of {publisher} on {key}"


def _first(counters: Mapping[str, int], known: Collection[str]) -> str:
    """The first unknown key, truncated."""
    return repr(min(counters.keys() - set(known))[:80])


#: Maximum number of losses of a node that comes back; more often, the run ends.
MAX_LOSSES = 50


class TokenPresence(NamedTuple):
    """A liveliness token: whether it disappeared since the last look, and exists now."""

    gone: bool
    present: bool

    def followed_by(self, newer: TokenPresence) -> TokenPresence:
        """This change and a newer one combined."""
        return TokenPresence(self.gone or newer.gone, newer.present)


class Membership:
    """Participating nodes, from the scenario, wiring changes and liveliness tokens.

    own:      the driver's name
    expected: name to role of all nodes that may take part
    alive:    nodes with a liveliness token
    replaced: nodes whose token went since the epoch began: their new process joins in an epoch of its own
    leaving:  nodes that the scenario ends
    churn:    losses and returns of nodes, see run_folder.recording.churn
    """

    def __init__(self, own: str, expected: dict[str, str]) -> None:
        self.own = own
        self.expected = expected
        self.alive: set[str] = {own}
        self.replaced: set[str] = set()
        self.leaving: set[str] = set()
        self.churn: list[dict[str, Any]] = []

    @property
    def present(self) -> dict[str, str]:
        """Name to role of the expected nodes that are alive, except replaced ones."""
        return {name: role for name, role in self.expected.items() if name in self.alive - self.replaced}

    def differs(self, members: dict[str, str]) -> bool:
        """Whether `members` differ from the present nodes."""
        return bool(self.replaced) or (self.alive & self.expected.keys()) != members.keys()

    def note(self, name: str, presence: TokenPresence, frame: int, members: Collection[str]) -> str:
        """Note that a node has gone, has appeared, or both; returns why the run must end, or "".

        members: of the current epoch, those that have taken part
        """
        if name == self.own:  # the driver's own token may come late
            return ""
        problem = self._lose(name, frame, members) if presence.gone else ""
        if presence.present:
            self.alive.add(name)
            self.leaving.discard(name)
            if self._was_lost(name):
                self.churn.append({"frame": frame, "node": name, "what": BACK})
        return problem

    def begin_epoch(self) -> dict[str, str]:
        """The members of a new epoch; returned nodes may join the next one."""
        members = self.present
        self.replaced.clear()
        return members

    def _lose(self, name: str, frame: int, members: Collection[str]) -> str:
        self.alive.discard(name)
        self.replaced.add(name)
        if name not in members or name not in self.expected or name in self.leaving:
            return ""
        if self._was_lost(name):  # it was back too briefly for the driver to notice
            self.churn.append({"frame": frame, "node": name, "what": BACK})
        self.churn.append({"frame": frame, "node": name, "what": LOST})
        lost_too_often = sum(event["node"] == name for event in self.churn) > 2 * MAX_LOSSES
        return f"{name} was lost and came back more than {MAX_LOSSES} times" if lost_too_often else ""

    def _was_lost(self, name: str) -> bool:
        events = [event["what"] for event in self.churn if event["node"] == name]
        return events[-1:] == [LOST]


class Timetable:
    """The process steps of a run.

    lockstep: whether every node is waited for, so that none can be paused or cut off

    Raises ConfigurationError for steps that are not possible.
    """

    def __init__(self, resolved: Resolved, *, lockstep: bool) -> None:
        known = list(resolved.nodes)
        self._steps: dict[int, list[ProcessStep]] = {}
        first_action: dict[str, str] = {}
        for step in sorted(resolved.steps, key=lambda step: step.frame):
            where = f"steps: frame {step.frame}: {step.action} {step.node}"
            if step.node not in known:
                raise ConfigurationError(f"{where}: there is no such node{nearest(step.node, known)}")
            if step.action not in ACTIONS:
                raise ConfigurationError(
                    f"{where}: expected one of {', '.join(ACTIONS)}{nearest(step.action, ACTIONS)}"
                )
            if resolved.nodes[step.node].role == DRIVER_ROLE:
                raise ConfigurationError(f"{where}: the run ends without the node that drives the scene")
            if lockstep and step.action in REALTIME:
                raise ConfigurationError(
                    f"{where}: in lock-step every node is waited for; use {step.action} in real time"
                )
            self._steps.setdefault(max(0, step.frame), []).append(step)
            first_action.setdefault(step.node, step.action)
        #: nodes that start later
        self.absent = frozenset(node for node, action in first_action.items() if action == "start")

    def __bool__(self) -> bool:
        return bool(self._steps)

    def before(self, frame: int, present: Container[str] | None = None) -> Iterator[list[ProcessStep]]:
        """The steps before a frame in groups, those that end a node first; sorted by node.

        present: the running nodes, evaluated for each group: a running node is not started, and one that is not running
                 gets no other step; None: unknown
        """
        for leaving in (True, False):
            group = [step for step in self._steps.get(frame, ()) if (step.action in LEAVING) == leaving]
            if present is not None:
                group = [step for step in group if (step.node in present) != (step.action == "start")]
            if group:
                yield sorted(group, key=lambda step: step.node)
