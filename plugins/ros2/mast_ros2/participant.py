"""A node of ROS 2 on a router of rmw_zenoh: it publishes, subscribes, and knows who else is in its domain.

What others send is untrusted: what is not a message of rmw_zenoh is counted by reason, logged once for each topic, and
dropped. Peers whose type or hash differs are silent on a mesh; their tokens tell of them.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import re
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, Self

import zenoh
import zenoh.ext

from mast_ros2 import type_store
from mast_ros2.attachments import MessageAttachment, gid_of, parse_attachment
from mast_ros2.liveliness_tokens import (
    ALL_DOMAINS,
    DataKey,
    EndpointToken,
    NodeToken,
    Qos,
    all_tokens,
    parse_token,
    ros2_name,
    tokens_of,
)
from mast_ros2.mesh import Connection
from mast_ros2.type_store import RosMessage
from mast_zenoh.errors import MessageError, NotRunning
from mast_zenoh.mesh.session import open_session
from mast_zenoh.outside import OutsideTopic

log = logging.getLogger("mast.ros2")

#: Called with each valid message, or with the bytes of each message, in a thread of Zenoh.
Handler = Callable[[RosMessage, MessageAttachment], None]
BytesHandler = Callable[[bytes, MessageAttachment], None]

#: Bytes of a message, if a subscriber says nothing else: a larger one is refused unread.
MOST_BYTES = 1 << 24
#: Tokens that are remembered. Of a domain with more, the rest is counted, and not known; but of each topic on which the
#: node itself publishes or subscribes, some are remembered always.
MOST_TOKENS, MOST_TOKENS_OF_TOPIC = 10_000, 256
#: Reasons that are told apart in counts and warnings: peers choose the words of some.
MOST_REASONS = 50

#: The names of ROS 2 nodes that are nodes of a run begin with it.
MAST_PREFIX = "mast_"

#: s, in which a router must have answered.
_CONNECT_S = 5.0
#: s, for which a peer that takes nothing is waited for; then its link ends. As in rmw_zenoh's own settings.
_PATIENCE_S = 60.0

_QOS = Qos()
_SETTINGS: dict[str, Any] = {
    "mode": "client",
    "connect/timeout_ms": round(1000 * _CONNECT_S),
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
    "timestamping/enabled": True,  # the caches of those that keep messages need it
    "transport/link/tx/lease": round(1000 * _PATIENCE_S),
    "transport/link/tx/queue/congestion_control/block/wait_before_close": round(1e6 * _PATIENCE_S),
}


class Publisher:
    """Publishes the messages of a topic, numbered from 1.

    token: what makes it known;  gid: its id in messages
    """

    def __init__(self, token: EndpointToken, session: zenoh.Session, qos: Qos, *, wait: bool) -> None:
        self.token = token
        self.gid = gid_of(token.write())
        self._sequence = 0
        self._alive = session.liveliness().declare_token(token.write())
        congestion = zenoh.CongestionControl.BLOCK if wait else zenoh.CongestionControl.DROP
        key = token.data_key.write()
        self._publisher: Any
        if qos.transient_local:
            self._publisher = zenoh.ext.declare_advanced_publisher(
                session,
                key,
                congestion_control=congestion,
                express=True,
                cache=zenoh.ext.CacheConfig(qos.depth),
                publisher_detection=True,
            )
        else:
            self._publisher = session.declare_publisher(key, congestion_control=congestion, express=True)

    @property
    def sent(self) -> int:
        """Number of messages that have been published."""
        return self._sequence

    @property
    def is_wanted(self) -> bool:
        """Whether anything subscribes to the topic, as far as the router has told; see `Participant.settle`."""
        return bool(self._publisher.matching_status.matching)

    def publish(self, message: RosMessage) -> None:
        """Publish a message of the topic's type."""
        self.publish_bytes(type_store.encode(message))

    def publish_bytes(self, payload: bytes) -> None:
        """Publish a message that is encoded already."""
        self._sequence += 1
        attachment = MessageAttachment(self._sequence, time.time_ns(), self.gid)
        self._publisher.put(payload, attachment=attachment.write())


class Participant:
    """A node of ROS 2, from `with` to its end; also the session of a node of a run, see `mast_zenoh.outside`.

    connection: its router and domain
    name, namespace: of the node
    wait:    whether messages wait for a peer that takes none, for a minute at most, or are dropped after a second

    refused: number of received messages and tokens that were dropped, by reason
    warnings: sentences about peers that cannot hear this node, or that it cannot hear

    Raises NotRunning if the router does not answer, with the reason, and ValueError for an invalid name.
    """

    def __init__(
        self, connection: Connection, name: str = "mast_bridge", namespace: str = "/", *, wait: bool = True
    ) -> None:
        self.connection = connection
        self.refused: Counter[str] = Counter()
        self.warnings: list[str] = []
        self._wait = wait
        self._declared: list[Any] = []
        self._announced: dict[str, Publisher] = {}
        self._endpoints: dict[str, list[EndpointToken]] = {}  # own ones, by topic
        self._n_endpoints = 0
        self._known: dict[str, NodeToken | EndpointToken] = {}
        self._of_topics: dict[tuple[str, str], dict[str, EndpointToken]] = {}  # of endpoints, by kind and topic
        self._is_complete = True  # no token has been forgotten
        self._lock = threading.Lock()
        self._logged: set[str] = set()
        NodeToken(connection.domain, "0", 0, name, namespace)  # checks the names before anything is opened
        self._session = _open(connection)
        try:
            self._node = NodeToken(connection.domain, str(self._session.zid()), 0, name, namespace)
            liveliness = self._session.liveliness()
            self._declared.append(liveliness.declare_token(self._node.write()))
            watch: Any = zenoh.handlers.Callback(self._on_token, indirect=False)
            self._declared.append(liveliness.declare_subscriber(all_tokens(connection.domain), watch, history=True))
        except BaseException:
            self._session.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def publisher(self, topic: str, type_name: str, qos: Qos = _QOS) -> Publisher:
        """A publisher of a topic; one that is `transient_local` keeps its messages for those that come late.

        Raises ValueError for an invalid topic, KeyError for an unknown type.
        """
        token = self._endpoint("publisher", topic, type_name, qos)
        publisher = Publisher(token, self._session, qos, wait=self._wait)
        self._declared.append(publisher)
        return publisher

    def subscribe(
        self, topic: str, type_name: str, handler: Handler, qos: Qos = _QOS, *, most_bytes: int = MOST_BYTES
    ) -> None:
        """Have a handler called with each message of a topic; raises as `publisher` does.

        most_bytes: of a message: a larger one is refused unread

        The handler must be quick: the messages of a session wait for each other.
        """

        def decoded(payload: bytes, attachment: MessageAttachment) -> None:
            handler(type_store.decode(type_name, payload), attachment)

        self.subscribe_bytes(topic, type_name, decoded, qos, most_bytes=most_bytes)

    def subscribe_bytes(
        self, topic: str, type_name: str, handler: BytesHandler, qos: Qos = _QOS, *, most_bytes: int = MOST_BYTES
    ) -> None:
        """Have a handler called with the bytes of each message of a topic, valid or not; otherwise as `subscribe`."""
        token = self._endpoint("subscription", topic, type_name, qos)
        take: Any = zenoh.handlers.Callback(
            lambda sample: self._take(token, handler, sample, most_bytes), indirect=True
        )
        key = token.data_key.write()
        subscriber: Any = (
            zenoh.ext.declare_advanced_subscriber(
                self._session,
                key,
                take,
                history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=qos.depth),
            )
            if qos.transient_local
            else self._session.declare_subscriber(key, take)
        )
        self._declared.append(subscriber)
        # Last: who sees it may expect that what it publishes arrives.
        self._declared.append(self._session.liveliness().declare_token(token.write()))

    def announce(self, topic: str, type_name: str) -> None:
        """Make a publisher of a topic, if there is none; raises as `publisher` does."""
        if topic not in self._announced:
            self._announced[topic] = self.publisher(topic, type_name)

    def send(self, topic: str, message: RosMessage) -> None:
        """Publish a message on an announced topic."""
        self._announced[topic].publish(message)

    def heard(self, topic: str) -> bool:
        """Whether anything subscribes to an announced topic, as far as the router has told."""
        return self._announced[topic].is_wanted

    def receive(self, topic: OutsideTopic, keep: Callable[[RosMessage, bytes], None]) -> None:
        """Have a function called with each message of a topic, and the gid of its publisher, another node's."""

        def foreign(message: RosMessage, attachment: MessageAttachment) -> None:
            if all(attachment.gid != publisher.gid for publisher in self._announced.values()):  # as on /tf
                keep(message, attachment.gid)

        qos = Qos(transient_local=topic.retained, depth=topic.depth)
        self.subscribe(topic.name, topic.type_name, foreign, qos, most_bytes=topic.most_bytes)

    def settle(self) -> None:
        """Wait until the router knows what has been declared, and has told which of it is wanted."""
        for _ in self._session.liveliness().get(self._node.write(), timeout=_CONNECT_S):
            pass  # a router answers in order

    @property
    def router(self) -> str:
        """The id of the router to which there is a link now; "": none, until a lost one is opened again."""
        return "".join(map(str, self._session.info.routers_zid()))

    def graph(self) -> list[NodeToken | EndpointToken]:
        """The nodes and endpoints of the domain that are known now, by their tokens; also its own."""
        with self._lock:
            return [self._known[token] for token in sorted(self._known)]

    def publishers_of(self, topic: str) -> list[EndpointToken]:
        """The publishers of a topic that others have, whatever their type."""
        return self._others("publisher", topic)

    def is_published(self, topic: str) -> bool:
        """Whether others have a publisher of a topic, whatever its type."""
        with self._lock:
            return any(map(self._is_other, self._of_topics.get(("publisher", topic), {}).values()))

    def absence(self, topic: str) -> str:
        """Why nothing can arrive on a topic to which this node subscribes, as a clause; "": others publish on it."""
        if not self.router:
            return f"the link to the router {self.connection.router} has ended"
        with self._lock:
            own = next(token for token in self._endpoints[topic] if token.kind == "subscription")
        published = self.publishers_of(topic)
        if any((token.type_name, token.type_hash) == (own.type_name, own.type_hash) for token in published):
            return ""
        if published:
            return f"{_full_name(published[0].node)} publishes it with {_difference(own, published[0])}"
        others = [token for token in self.graph() if self._is_other(token) and not _is_of_mast(token)]
        publishers = [token for token in others if isinstance(token, EndpointToken) and token.kind == "publisher"]
        if similar := sorted({token.topic for token in publishers if token.type_name == own.type_name}):
            return f"nobody publishes it; {own.type_name} is published on {_some(similar)}"
        if nodes := sorted({_full_name(_node_of(token)) for token in others}):
            return f"nobody publishes it; in domain {self.connection.domain} there are the nodes {_some(nodes)}"
        absence = f"no node of ROS 2 is in domain {self.connection.domain}"
        elsewhere = self._other_domains()
        return f"{absence}, but in {_some([str(domain) for domain in elsewhere])}" if elsewhere else absence

    def refuse(self, topic: str, reason: str) -> None:
        """Count a message of a topic that is of no use, by the reason's part before the colon; log the first one.

        Numbers in it, which peers choose, are not told apart.
        """
        kind = re.sub(r"\b[0-9]+\b", "N", " ".join(reason.split(":", 1)[0].split()))[:120]
        with self._lock:
            if kind not in self.refused and len(self.refused) >= MOST_REASONS:
                kind = "other reasons"
            self.refused[kind] += 1
            is_first = topic not in self._logged
            self._logged.add(topic)
        if is_first:
            log.warning("%s: refused a message: %s (more on this topic will only be counted)", topic, reason)

    def close(self) -> None:
        """Leave; what has been published is handed over first."""
        self._session.close()
        self._declared.clear()

    # -- inside --------------------------------------------------------------------------------------------------------

    def _endpoint(self, kind: str, topic: str, type_name: str, qos: Qos) -> EndpointToken:
        key = DataKey.of(self.connection.domain, topic, type_name)
        self._n_endpoints += 1
        number = self._n_endpoints  # the node itself has 0
        token = EndpointToken(self._node, number, kind, topic, type_name, key.type_hash, qos.write())
        with self._lock:
            self._endpoints.setdefault(topic, []).append(token)
        if not self._is_complete:
            for reply in self._session.liveliness().get(tokens_of(self.connection.domain, topic), timeout=_CONNECT_S):
                if reply.ok is not None:
                    self._on_token(reply.ok)
        for other in self._others("subscription" if kind == "publisher" else "publisher", topic):
            self._compare(token, other)
        return token

    def _others(self, kind: str, topic: str) -> list[EndpointToken]:
        with self._lock:
            known = self._of_topics.get((kind, topic), {})
            return [known[token] for token in sorted(known) if self._is_other(known[token])]

    def _is_other(self, token: NodeToken | EndpointToken) -> bool:
        return _node_of(token).session != self._node.session

    def _other_domains(self) -> list[int]:
        """The other domains in which the router knows nodes that are not of a run."""
        found: set[int] = set()
        replies = self._session.liveliness().get(ALL_DOMAINS, timeout=_CONNECT_S)
        for reply in itertools.islice(replies, MOST_TOKENS):
            with contextlib.suppress(MessageError):
                token = parse_token(str(reply.ok.key_expr)) if reply.ok is not None else self._node
                if not _is_of_mast(token):
                    found.add(_node_of(token).domain)
        return sorted(found - {self.connection.domain})

    def _take(self, token: EndpointToken, handler: BytesHandler, sample: zenoh.Sample, most_bytes: int) -> None:
        """Check a received message, and pass it on."""
        try:
            if sample.kind != zenoh.SampleKind.PUT:
                raise MessageError("deleted: expected a message")
            if sample.attachment is None:
                raise MessageError("attachment: found none, expected that of rmw_zenoh")
            attachment = parse_attachment(sample.attachment.to_bytes())
            if len(sample.payload) > most_bytes:
                raise MessageError(f"size: found {len(sample.payload)} bytes, expected at most {most_bytes}")
            handler(sample.payload.to_bytes(), attachment)
        except MessageError as error:
            self.refuse(token.topic, str(error))

    def _on_token(self, sample: zenoh.Sample) -> None:
        """Follow the tokens of the domain."""
        key = str(sample.key_expr)
        if sample.kind != zenoh.SampleKind.PUT:
            self._forget(key)
            return
        try:
            token = parse_token(key)
        except MessageError as error:
            self.refuse("liveliness", f"token: {error}")
            return
        if not self._remember(key, token):
            self._is_complete = False
            self.refuse("tokens", f"token beyond {MOST_TOKENS}: the rest of the domain is not known")
            return
        if isinstance(token, EndpointToken) and self._is_other(token):
            with self._lock:
                own = list(self._endpoints.get(token.topic, ()))
            for endpoint in own:
                if {endpoint.kind, token.kind} == {"publisher", "subscription"}:
                    self._compare(endpoint, token)

    def _remember(self, key: str, token: NodeToken | EndpointToken) -> bool:
        """Remember a token; False if there is no room."""
        with self._lock:
            has_room = key in self._known or len(self._known) < MOST_TOKENS
            if isinstance(token, EndpointToken):
                of_topic = self._of_topics.get((token.kind, token.topic), {})
                has_room |= token.topic in self._endpoints and len(of_topic) < MOST_TOKENS_OF_TOPIC
                if has_room:
                    self._of_topics.setdefault((token.kind, token.topic), of_topic)[key] = token
            if has_room:
                self._known[key] = token
        return has_room

    def _forget(self, key: str) -> None:
        with self._lock:
            token = self._known.pop(key, None)
            if isinstance(token, EndpointToken):
                place = token.kind, token.topic
                del self._of_topics[place][key]
                if not self._of_topics[place]:
                    del self._of_topics[place]

    def _compare(self, own: EndpointToken, other: EndpointToken) -> None:
        """Warn of a peer on the same topic with another type, or with the same of other fields."""
        if (own.type_name, own.type_hash) == (other.type_name, other.type_hash):
            return
        found = f"the {other.kind} of {_full_name(other.node)} has {_difference(own, other)}"
        sentence = f"{own.topic}: {found}: the two do not hear each other"
        with self._lock:
            is_new = sentence not in self.warnings and len(self.warnings) < MOST_REASONS
            if is_new:
                self.warnings.append(sentence)
        if is_new:
            log.warning("%s", sentence)


def joined(connection: Connection, node: str) -> Participant:
    """The session of a node of a run. A peer that takes nothing must not stop the run: its messages are dropped."""
    return Participant(connection, ros2_name(MAST_PREFIX + node), wait=False)


def _difference(own: EndpointToken, other: EndpointToken) -> str:
    """What is found at an endpoint of the same topic whose type or definition differs, and what is expected."""
    if own.type_name != other.type_name:
        return f"{other.type_name}, expected {own.type_name}"
    return f"another definition of {own.type_name} ({other.type_hash}), expected {own.type_hash}"


def _node_of(token: NodeToken | EndpointToken) -> NodeToken:
    return token.node if isinstance(token, EndpointToken) else token


def _full_name(node: NodeToken) -> str:
    return f"{node.namespace.rstrip('/')}/{node.name}"


def _is_of_mast(token: NodeToken | EndpointToken) -> bool:
    """Whether a token is of a node of a run, or of a bridge: these answer nobody."""
    return _node_of(token).name.startswith(MAST_PREFIX)


def _some(names: Sequence[str], most: int = 3) -> str:
    """The first of some names, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _open(connection: Connection) -> zenoh.Session:
    """A session with the router; raises NotRunning with the reason if it does not answer."""
    settings = _SETTINGS | {"connect/endpoints": [connection.router]}
    if connection.tls is not None:
        tls: dict[str, Any] = {"root_ca_certificate": str(connection.tls.ca), "verify_name_on_connect": True}
        if connection.tls.certificate is not None:
            tls |= {
                "connect_certificate": str(connection.tls.certificate),
                "connect_private_key": str(connection.tls.key),
                "enable_mtls": True,
            }
        settings |= {"transport/link/tls": tls}
    try:
        return open_session(settings)
    except zenoh.ZError:
        raise NotRunning(f"{connection.router}: {_reason(connection)}") from None


def _reason(connection: Connection) -> str:
    """Why a router does not answer."""
    expected = "expected a router of rmw_zenoh: start one with `ros2 run rmw_zenoh_cpp rmw_zenohd`"
    if not connection.router.startswith(("udp", "quic")):
        host, _, port = connection.router.partition("/")[2].rpartition(":")
        try:
            with contextlib.closing(socket.create_connection((host.strip("[]"), int(port)), _CONNECT_S)):
                pass
        except (OSError, OverflowError) as error:
            return f"nothing answers there ({getattr(error, 'strerror', None) or error}), {expected}"
    if connection.tls is not None:
        return "something listens there, but refuses these certificates, or is no router"
    found = f"something listens there, but answers as no router within {_CONNECT_S:g} s: perhaps it demands TLS"
    return f"{found}; {expected}"
