"""The bridge to ROS 2: a node on a router of rmw_zenoh that publishes the frames of a run."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from typing import Any

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.ros2.qos import Qos
from mast_zenoh.runtime.mesh.ros2_participant import Participant, Publisher
from mast_zenoh.viewer.export.ros2_messages import MARKERS, RunMessages
from mast_zenoh.viewer.frame import Frame, FramedRun
from mast_zenoh.viewer.servers.playback import Playback, Status

log = logging.getLogger("mast.ros2")

NODE = "mast_bridge"
_KEPT = Qos(durability="transient_local", depth=1)


class Ros2Bridge:
    """Publishes frames of a run; conversions of objects only for topics to which something subscribes.

    A peer that takes nothing is waited for until its link ends: `publish` blocks for so long.

    participant: the node;  namespace: before the topics of objects and odometry;  partners: see `RunMessages`

    messages: what it publishes;  sent: number of frames;  failed: of frames of which something could not be converted
    unheard:  of frames that were published while there was no router

    Raises ConfigurationError for names that ROS does not allow.
    """

    def __init__(
        self,
        run: FramedRun,
        participant: Participant,
        namespace: str = "/",
        partners: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        self.messages = RunMessages(run, namespace, partners)
        self.sent = self.failed = self.unheard = 0
        self._participant = participant
        try:
            self._publishers: dict[str, Publisher] = {
                topic.name: participant.publisher(topic.name, topic.type_name, _KEPT if topic.kept else None)
                for topic in self.messages.topics
            }
        except ValueError as error:
            raise ConfigurationError(f"ros2: {error}") from None
        for name, message in self.messages.kept():
            self._publishers[name].publish(message)
        participant.settle()

    def publish(self, frame: Frame) -> None:
        """Publish a frame, its clock first."""
        self.unheard += not self._participant.is_connected
        try:
            for name, message in self.messages.of(frame, self._is_wanted):
                self._publishers[name].publish(message)
        except Exception as error:  # such as times and names that ROS cannot express; of an open mesh anything may come
            if not self.failed:
                log.warning("frame %d is incomplete: %r (others like it will only be counted)", frame.index, error)
            self.failed += 1
        self.sent += 1

    @property
    def shows_outcomes(self) -> bool:
        """Whether something subscribes to markers, whose colours are the evaluator's outcomes."""
        return any(self._is_wanted(topic + MARKERS) for topic in self.messages.objects.values())

    def sentences(self) -> list[str]:
        """What went wrong, in words; [] if nothing did."""
        words = {
            "frames were incomplete: something in them cannot be expressed in ROS": self.failed,
            "frames were published while there was no link to the router: nothing received them": self.unheard,
        }
        return [f"{number} {text}" for text, number in words.items() if number] + self._participant.warnings

    def _is_wanted(self, topic: str) -> bool:
        return self._publishers[topic].is_wanted


def played(run: FramedRun, *, rate: float = 1.0, loop: bool = False) -> Iterator[Frame]:
    """The frames of a finished run at the pace of its scene, once or again and again.

    It reads the run once before. rate: s of the scene per s

    Raises RunFolderError if the run has no frame.
    """
    playback = Playback(run, rate=rate, loop=loop)

    def end() -> None:
        if playback.status is Status.ENDED:
            playback.stop()

    playback.on_change = end
    return playback.frames()
