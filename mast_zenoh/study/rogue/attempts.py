"""What an outsider can try against a run. Each attempt is really made; what comes of it is counted, not judged.

A scenario file's `outsider()` lists attempts as dicts: dict(type="Inject", name="no certificate", shows="nothing", …).
Subclasses of Attempt in that file can be named as well.
"""

from __future__ import annotations

import json
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar

import zenoh

from mast_zenoh.runtime.mesh.session import open_router
from mast_zenoh.security.credentials import ROUTER
from mast_zenoh.security.levels import endpoint, router_settings
from mast_zenoh.study.rogue.siege import NOTHING, Siege

_MATCH_S = 1.0
_FLUSH_S = 0.3
_LURE_S = 3.0
_BACK_S = 10.0


@dataclass
class Outcome:
    """What came of one attempt.

    admitted: whether the outsider got a session on the mesh
    sent:     messages sent to `key`; reached: how often a node's host has got one of them, of `expected` if all went
    heard:    samples (or answers) overheard
    lured:    nodes that have talked to a router of the outsider's
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
        """Whether anything got in, out, or onto the wrong way."""
        return bool(self.reached or self.heard or self.lured)


class Attempt(ABC):
    """Base of all attempts.

    name:  what the table calls it
    shows: what the outsider shows: "nothing", "foreign", "expired", or the name of a node whose certificate he has
    """

    #: the node whose way to the router the outsider must hold
    detours: str | None = None
    #: whether what he shows decides about him: where nobody asks for it he just joins
    by_certificate: ClassVar[bool] = True

    def __init__(self, name: str, shows: str = NOTHING) -> None:
        self.name = name
        self.shows = shows

    @property
    def key(self) -> str:
        """The key on which forged messages are sent, of this attempt alone, for they are counted by it; or ""."""
        return ""

    @abstractmethod
    def make(self, siege: Siege) -> Outcome:
        """Try it, and say what was seen of it at once; `reached` is counted when the run has ended."""


class Inject(Attempt):
    """Send forged messages on a wire.

    wire: its key, without the run's prefix; messages: how many
    """

    def __init__(self, name: str, wire: str, shows: str = NOTHING, messages: int = 20) -> None:
        super().__init__(name, shows)
        self.wire = wire
        self.messages = messages

    @property
    def key(self) -> str:
        """See Attempt."""
        return self.wire

    def make(self, siege: Siege) -> Outcome:
        """See Attempt."""
        with _admitted(siege, self.shows) as session:
            return self.send(siege, session)

    def send(self, siege: Siege, session: zenoh.Session | None) -> Outcome:
        """Send them through a session, if there is one."""
        outcome = Outcome(session is not None, self.wire, expected=self.messages * siege.hearers(self.wire))
        if session is not None:
            outcome.sent = forge(siege, session, self.wire, self.messages)
        return outcome


class DuplicateSession(Inject):
    """Join with the Zenoh id of a node that is there, and speak as it would.

    node: whose id
    """

    by_certificate = False

    def __init__(self, name: str, wire: str, node: str, shows: str = NOTHING, messages: int = 20) -> None:
        super().__init__(name, wire, shows, messages)
        self.node = node

    def make(self, siege: Siege) -> Outcome:
        """See Attempt."""
        with _admitted(siege, self.shows, siege.zid(self.node)) as session:
            return self.send(siege, session)


class Eavesdrop(Attempt):
    """Subscribe to a key expression, of the whole mesh, and listen.

    keys: the expression; `{run}` in it stands for the run's prefix; seconds: how long
    """

    by_certificate = False

    def __init__(self, name: str, keys: str, shows: str = NOTHING, seconds: float = 1.5) -> None:
        super().__init__(name, shows)
        self.keys = keys
        self.seconds = seconds

    def make(self, siege: Siege) -> Outcome:
        """See Attempt."""
        with _admitted(siege, self.shows) as session:
            if session is None:
                return Outcome()
            heard = _Count()
            subscriber = session.declare_subscriber(self.keys.replace("{run}", siege.prefix), heard.callback())
            threading.Event().wait(self.seconds)
            subscriber.undeclare()
            return Outcome(True, heard=heard.total)


class AskRouter(Attempt):
    """Ask the router's admin space who is there, and who speaks on which key."""

    by_certificate = False

    def make(self, siege: Siege) -> Outcome:
        """See Attempt."""
        with _admitted(siege, self.shows) as session:
            if session is None:
                return Outcome()
            replies = [reply.ok for reply in session.get("@/**", timeout=1.0) if reply.ok is not None]
            own = f"@/{session.info.zid()}/"  # every session answers for itself
            return Outcome(True, heard=sum(not str(reply.key_expr).startswith(own) for reply in replies))


class RogueRouter(Attempt):
    """Turn the way of a node to the router: to a router of one's own, which is a client of the real one.

    node: whose way; wire: what is forged towards it; shows: whose certificate the rogue has, as a router too
    """

    by_certificate = False

    def __init__(self, name: str, node: str, wire: str, shows: str = NOTHING, messages: int = 20) -> None:
        super().__init__(name, shows)
        self.node = node
        self.wire = wire
        self.messages = messages
        self.detours = node

    @property
    def key(self) -> str:
        """See Attempt."""
        return self.wire

    def make(self, siege: Siege) -> Outcome:
        """See Attempt."""
        outcome = Outcome(key=self.wire, expected=self.messages * siege.hearers(self.wire))
        detour = siege.detours[self.node]
        session, address = open_router(endpoint(siege.level, "tcp/127.0.0.1:0"), security=self._settings(siege))
        with session:
            said = _Count()
            spied = session.declare_subscriber(f"{siege.prefix}/agent/{self.node}/*", said.callback())
            detour.turn(int(address.rpartition(":")[2]))
            try:
                if siege.wait(lambda: _clients(session), _LURE_S):
                    outcome.lured = _clients(session)
                    outcome.admitted = True
                    siege.wait(lambda: said.total, _LURE_S)
                    outcome.heard = said.total
                    outcome.sent = forge(siege, session, self.wire, self.messages)
            finally:
                spied.undeclare()
                detour.turn(None)
        before = siege.frame
        siege.wait(lambda: siege.frame > before, _BACK_S, "the run goes on")
        return outcome

    def _settings(self, siege: Siege) -> dict[str, Any]:
        """A router that passes everything on to the real one, with the best certificate that the outsider has."""
        upstream = {"connect/endpoints": [siege.endpoint], "connect/exit_on_failure": False, "connect/timeout_ms": 0}
        if siege.level == "open":
            return upstream
        credentials = siege.credentials(self.shows)
        if credentials is None or not credentials.certificate:
            credentials = siege.foreign.issue(ROUTER, ["127.0.0.1"])
        return upstream | router_settings("tls", credentials)


def forge(siege: Siege, session: zenoh.Session, key: str, messages: int) -> int:
    """Send forged messages, and give them time to arrive; how many.

    They are put, not published: a publisher would keep to itself what nobody is known to hear.
    """
    for _ in range(messages):
        session.put(
            f"{siege.prefix}/{key}",
            siege.forged(key),
            congestion_control=zenoh.CongestionControl.BLOCK,
            express=True,
        )
    threading.Event().wait(_FLUSH_S)
    return messages


@contextmanager
def _admitted(siege: Siege, shows: str, zid: str | None = None) -> Iterator[zenoh.Session | None]:
    """A session on the mesh, or None where it is refused."""
    try:
        session = siege.join(shows, zid)
    except zenoh.ZError:
        yield None
        return
    with session:
        yield session


def _clients(session: zenoh.Session) -> int:
    """How many clients a router in this process has."""
    for reply in session.get(f"@/{session.info.zid()}/router", timeout=1.0):
        if reply.ok is not None:
            sessions = json.loads(reply.ok.payload.to_bytes())["sessions"]
            return sum(each["whatami"] == "client" for each in sessions)
    return 0


class _Count:
    """Counts samples, in Zenoh's own thread."""

    def __init__(self) -> None:
        self.total = 0

    def callback(self) -> Any:
        """For a subscriber."""
        return zenoh.handlers.Callback(self._take, indirect=False)

    def _take(self, _: zenoh.Sample) -> None:
        self.total += 1
