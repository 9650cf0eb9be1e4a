"""The bridge to ROS 2: a node on a router of rmw_zenoh that publishes the frames of a run."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Set
from contextlib import suppress
from itertools import chain, count
from typing import Any

from mast_ros2.liveliness_tokens import Qos
from mast_ros2.participant import Participant, Publisher
from mast_ros2.run_messages import MARKERS, RunMessages
from mast_zenoh.errors import ConfigurationError, RunFolderError
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.live.observer import Observer
from mast_zenoh.runs.recorded import frames_of, open_recorded
from mast_zenoh.runs.run import Run

log = logging.getLogger("mast.ros2")

NODE = "mast_bridge"
_ONE_MESSAGE = Qos(transient_local=True, depth=1)
#: s, from a topic's last subscription on, in which a loss of the link must be noticed to be the reason for its end.
_LOSS_S = 2.0


class Ros2Bridge:
    """Publishes frames of a run; conversions of objects only for topics to which something subscribes.

    A peer that takes nothing is waited for until its link ends: `publish` blocks for so long.

    participant: the node;  namespace: before the topics of objects and odometry;  partners: see `RunMessages`

    messages: what it publishes;  sent: number of frames;  newest: index of the newest one, -1: none
    failed:   of frames of which something could not be converted
    unheard:  of frames that were published while there was no link to the router, or before subscriptions came back

    Raises ConfigurationError for names that ROS does not allow.
    """

    def __init__(
        self,
        run: Run,
        participant: Participant,
        namespace: str = "/",
        partners: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        self.messages = RunMessages(run, namespace, partners)
        self.sent = self.failed = self.unheard = 0
        self.newest = -1
        self._participant = participant
        try:
            self._publishers: dict[str, Publisher] = {
                name: participant.publisher(name, kind, _ONE_MESSAGE if transient_local else Qos())
                for name, kind, transient_local in self.messages.topics
            }
        except ValueError as error:
            raise ConfigurationError(f"ros2: {error}") from None
        for name, message in self.messages.transient_local():
            self._publishers[name].publish(message)
        participant.settle()
        self._router = participant.router
        self._wanted_at: dict[str, float] = {}  # by topic, when it was last wanted, s on the monotonic clock
        self._awaited: set[str] = set()  # topics that were wanted before a loss of the link, and are not wanted again

    def publish(self, frame: Frame) -> None:
        """Publish a frame, its clock first."""
        wanted = {each.name for each in self.messages.topics if not each.transient_local and self._is_wanted(each.name)}
        self.unheard += self._is_unheard(wanted)
        try:
            for name, message in self.messages.of(frame, wanted.__contains__):
                self._publishers[name].publish(message)
        except Exception as error:  # such as times and names that ROS cannot express; of an open mesh anything may come
            if not self.failed:
                log.warning("frame %d is incomplete: %r (others like it will only be counted)", frame.index, error)
            self.failed += 1
        self.sent += 1
        self.newest = max(self.newest, frame.index)
        self._wanted_at |= dict.fromkeys(wanted, time.monotonic())  # a peer that takes nothing may have been waited for

    @property
    def shows_outcomes(self) -> bool:
        """Whether something subscribes to markers, whose colours are the evaluator's outcomes."""
        return any(self._is_wanted(topic + MARKERS) for topic in self.messages.objects.values())

    def sentences(self) -> list[str]:
        """What went wrong, in words; [] if nothing did."""
        words = {
            "frames were incomplete: something in them cannot be expressed in ROS": self.failed,
            "frames were published while there was no link to the router, or before all subscriptions were back after "
            "that: not everything received them": self.unheard,
        }
        return [f"{number} {text}" for text, number in words.items() if number] + self._participant.warnings

    def _is_unheard(self, wanted: Set[str]) -> bool:
        """Whether there is no link to the router, or topics are not wanted since it was lost. wanted: topics now"""
        router, now = self._participant.router, time.monotonic()
        if not router or router != self._router:  # a new router does not know the old one's clients until they connect
            self._awaited |= {topic for topic, at in self._wanted_at.items() if now - at < _LOSS_S}
        self._awaited -= wanted
        self._router = router
        return not router or bool(self._awaited)

    def _is_wanted(self, topic: str) -> bool:
        return self._publishers[topic].is_wanted


def frames_to_the_end(
    bridge: Ros2Bridge, observer: Observer, stop: threading.Event, ended: Callable[[], None]
) -> Iterator[Frame]:
    """The frames that an observer measures, and the last one of the run: from its recording, if it did not arrive.

    stop, ended: see `Observer.frames`
    """
    yield from observer.frames(stop, ended)
    folder = observer.address.folder
    if folder is None or stop.is_set() or bridge.newest >= observer.address.resolved.frames - 1:
        return
    with suppress(RunFolderError):  # not recorded
        (last,) = deque(frames_of(open_recorded(folder)), maxlen=1)
        if last.index > bridge.newest:
            yield last


def played(run: Run, *, rate: float = 1.0, loop: bool = False) -> Iterator[Frame]:
    """The frames of a finished run at the pace of its scene, once or again and again; rate: s of the scene per s.

    It reads the run once before. Raises RunFolderError if the run has no frame.
    """
    first_ns = min(frame.time_ns for frame in frames_of(run))

    def once() -> Iterator[Frame]:
        begin_s = time.monotonic()
        for frame in frames_of(run):
            time.sleep(max(0.0, begin_s + (frame.time_ns - first_ns) / 1e9 / rate - time.monotonic()))
            yield frame

    return chain.from_iterable(once() for _ in (count() if loop else range(1)))
