"""Liveliness tokens of rmw_zenoh: keys that tell which nodes, publishers and subscriptions exist.

    @ros2_lv/<domain>/<session>/<node>/<node>/NN/<enclave>/<namespace>/<name>
    @ros2_lv/<domain>/<session>/<node>/<entity>/MP/<enclave>/<namespace>/<name>/<topic>/<type>/<hash>/<qos>

Peers from Lyrical 0.10.5 may add one more chunk after the quality of service. It is ignored, as all that follows.

Names of topics, nodes and types of ROS 2, and how rmw_zenoh writes them in key expressions.

The key expression of a topic's messages: `<domain>/<topic>/<type>/<hash>`.

Quality of service as liveliness tokens write it: what equals rmw_zenoh's defaults is empty.

    reliability:durability:history,depth:deadline s,ns:lifespan s,ns:liveliness,lease s,ns

All topics here are reliable, without limits of time, and keep their last messages. That of peers is not read.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from mast_ros2.type_store import type_hash
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


#: The depth that an empty field stands for.
_DEFAULT_DEPTH = 42


@dataclass(frozen=True, slots=True)
class Qos:
    """Quality of service of a publisher or a subscription; by default that of ROS 2.

    transient_local: whether later subscribers get the messages that are kept, too;  depth: messages kept, 1 or more
    """

    transient_local: bool = False
    depth: int = 10

    def write(self) -> str:
        """The chunk of a token."""
        depth = "" if self.depth == _DEFAULT_DEPTH else str(self.depth)
        return f":{1 if self.transient_local else ''}:,{depth}:,:,:,,"


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


#: What peers without type hashes write instead of one: those of Humble.
NO_HASH = "TypeHashNotSupported"
#: Largest ROS_DOMAIN_ID that is accepted. DDS allows 232; rmw_zenoh has no limit.
MOST_DOMAIN = 2**32 - 1

_ROOT = "/"
_MANGLED_SLASH = "%"
_NODE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,254}")
_QUALIFIED = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_LONGEST_TOPIC = 247  # of rmw's validation
_TYPE = re.compile(r"([a-z][a-z0-9_]*)/(msg|srv|action)/([A-Z][A-Za-z0-9_]*)")
_DDS_TYPE = re.compile(r"([a-z][a-z0-9_]*)::(msg|srv|action)::dds_::([A-Z][A-Za-z0-9_]*)_")
_HASH = re.compile(r"RIHS01_[0-9a-f]{64}")


def ros2_name(name: str) -> str:
    """A node's name as ROS 2 allows it: letters, digits and _, no digit first."""
    return re.sub(r"^(?=[0-9])", "_", re.sub(r"\W", "_", name, flags=re.ASCII))


def topic_prefix(node: str) -> str:
    """Where the topics of a node of the run are by default, such as /mast/infra_1."""
    return f"/mast/{ros2_name(node)}"


def check_topic(topic: str) -> str:
    """`topic`, a fully qualified name such as `/mast/picture`; raises ValueError if it is none."""
    if not _QUALIFIED.fullmatch(topic) or len(topic) > _LONGEST_TOPIC:
        raise ValueError(
            f"topic {topic!r:.120}: expected /name or /name/name/..., of letters, digits and _, "
            f"no name with a digit first, at most {_LONGEST_TOPIC} characters"
        )
    return topic


def check_namespace(namespace: str) -> str:
    """`namespace`, `/` or a name such as `/mast`; raises ValueError if it is none."""
    if namespace != _ROOT:
        try:
            check_topic(namespace)
        except ValueError as error:
            raise ValueError(f"namespace: {error}") from None
    return namespace


def check_node_name(name: str) -> str:
    """`name` of a node; raises ValueError if it is none."""
    if not _NODE_NAME.fullmatch(name):
        raise ValueError(
            f"node name {name!r:.120}: expected letters, digits and _, no digit first, at most 255 characters"
        )
    return name


def mangle(name: str) -> str:
    """A name as one chunk of a token: `/` becomes `%`."""
    return name.replace("/", _MANGLED_SLASH)


def demangle(chunk: str) -> str:
    """The name in a chunk of a token."""
    return chunk.replace(_MANGLED_SLASH, "/")


def dds_type(type_name: str) -> str:
    """`std_msgs::msg::dds_::String_` for `std_msgs/msg/String`; raises ValueError for another form."""
    match = _TYPE.fullmatch(type_name)
    if match is None:
        raise ValueError(f"type {type_name!r:.120}: expected package/msg/Name")
    package, kind, name = match.groups()
    return f"{package}::{kind}::dds_::{name}_"


def type_of_dds(dds_name: str) -> str:
    """`std_msgs/msg/String` for `std_msgs::msg::dds_::String_`; raises MessageError for another form."""
    match = _DDS_TYPE.fullmatch(dds_name)
    if match is None:
        raise MessageError(f"type {dds_name!r:.120}: expected package::msg::dds_::Name_")
    return "/".join(match.groups())


def check_hash(type_hash: str | None) -> str | None:
    """`type_hash`, None: of a peer without hashes; raises ValueError for another form."""
    if type_hash is not None and not _HASH.fullmatch(type_hash):
        raise ValueError(f"type hash {type_hash!r:.120}: expected RIHS01_ and 64 hexadecimal digits")
    return type_hash


def hash_chunk(type_hash: str | None) -> str:
    """A type's hash as a chunk of keys and tokens."""
    return NO_HASH if type_hash is None else type_hash


def check_domain(domain: int) -> int:
    """`domain`, a ROS_DOMAIN_ID; raises ValueError if it is none."""
    if not 0 <= domain <= MOST_DOMAIN:
        raise ValueError(f"domain {domain!r}: expected 0 to {MOST_DOMAIN}")
    return domain


@dataclass(frozen=True, slots=True)
class DataKey:
    """A topic of one type in one domain. Peers whose hash differs do not hear each other, without an error.

    domain:    ROS_DOMAIN_ID
    topic:     fully qualified, such as `/mast/picture`
    type_name: such as `std_msgs/msg/String`
    type_hash: `RIHS01_` and 64 digits; None: the peer has none, as those of Humble

    Raises ValueError for names, hashes and domains that ROS does not allow.
    """

    domain: int
    topic: str
    type_name: str
    type_hash: str | None

    def __post_init__(self) -> None:
        check_domain(self.domain)
        check_topic(self.topic)
        dds_type(self.type_name)
        check_hash(self.type_hash)

    @classmethod
    def of(cls, domain: int, topic: str, type_name: str) -> DataKey:
        """With the hash of a type that the store knows; raises KeyError for another."""
        return cls(domain, topic, type_name, type_hash(type_name))

    def write(self) -> str:
        """The key expression."""
        return f"{self.domain}{self.topic}/{dds_type(self.type_name)}/{hash_chunk(self.type_hash)}"
