"""How the wiring of a running mesh changes: what each node does, and how the driver leads them through it.

A change takes two epochs. In the first everybody learns of it: who is to hear a new key subscribes to it, and who is
to publish on a new key declares that. When all have said that they have, the second begins, and publishers switch to
their new keys, each between two of its own messages. In lock-step both begin while the mesh is quiet. In real time
frames go on, and a publisher that is to go around a node (which is released) holds its messages back until that node
has passed on all that it got: the question travels behind the last message on the same way, and the answer behind
what came of it.

    @control/rewire          launcher → driver      a query: the new wiring, who joins, who leaves; answered when done
    @control/drain/{node}    node → node            a query: have you passed on all that I sent on this key?
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import zenoh

from mast_zenoh.control import flow
from mast_zenoh.control.flow import WiringUpdate
from mast_zenoh.errors import MessageError
from mast_zenoh.messages import codec
from mast_zenoh.wiring.insertion import taps_into
from mast_zenoh.wiring.model import Wiring

if TYPE_CHECKING:
    from mast_zenoh.runtime.mesh.driver import Driver
    from mast_zenoh.runtime.mesh.node import MeshNode

DRAIN_TIMEOUT_S = 2.0  #: how long a publisher holds back its messages for a node that does not answer
MAX_ASKED = 64  #: questions whether all is passed on that wait for an answer at one node
CHANGE_TIMEOUT_S = 20.0  #: how long everybody may take to learn of a change


class Outlet:
    """One output of a node on its way out. Its host knows it by the key that it had when the node was started.

    key: the key that it has now;  newest: the message that went out last
    """

    def __init__(self, key: str, publisher: zenoh.Publisher) -> None:
        self.key = key
        self.publisher = publisher
        self.newest: bytes | None = None
        self._kept: list[tuple[bytes, bytes]] | None = None

    def put(self, payload: bytes, attachment: bytes) -> None:
        """Send a message, or keep it while messages are held back."""
        self.newest = payload
        if self._kept is None:
            self.publisher.put(payload, attachment=attachment)
        else:
            self._kept.append((payload, attachment))

    def hold_back(self) -> None:
        """Keep messages until the outlet moves."""
        self._kept = []

    def move(self, key: str, publisher: zenoh.Publisher) -> int:
        """Send on another key from now on, first what was held back. Returns how many messages that were."""
        before, self.key, self.publisher = self.publisher, key, publisher
        kept, self._kept = self._kept or [], None
        for payload, attachment in kept:
            publisher.put(payload, attachment=attachment)
        before.undeclare()
        return len(kept)


class Rewiring:
    """One node's part in a change of the wiring.

    leaving: whether it is about to leave: it takes part in no further epoch, but takes what comes until it goes
    """

    def __init__(self, node: MeshNode, base: str) -> None:
        self._node = node
        self._base = base
        self.leaving = False
        self._next: dict[str, tuple[str, zenoh.Publisher]] = {}  # by outlet: its next key and publisher
        self._draining: dict[str, float] = {}  # outlets that hold back, since when
        self._asked: list[tuple[zenoh.Query, str, int]] = []  # with the key, and the frame in which it came
        self._questions = 0  # that have been taken up

    @property
    def busy(self) -> bool:
        """Whether an outlet still holds messages back."""
        return bool(self._draining)

    @property
    def asked(self) -> bool:
        """Whether somebody waits to hear that all is passed on."""
        return bool(self._asked)

    def follow(self, told: WiringUpdate) -> None:
        """Do what an epoch says."""
        self._prepare(told.wiring)
        self.leaving, self._questions = self._node.name in told.leaving, 0
        if self.leaving and self._node.lockstep:
            self._node.host.flush()
        if told.active:
            self._switch(told)

    def handle(self, event: tuple[Any, ...]) -> None:
        """An event from the inbox that concerns the wiring."""
        kind, *rest = event
        if kind == "drain":
            self._node.host.flush()
            self._asked.append((*rest, self._node.host.frame))
        elif kind == "drained":
            self._go_on(*rest)

    def take_question(self, query: zenoh.Query) -> None:
        """Somebody asks whether all is passed on, in Zenoh's thread.

        While this node is to leave, whoever sends it something may ask. Any other question waits nowhere.
        """
        try:
            key = flow.decode_drain(query.payload.to_bytes() if query.payload else b"")
            if not self.leaving:
                raise MessageError(f"drain: {self._node.name} has not been told to leave")
            if key not in taps_into(self._node.wiring, (self._node.name,)):
                raise MessageError(f"drain: found {key!r:.80}, which {self._node.name} is not on")
            if self._questions >= MAX_ASKED:
                raise MessageError(f"drain: more than {MAX_ASKED} questions")
            self._questions += 1
        except MessageError as error:
            self._node.invalid.note(f"drain/{self._node.name}", error)
            query.drop()
        else:
            self._node.inbox.put(("drain", query, key))

    def answer(self) -> None:
        """Tell those who have asked whether all is passed on, as soon as it is."""
        if not self._asked:
            return
        still = []
        for query, key, frame in self._asked:
            if self._passed_on(key, frame):
                query.reply(query.key_expr, b"")
                query.drop()
            else:
                still.append((query, key, frame))
        self._asked = still

    def _prepare(self, wiring: Wiring) -> None:
        """Hear what is new, and declare what is to be published on other keys than now."""
        node = self._node
        ports = wiring.ports(node.name)
        for key, heard in ports.inputs.items():
            if key not in node.host.hears:
                node.host.hear(key, heard)
                node.hear(key)
        types = {leg.key: wire.message for wire, leg in wiring.legs()}
        new = []
        for end, outlet_key in node.ports.outputs.items():
            outlet, key = node.outlets[outlet_key], ports.outputs.get(end, "")
            if outlet_key in self._draining or key == self._next.get(outlet_key, (outlet.key,))[0]:
                continue
            if outlet_key in self._next:  # a change that was called off
                self._next.pop(outlet_key)[1].undeclare()
            if key not in ("", outlet.key):
                self._next[outlet_key] = key, node.declare_publisher(key, types[key])
                new.append(self._next[outlet_key][1])
        if new:
            node.await_listeners(new)

    def _switch(self, told: WiringUpdate) -> None:
        """Publish on the new keys: at once, or when the node in between has passed on what it got."""
        node = self._node
        taps = {} if node.lockstep else taps_into(node.wiring, told.leaving)
        for outlet_key in [key for key in self._next if key not in self._draining]:
            between = taps.get(node.outlets[outlet_key].key)
            if between is None:
                self._move(outlet_key)
            else:
                node.outlets[outlet_key].hold_back()
                self._draining[outlet_key] = time.monotonic()
                self._ask(between, outlet_key)
        node.wiring = told.wiring

    def _ask(self, between: str, outlet_key: str) -> None:
        """Ask a node whether it has passed on what it got. The query goes the way of the messages, behind them."""
        put, answers = self._node.inbox.put, list[zenoh.Reply]()
        handler: Any = zenoh.handlers.Callback(
            answers.append, lambda: put(("drained", outlet_key, between, any(a.ok for a in answers))), indirect=False
        )
        self._node.session.get(
            f"{self._base}/@control/drain/{between}",
            handler,
            payload=self._node.outlets[outlet_key].key,
            timeout=DRAIN_TIMEOUT_S,
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.DATA,
            express=True,
        )

    def _go_on(self, outlet_key: str, between: str, answered: bool) -> None:
        """The node in between has passed on everything, or does not answer."""
        held_s = time.monotonic() - self._draining.pop(outlet_key)
        kept = self._move(outlet_key)
        if answered:
            self._node.host.log.info("%d messages waited %.1f ms for %s", kept, held_s * 1e3, between)
        else:
            self._node.host.log.warning(
                "%s has not said within %.1f s that it has passed on what it got: that may be lost; %d messages waited",
                *(between, held_s, kept),
            )
        self._node.report()

    def _move(self, outlet_key: str) -> int:
        return self._node.outlets[outlet_key].move(*self._next.pop(outlet_key))

    def _passed_on(self, key: str, asked_in: int) -> bool:
        """Whether what came on a key has been dealt with.

        It has if the newest message has gone out again. If it has not, the node has dropped it, or keeps it: until the
        next clock, because nobody may keep a message for longer.
        """
        node = self._node
        if node.host.waiting:
            return False
        if node.host.frame > asked_in or not node.host.clocked or key not in node.newest:
            return True
        for wire in node.wiring.wires:
            for leg, onward in zip(wire.legs, wire.legs[1:], strict=False):
                if leg.key == key:
                    outlet_key = node.ports.outputs.get((onward.publisher.port, wire.subject))
                    out = node.outlets[outlet_key].newest if outlet_key else None
                    return _number(node.newest[key], wire.message) == _number(out, wire.message)
        return True


def _number(payload: bytes | None, message: str) -> int | None:
    """The sequence number of a message; None for what is none."""
    try:
        return None if payload is None else codec.decode_header(payload, message).seq
    except MessageError:
        return None


@dataclass
class Change:
    """A change of the wiring that has been asked for; frame: the first that may go the new way."""

    wiring: Wiring
    join: dict[str, str]
    leave: tuple[str, ...]
    query: zenoh.Query
    asked: float = field(default_factory=time.monotonic)
    begun: float = 0.0
    frame: int = 0

    def reply(self, **answer: Any) -> None:
        """Say what has become of it."""
        self.query.reply(self.query.key_expr, flow.encode_rewired(**answer))
        self.query.drop()


class Rewirer:
    """The driver's part in a change of the wiring: one change at a time, through both epochs."""

    def __init__(self, driver: Driver) -> None:
        self._driver = driver
        self._asked: deque[Change] = deque()
        self._change: Change | None = None
        self._since = 0.0  # when the current epoch of the change began
        self.told: WiringUpdate | None = None  # what every epoch says since the first change

    def ask(self, query: zenoh.Query) -> None:
        """Take up a change as soon as those before it are done; in Zenoh's thread: what is none waits nowhere."""
        try:
            payload = query.payload.to_bytes() if query.payload else b""
            told = self._driver.signatures.open("rewire", payload, flow.decode_rewire)
            if len(self._asked) >= MAX_ASKED:
                raise MessageError(f"rewire: more than {MAX_ASKED} changes wait")
        except MessageError as error:
            self._driver.invalid.note("rewire", error)
            query.drop()
        else:
            self._asked.append(Change(*told, query))
            self._driver.inbox.put(("rewire",))

    def turn(self) -> bool:
        """Go on with the change as far as it goes; whether it waits for what everybody says."""
        driver, change = self._driver, self._change
        if change is None:
            return self._begin()
        assert self.told is not None
        late = time.monotonic() - self._since > CHANGE_TIMEOUT_S
        if not self.told.active and not change.join.keys() <= driver.alive:
            return self._call_off(change, f"{', '.join(change.join)} ended before it took part")
        if driver.pacer.silent or driver.rewiring.busy:
            if late and not self.told.active:
                return self._call_off(change, f"not ready within {CHANGE_TIMEOUT_S:.0f} s: {self._missing()}")
            if not late:
                return True
            driver.host.log.warning("the wiring has changed, but not a word from %s", self._missing())
        if not self.told.active:
            for name in change.leave:
                driver.expected.pop(name, None)
            change.frame = driver.frames  # in real time the next may begin before all have said that they have switched
            self._epoch(WiringUpdate(change.wiring, True, change.leave))
            return True
        self.told = WiringUpdate(change.wiring, True)
        self._change = None
        change.reply(frame=change.frame, took_ms=round((time.monotonic() - change.begun) * 1e3, 3))
        return self._begin()

    def _begin(self) -> bool:
        """Take up the next change; those who join must be there."""
        if not self._asked:
            return False
        change = self._asked[0]
        if not change.join.keys() <= self._driver.alive:
            if time.monotonic() - change.asked > CHANGE_TIMEOUT_S:
                self._asked.popleft().reply(error=f"{', '.join(change.join)} is not there")
            return False
        self._change = self._asked.popleft()
        change.begun = time.monotonic()
        self._driver.expected |= change.join
        self._epoch(WiringUpdate(change.wiring, False, change.leave))
        return True

    def _call_off(self, change: Change, why: str) -> bool:
        """Everything stays as it was: nobody has switched yet."""
        for name in change.join:
            self._driver.expected.pop(name, None)
        self._change = None
        self._epoch(WiringUpdate(self._driver.wiring, True))
        change.reply(error=why)
        return False

    def _epoch(self, told: WiringUpdate) -> None:
        self.told = told
        self._since = time.monotonic()
        self._driver.begin_epoch_of(told)

    def _missing(self) -> str:
        return ", ".join(sorted(self._driver.pacer.silent)) or self._driver.name


def counted(sent: Mapping[str, int], outlets: Mapping[str, Outlet]) -> dict[str, int]:
    """Messages by the keys that they were sent on, from those by the keys that the host knows."""
    return {outlets[key].key if key in outlets else key: n for key, n in sent.items()}
