"""Attacks by an outsider. Each one is carried out, and its effects are counted.

A scenario file's `outsider()` lists attempts as dicts: dict(type="Inject", name="no certificate", shows="nothing", …).
The file may define its own subclasses of Attempt.
"""

from __future__ import annotations

import json
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import zenoh

from mast_zenoh.arrays.states import CLASS_INDEX, ObjectStates
from mast_zenoh.errors import ConfigurationError, MessageError
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header, Message
from mast_zenoh.runtime.mesh.session import open_router
from mast_zenoh.security.credentials import ROUTER
from mast_zenoh.security.levels import endpoint, router_settings
from mast_zenoh.streams import stream
from mast_zenoh.study.outsider.attacked_run import NOTHING, AttackedRun

_FLUSH_S = 0.5
_LURE_S = 3.0
_FRAME_S = 10.0
#: Variances of a false track: x y z l w h vx vy vz.
_VARIANCE = np.diag([0.04] * 3 + [0.02] * 3 + [0.5] * 3)


@dataclass
class Outcome:
    """The effects of one attempt.

    admitted: whether the outsider got a session on the mesh
    sent:     messages sent to `key`; reached: how many deliveries to hosts there were, of `expected` if none is lost
    heard:    samples (or replies) overheard
    lured:    nodes that connected to the outsider's router
    """

    admitted: bool = False
    key: str = ""
    sent: int = 0
    reached: int = 0
    expected: int = 0
    heard: int = 0
    lured: int = 0

    @property
    def succeeded(self) -> bool:
        """Whether any message was injected, overheard or diverted."""
        return bool(self.reached or self.heard or self.lured)


class Attempt(ABC):
    """Base class of attempts.

    name:  its name in the table
    shows: the credentials presented: "nothing", "foreign", "expired", or the name of a node whose certificate is used
    """

    #: the node whose connection to the router must pass through the outsider
    detour_node: str | None = None
    #: whether the outcome depends on the credentials, on meshes that require them
    by_certificate: ClassVar[bool] = True

    def __init__(self, name: str, shows: str = NOTHING) -> None:
        self.name = name
        self.shows = shows

    @property
    def key(self) -> str:
        """The key of its forged messages, unique among attempts to count them; or ""."""
        return ""

    @abstractmethod
    def make(self, attacked_run: AttackedRun) -> Outcome:
        """Carry out the attempt; returns its effects except `reached`, counted later."""


class Inject(Attempt):
    """Send forged messages on a wire.

    wire: its key, without the run's prefix; messages: their number
    """

    def __init__(self, name: str, wire: str, shows: str = NOTHING, messages: int = 20) -> None:
        super().__init__(name, shows)
        self.wire = wire
        self.messages = messages

    @property
    def key(self) -> str:
        return self.wire

    def make(self, attacked_run: AttackedRun) -> Outcome:
        with _admitted(attacked_run, self.shows) as session:
            return self.send(attacked_run, session)

    def send(self, attacked_run: AttackedRun, session: zenoh.Session | None) -> Outcome:
        """Send the messages through a session; None: the outsider was refused."""
        outcome = Outcome(
            session is not None, self.wire, expected=self.messages * attacked_run.subscriber_count(self.wire)
        )
        if session is not None:
            outcome.sent = forge(attacked_run, session, self.wire, self.messages)
        return outcome


class DuplicateSession(Inject):
    """Join with the Zenoh id of a running node and send messages in its name.

    node: the node with this id
    """

    by_certificate = False

    def __init__(self, name: str, wire: str, node: str, shows: str = NOTHING, messages: int = 20) -> None:
        super().__init__(name, wire, shows, messages)
        self.node = node

    def make(self, attacked_run: AttackedRun) -> Outcome:
        with _admitted(attacked_run, self.shows, attacked_run.zid(self.node)) as session:
            return self.send(attacked_run, session)


class Eavesdrop(Attempt):
    """Subscribe to a key expression on the whole mesh and count samples.

    keys: the expression, in which `{run}` stands for the run's prefix; seconds: duration
    """

    by_certificate = False

    def __init__(self, name: str, keys: str, shows: str = NOTHING, seconds: float = 1.5) -> None:
        super().__init__(name, shows)
        self.keys = keys
        self.seconds = seconds

    def make(self, attacked_run: AttackedRun) -> Outcome:
        with _admitted(attacked_run, self.shows) as session:
            if session is None:
                return Outcome()
            counter = _SampleCounter()
            subscriber = session.declare_subscriber(self.keys.replace("{run}", attacked_run.prefix), counter.callback())
            threading.Event().wait(self.seconds)
            subscriber.undeclare()
            return Outcome(True, heard=counter.total)


class AskRouter(Attempt):
    """Query the router's admin space for sessions and their keys."""

    by_certificate = False

    def make(self, attacked_run: AttackedRun) -> Outcome:
        with _admitted(attacked_run, self.shows) as session:
            if session is None:
                return Outcome()
            replies = [reply.ok for reply in session.get("@/**", timeout=1.0) if reply.ok is not None]
            own_prefix = f"@/{session.info.zid()}/"  # every session also replies about itself
            return Outcome(True, heard=sum(not str(reply.key_expr).startswith(own_prefix) for reply in replies))


class RogueRouter(Inject):
    """Redirect a node's connection to a rogue router, itself a client of the real one.

    node: the redirected node; wire: key of messages forged for it; shows: credentials of the rogue router
    """

    by_certificate = False

    def __init__(self, name: str, node: str, wire: str, shows: str = NOTHING, messages: int = 20) -> None:
        super().__init__(name, wire, shows, messages)
        self.node = self.detour_node = node

    def make(self, attacked_run: AttackedRun) -> Outcome:
        outcome = Outcome(key=self.wire, expected=self.messages * attacked_run.subscriber_count(self.wire))
        relay = attacked_run.detours[self.node]
        session, address = open_router(
            endpoint(attacked_run.level, "tcp/127.0.0.1:0"), security=self._settings(attacked_run)
        )
        with session:
            overheard = _SampleCounter()
            subscriber = session.declare_subscriber(f"{attacked_run.prefix}/agent/{self.node}/*", overheard.callback())
            relay.redirect(int(address.rpartition(":")[2]))
            try:
                if attacked_run.wait(lambda: _clients(session), _LURE_S):
                    outcome.lured = _clients(session)
                    outcome.admitted = True
                    attacked_run.wait(lambda: overheard.total, _LURE_S)
                    outcome.heard = overheard.total
                    outcome.sent = forge(attacked_run, session, self.wire, self.messages)
            finally:
                subscriber.undeclare()
                relay.redirect(None)
        _wait_for_next_frame(attacked_run)
        return outcome

    def _settings(self, attacked_run: AttackedRun) -> dict[str, Any]:
        """Settings of a router that forwards to the real one, with the best certificate."""
        upstream = {
            "connect/endpoints": [attacked_run.endpoint],
            "connect/exit_on_failure": False,
            "connect/timeout_ms": 0,
        }
        if attacked_run.level == "open":
            return upstream
        credentials = attacked_run.credentials(self.shows)
        if credentials is None or not credentials.certificate:
            credentials = attacked_run.foreign.issue(ROUTER, ["127.0.0.1"])
        return upstream | router_settings("tls", credentials)


class Sybil(Attempt):
    """Send tracks in the name of an agent that does not run: one message a frame, with valid headers.

    On an open mesh the broker takes it for an agent that joins, and collates its tracks. The broker subscribes to the
    agents of the scenario by name, so an agent that no scenario has is heard nowhere. With ACLs nobody but the agent
    itself may publish on its keys.

    identity: name of the agent; objects: number of standing vehicles that it claims, within `spread_m` of the origin
    messages: number of frames; seed: of the places
    The outcome's `heard` is the number of the broker's batches with tracks of this agent that the outsider overheard.
    """

    def __init__(
        self,
        name: str,
        identity: str,
        shows: str = NOTHING,
        objects: int = 3,
        spread_m: float = 30.0,
        messages: int = 10,
        seed: int = 0,
    ) -> None:
        super().__init__(name, shows)
        if objects < 0 or messages < 1:
            raise ValueError(f"objects, messages: found {objects}, {messages}, expected 0 and 1 or more")
        self.identity = identity
        self.messages = messages
        position = stream(seed, "sybil", identity).uniform(-spread_m, spread_m, (objects, 3))
        position[:, 2] = 0.8
        self._states = ObjectStates.of(
            position,
            size=np.tile([4.4, 1.8, 1.6], (objects, 1)),
            covariance=np.tile(_VARIANCE, (objects, 1, 1)),
            class_id=np.full(objects, CLASS_INDEX["car"], np.uint8),
        )

    @property
    def key(self) -> str:
        return f"agent/{self.identity}/tracks"

    def make(self, attacked_run: AttackedRun) -> Outcome:
        with _admitted(attacked_run, self.shows) as session:
            outcome = Outcome(session is not None, self.key, expected=self.messages * self._receivers(attacked_run))
            if session is not None:
                batches = _SampleCounter(self._is_fused)
                subscriber = session.declare_subscriber(f"{attacked_run.prefix}/cc/collated", batches.callback())
                for number in range(self.messages):
                    _wait_for_next_frame(attacked_run)
                    message = self.message(attacked_run.frame, attacked_run.period_ns, number)
                    _put(attacked_run, session, self.key, codec.encode(message))
                    outcome.sent += 1
                threading.Event().wait(_FLUSH_S)
                subscriber.undeclare()
                outcome.heard = batches.total
        return outcome

    def message(self, frame: int, period_ns: int, number: int) -> Message:
        """The tracks of a frame, in the world frame."""
        header = Header("tracks", self.identity, frame, frame * period_ns, number)
        reference = {"origin": np.zeros(3), "rotation": np.array([1.0, 0.0, 0.0, 0.0])}
        return codec.conform(header, self._states.columns() | reference)

    def _receivers(self, attacked_run: AttackedRun) -> int:
        """The number of nodes that receive its messages."""
        try:
            return attacked_run.subscriber_count(self.key)
        except ConfigurationError:  # no scenario has this agent
            return 0

    def _is_fused(self, sample: zenoh.Sample) -> bool:
        """Whether a batch of the broker has tracks of this agent."""
        try:
            return self.identity in codec.decode(sample.payload.to_bytes(), "collated").body["agents"].tolist()
        except MessageError:  # of another outsider
            return False


def forge(attacked_run: AttackedRun, session: zenoh.Session, key: str, messages: int) -> int:
    """Send forged messages and wait until they may have arrived; returns their number."""
    for _ in range(messages):
        _put(attacked_run, session, key, attacked_run.forged_message(key))
    threading.Event().wait(_FLUSH_S)
    return messages


def _put(attacked_run: AttackedRun, session: zenoh.Session, key: str, payload: bytes) -> None:
    """Send a message, not through a declared publisher: it would send none on keys without known subscribers."""
    session.put(f"{attacked_run.prefix}/{key}", payload, congestion_control=zenoh.CongestionControl.BLOCK, express=True)


def _wait_for_next_frame(attacked_run: AttackedRun) -> None:
    last = attacked_run.frame
    attacked_run.wait(lambda: attacked_run.frame > last, _FRAME_S, "the run continues")


@contextmanager
def _admitted(attacked_run: AttackedRun, shows: str, zid: str | None = None) -> Iterator[zenoh.Session | None]:
    """A session on the mesh, or None if it is refused."""
    try:
        session = attacked_run.join(shows, zid)
    except zenoh.ZError:
        yield None
        return
    with session:
        yield session


def _clients(session: zenoh.Session) -> int:
    """The number of clients of a router in this process."""
    for reply in session.get(f"@/{session.info.zid()}/router", timeout=1.0):
        if reply.ok is not None:
            sessions = json.loads(reply.ok.payload.to_bytes())["sessions"]
            return sum(each["whatami"] == "client" for each in sessions)
    return 0


class _SampleCounter:
    """Counts samples, in Zenoh's own thread; counts: which of them."""

    def __init__(self, counts: Callable[[zenoh.Sample], bool] = lambda _: True) -> None:
        self.total = 0
        self._counts = counts

    def callback(self) -> Any:
        """The callback for a subscriber."""
        return zenoh.handlers.Callback(self._count, indirect=False)

    def _count(self, sample: zenoh.Sample) -> None:
        self.total += self._counts(sample)
