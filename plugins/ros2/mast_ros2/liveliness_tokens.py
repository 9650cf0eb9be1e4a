"""Liveliness tokens of rmw_zenoh: keys that tell which nodes, publishers and subscriptions exist.

    @ros2_lv/<domain>/<session>/<node>/<node>/NN/<enclave>/<namespace>/<name>
    @ros2_lv/<domain>/<session>/<node>/<entity>/MP/<enclave>/<namespace>/<name>/<topic>/<type>/<hash>/<qos>

Peers from Lyrical 0.10.5 may add one more chunk after the quality of service. It is ignored, as all that follows.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from mast_ros2.data_keys import DataKey
from mast_ros2.names import (
    NO_HASH,
    check_domain,
    check_namespace,
    check_node_name,
    dds_type,
    demangle,
    hash_chunk,
    mangle,
    type_of_dds,
)
from mast_ros2.qos import Qos
from mast_zenoh.errors import MessageError

_ADMIN_SPACE = "@ros2_lv"
_NODE = "NN"
#: Codes of what belongs to a node and has a topic, or the name of a service.
ENDPOINTS = {"publisher": "MP", "subscription": "MS", "service": "SS", "client": "SC"}
_KINDS = {code: kind for kind, code in ENDPOINTS.items()}

_NODE_CHUNKS, _ENDPOINT_CHUNKS = 9, 13
_SESSION = re.compile(r"[0-9a-f]{1,32}")
_NUMBER = re.compile(r"0|[1-9][0-9]{0,18}")


@dataclass(frozen=True, slots=True)
class NodeToken:
    """A node of ROS 2.

    domain:    ROS_DOMAIN_ID
    session:   id of its Zenoh session, 1 to 32 hexadecimal digits
    number:    of the node in its session
    name, namespace, enclave: such as `talker`, `/` and `/`

    Raises ValueError for names and ids that are not allowed.
    """

    domain: int
    session: str
    number: int
    name: str
    namespace: str = "/"
    enclave: str = "/"

    def __post_init__(self) -> None:
        check_domain(self.domain)
        if not _SESSION.fullmatch(self.session):
            raise ValueError(f"session {self.session!r:.80}: expected 1 to 32 hexadecimal digits")
        check_node_name(self.name)
        check_namespace(self.namespace)
        check_namespace(self.enclave)

    def write(self) -> str:
        """The key of the token."""
        return self.chunks(self.number, _NODE)

    def chunks(self, number: int, code: str) -> str:
        """The part of a token that names the node: of itself, or of an endpoint with a number and a code."""
        names = "/".join(map(mangle, (self.enclave, self.namespace, self.name)))
        return f"{_ADMIN_SPACE}/{self.domain}/{self.session}/{self.number}/{number}/{code}/{names}"


@dataclass(frozen=True, slots=True)
class EndpointToken:
    """A publisher or a subscription of a node; services and clients have the same form.

    node:      to which it belongs
    number:    of the endpoint in its session
    kind:      of ENDPOINTS
    topic, type_name, type_hash: as `DataKey`
    qos:       quality of service, as `Qos.write` writes it

    Raises ValueError for names and hashes that are not allowed.
    """

    node: NodeToken
    number: int
    kind: str
    topic: str
    type_name: str
    type_hash: str | None
    qos: str = Qos().write()

    def __post_init__(self) -> None:
        _ = self.data_key  # checks the names

    @property
    def data_key(self) -> DataKey:
        """Of the messages."""
        return DataKey(self.node.domain, self.topic, self.type_name, self.type_hash)

    def write(self) -> str:
        """The key of the token."""
        node = self.node.chunks(self.number, ENDPOINTS[self.kind])
        return f"{node}/{mangle(self.topic)}/{dds_type(self.type_name)}/{hash_chunk(self.type_hash)}/{self.qos}"


#: The key expression of the tokens of all domains.
ALL_DOMAINS = f"{_ADMIN_SPACE}/**"


def all_tokens(domain: int) -> str:
    """The key expression of all tokens in a domain."""
    return f"{_ADMIN_SPACE}/{check_domain(domain)}/**"


def tokens_of(domain: int, topic: str) -> str:
    """The key expression of the tokens of a topic's endpoints."""
    return f"{_ADMIN_SPACE}/{check_domain(domain)}/*/*/*/*/*/*/*/{mangle(topic)}/**"


def parse_token(token: str) -> NodeToken | EndpointToken:
    """The node or endpoint of a token; raises MessageError with the reason if it is none of rmw_zenoh's."""
    try:
        return _parse(token.split("/"))
    except (MessageError, ValueError) as error:
        raise MessageError(f"token {token!r:.300}: {error}") from None


def _parse(chunks: list[str]) -> NodeToken | EndpointToken:
    if chunks[0] != _ADMIN_SPACE:
        raise MessageError(f"found {chunks[0]!r:.40} first, expected {_ADMIN_SPACE}")
    if len(chunks) < _NODE_CHUNKS:
        raise MessageError(f"found {len(chunks)} chunks, expected at least {_NODE_CHUNKS}")
    if not all(chunks):
        raise MessageError("found an empty chunk, expected none")
    domain, session, number, own_number, code = chunks[1:6]
    enclave, namespace, name = map(demangle, chunks[6:_NODE_CHUNKS])
    node = NodeToken(_number(domain), session, _number(number), name, namespace, enclave)
    if code == _NODE:
        if own_number != number:
            raise MessageError(f"found the numbers {number} and {own_number} of one node, expected equal ones")
        return node
    if code not in _KINDS:
        raise MessageError(f"found {code!r:.40}, expected one of {', '.join((_NODE, *_KINDS))}")
    if len(chunks) < _ENDPOINT_CHUNKS:
        raise MessageError(f"found {len(chunks)} chunks, expected at least {_ENDPOINT_CHUNKS} with {code}")
    topic, dds_name, type_hash, qos = chunks[_NODE_CHUNKS:_ENDPOINT_CHUNKS]
    return EndpointToken(
        node,
        _number(own_number),
        _KINDS[code],
        demangle(topic),
        type_of_dds(dds_name),
        None if type_hash == NO_HASH else type_hash,
        qos,
    )


def _number(chunk: str) -> int:
    if not _NUMBER.fullmatch(chunk):
        raise MessageError(f"found {chunk!r:.40}, expected a whole number")
    return int(chunk)
