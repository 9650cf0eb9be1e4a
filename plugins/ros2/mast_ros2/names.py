"""Names of topics, nodes and types of ROS 2, and how rmw_zenoh writes them in key expressions."""

from __future__ import annotations

import re

from mast_zenoh.errors import MessageError

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
