"""What a command centre sends to ROS 2, the tracks of each agent, and the picture that comes back."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from mast_ros2 import type_store
from mast_ros2.frame_exchange import About, AnswerTopic, FrameExchange, Timing
from mast_ros2.liveliness_tokens import ros2_name, topic_prefix
from mast_ros2.object_messages import tracked_objects
from mast_ros2.received_objects import ReceivedObjects, received_tracks
from mast_ros2.received_poses import FrameTransforms, Placement
from mast_zenoh.arrays.geometry import states_to_world
from mast_zenoh.arrays.states import Ints, ObjectStates
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.outside import Outside
from mast_zenoh.tracking.kalman import predicted

#: m, on the ground, within which an agent's track supports an object of the picture.
SUPPORT_M = 2.0
#: Agents to which topics belong, at most.
MOST_AGENTS = 256


class CenterExchange(FrameExchange):
    """The exchange of one command centre.

    name: of its node; world: name of the world's frame; clock_topic: of the clock that it sends; "": none

    In each frame it sends one message for each agent, /mast/NAME/AGENT/tracks, in the order of their names; an empty
    one for an agent of which nothing is known. The picture is received as TrackedObjects on `picture_topic`.
    """

    def __init__(self, name: str, timing: Timing, *, world: str, clock_topic: str) -> None:
        self._prefix, self._world = topic_prefix(name), world
        self.picture_topic = f"{self._prefix}/received_picture"
        self._agents: dict[str, str] = {}  # topics by agent
        answer = AnswerTopic(self.picture_topic, type_store.TRACKED_OBJECTS, received_tracks, self._use)
        super().__init__([answer], FrameTransforms(world), timing, clock_topic=clock_topic)

    def join(self, outside: Outside, agents: Collection[str]) -> bool:
        """Make the topics known, and wait for a node that answers; False if there is none.

        Raises ConfigurationError for too many agents.
        """
        if len(agents) > MOST_AGENTS:
            raise ConfigurationError(f"agents: found {len(agents)}, expected at most {MOST_AGENTS} with ROS 2")
        for agent in sorted(agents):
            self._add(outside, agent)
        return self.start(outside, list(self._agents.values()))

    def send(self, outside: Outside, frame: int, time_ns: int, tracks: Mapping[str, ObjectStates]) -> None:
        """Ask about a frame, and send the tracks of each agent, world frame; agents that are too many are counted."""
        self.open_frame(outside, frame, time_ns, [self.picture_topic])
        for agent in sorted(tracks.keys() - self._agents.keys()):
            self._add(outside, agent)
        for agent, topic in sorted(self._agents.items()):
            states = tracks.get(agent, ObjectStates.empty())
            outside.send(topic, tracked_objects(states, time_ns, self._world))
        hidden = tracks.keys() - self._agents.keys()
        self.leave_out(f"agent: beyond {MOST_AGENTS}", sum(len(tracks[agent]) for agent in hidden))

    def _add(self, outside: Outside, agent: str) -> None:
        if len(self._agents) < MOST_AGENTS:
            self._agents[agent] = f"{self._prefix}/{ros2_name(agent)}/tracks"
            outside.announce(self._agents[agent], type_store.TRACKED_OBJECTS)

    def _use(self, received: ReceivedObjects[ObjectStates], about: About, placement: Placement) -> ObjectStates:
        states = states_to_world(received.objects, placement.position, placement.rotation)
        return predicted(states, -about.skew_ns * 1e-9)


def supports(picture: ObjectStates, tracks: ObjectStates, agent: Ints) -> Ints:
    """(n,) number of agents that have a track within SUPPORT_M of each object. agent: (m,) of each track"""
    offset = picture.position[:, None, :2] - tracks.position[None, :, :2]
    near = np.einsum("nmi,nmi->nm", offset, offset) <= SUPPORT_M**2
    rows = [near[:, agent == number].any(axis=1) for number in np.unique(agent)]
    return np.sum(rows, axis=0, dtype=np.int64) if rows else np.zeros(len(picture), np.int64)
