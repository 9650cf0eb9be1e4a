"""Quality of service as liveliness tokens write it: what equals rmw_zenoh's defaults is empty.

    reliability:durability:history,depth:deadline s,ns:lifespan s,ns:liveliness,lease s,ns

All topics here are reliable, without limits of time, and keep their last messages. That of peers is not read.
"""

from __future__ import annotations

from dataclasses import dataclass

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
