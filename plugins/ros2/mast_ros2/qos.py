"""Quality of service as liveliness tokens write it: what equals rmw_zenoh's defaults is empty.

    reliability:durability:history,depth:deadline s,ns:lifespan s,ns:liveliness,lease s,ns

The defaults, reliable and volatile with ten messages, are `::,10:,:,:,,`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from mast_zenoh.errors import MessageError

#: The durability of a publisher that keeps its newest messages for later subscribers.
TRANSIENT_LOCAL = "transient_local"
#: Values of the policies, in the order of rmw's numbers.
RELIABILITIES = ("system_default", "reliable", "best_effort", "unknown", "best_available")
DURABILITIES = ("system_default", TRANSIENT_LOCAL, "volatile", "unknown", "best_available")
HISTORIES = ("system_default", "keep_last", "keep_all", "unknown")
LIVELINESSES = ("system_default", "automatic", "manual_by_node", "manual_by_topic", "unknown", "best_available")

#: ns, no limit: what rmw writes for it.
INFINITE = 2**63 - 1
#: The depth that an empty field stands for.
DEFAULT_DEPTH = 42

_SECOND = 10**9
_SHAPE = (1, 1, 2, 2, 2, 3)  # of the parts between colons, by commas
_NUMBER = re.compile(r"[0-9]{1,20}")


@dataclass(frozen=True, slots=True)
class Qos:
    """Quality of service of a publisher or a subscription; by default that of ROS 2.

    depth: messages kept, for `keep_last`
    deadline_ns, lifespan_ns, lease_ns: ns, INFINITE: none

    Raises ValueError for unknown policies and numbers out of range.
    """

    reliability: str = "reliable"
    durability: str = "volatile"
    history: str = "keep_last"
    depth: int = 10
    deadline_ns: int = INFINITE
    lifespan_ns: int = INFINITE
    liveliness: str = "automatic"
    lease_ns: int = INFINITE

    def __post_init__(self) -> None:
        for name, values in _POLICIES.items():
            if getattr(self, name) not in values:
                raise ValueError(f"{name}: found {getattr(self, name)!r}, expected one of {', '.join(values)}")
        for name in ("depth", "deadline_ns", "lifespan_ns", "lease_ns"):
            if not 0 <= getattr(self, name) <= INFINITE:
                raise ValueError(f"{name}: found {getattr(self, name)!r}, expected 0 to {INFINITE}")

    def write(self) -> str:
        """The chunk of a token."""
        policy = {
            name: "" if getattr(self, name) == getattr(_DEFAULTS, name) else str(values.index(getattr(self, name)))
            for name, values in _POLICIES.items()
        }
        depth = "" if self.depth == DEFAULT_DEPTH else str(self.depth)
        deadline, lifespan, lease = map(_duration, (self.deadline_ns, self.lifespan_ns, self.lease_ns))
        return (
            f"{policy['reliability']}:{policy['durability']}:{policy['history']},{depth}:"
            f"{deadline}:{lifespan}:{policy['liveliness']},{lease}"
        )


_POLICIES = {
    "reliability": RELIABILITIES,
    "durability": DURABILITIES,
    "history": HISTORIES,
    "liveliness": LIVELINESSES,
}
_DEFAULTS = Qos(depth=DEFAULT_DEPTH)


def parse_qos(text: str) -> Qos:
    """The quality of service in a chunk of a token; raises MessageError for another form."""
    parts = [part.split(",") for part in text.split(":")]
    if tuple(map(len, parts)) != _SHAPE:
        raise MessageError(f"QoS {text!r:.120}: expected a form such as {Qos().write()!r}")
    (reliability,), (durability,), (history, depth), deadline, lifespan, (liveliness, *lease) = parts
    try:
        return Qos(
            reliability=_policy("reliability", reliability),
            durability=_policy("durability", durability),
            history=_policy("history", history),
            depth=_number(depth, DEFAULT_DEPTH),
            deadline_ns=_nanoseconds(deadline),
            lifespan_ns=_nanoseconds(lifespan),
            liveliness=_policy("liveliness", liveliness),
            lease_ns=_nanoseconds(lease),
        )
    except ValueError as error:
        raise MessageError(f"QoS {text!r:.120}: {error}") from None


def _policy(name: str, text: str) -> str:
    values = _POLICIES[name]
    number = _number(text, values.index(getattr(_DEFAULTS, name)))
    if number >= len(values):
        raise ValueError(f"{name}: found {number}, expected 0 to {len(values) - 1}")
    return values[number]


def _number(text: str, default: int) -> int:
    if text and not _NUMBER.fullmatch(text):
        raise ValueError(f"found {text!r:.40}, expected a whole number or nothing")
    return int(text) if text else default


def _duration(ns: int) -> str:
    """Seconds and nanoseconds; each is empty where it equals that of INFINITE."""
    pairs = zip(divmod(ns, _SECOND), divmod(INFINITE, _SECOND), strict=True)
    return ",".join("" if value == default else str(value) for value, default in pairs)


def _nanoseconds(texts: list[str]) -> int:
    s, ns = (_number(text, default) for text, default in zip(texts, divmod(INFINITE, _SECOND), strict=True))
    if ns >= _SECOND:
        raise ValueError(f"found {ns} ns besides the seconds, expected less than {_SECOND}")
    return s * _SECOND + ns
