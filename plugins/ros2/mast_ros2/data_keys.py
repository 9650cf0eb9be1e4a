"""The key expression of a topic's messages: `<domain>/<topic>/<type>/<hash>`."""

from __future__ import annotations

from dataclasses import dataclass

from mast_ros2.names import check_domain, check_hash, check_topic, dds_type, hash_chunk
from mast_ros2.type_store import type_hash


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
