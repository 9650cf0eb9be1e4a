"""Questions to nodes of ROS 2 about frames, and their answers: which frame an answer is about, and how long to wait.

In lock-step a question is waited for up to a limit; in real time, what has arrived counts. Answers are told apart by
their stamps. What answers no question, came before it, or cannot be used, is counted by reason.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from mast_ros2 import type_store
from mast_ros2.liveliness_tokens import check_topic
from mast_ros2.received_poses import FrameTransforms, Placement, received_transforms
from mast_ros2.spatial import clock
from mast_ros2.type_store import RosMessage
from mast_zenoh.errors import MessageError
from mast_zenoh.outside import Arrival, Outside, OutsideTally, OutsideTopic

TF, TF_STATIC = "/tf", "/tf_static"
_TF_TOPICS = (
    OutsideTopic(TF, type_store.TF_MESSAGE, depth=100, most_bytes=1 << 15),
    OutsideTopic(TF_STATIC, type_store.TF_MESSAGE, retained=True, depth=100, most_bytes=1 << 15),
)
#: Transforms that are taken at once, of the smallest messages: a flood of large ones delays no answers.
MOST_TRANSFORMS_AT_ONCE = 1000

#: Frames to which an answer can belong, the newest.
KEPT = 64
#: After this number of questions in a row without an answer, each is waited for only `BRIEF_S`, s, until one comes,
#: also a late one.
MOST_SILENT, BRIEF_S = 3, 0.02
#: s, the longest wait that can be set: several nodes that wait in one frame stay below the driver's limit.
MOST_WAIT_S = 5.0
#: s, for a node outside to subscribe after it has begun to publish.
_SUBSCRIBE_S = 2.0


class About(NamedTuple):
    """What an answer is about.

    frame:   of the question;  time_ns: of that frame
    skew_ns: by how much its stamp is later than the frame, ns, in the scene's time
    late:    whether the frame went on without it
    """

    frame: int
    time_ns: int
    skew_ns: int
    late: bool


class Answer(NamedTuple):
    """An answer as it is used. topic: on which it came;  content: what `AnswerTopic.use` has made of it"""

    topic: str
    about: About
    content: Any


@dataclass(frozen=True, slots=True)
class AnswerTopic:
    """A topic on which answers come.

    read: turns a message into an object with `frame_id`, `time_ns` and perhaps `dropped`, objects left out by reason
    use:  turns that, what it is about, and where its frame of reference is in the world, into an answer

    Both raise MessageError for what cannot be used.
    """

    name: str
    type_name: str
    read: Callable[[RosMessage], Any]
    use: Callable[[Any, About, Placement], Any]


@dataclass(frozen=True, slots=True)
class Timing:
    """How long answers are waited for, and which stamps they may have.

    wait_s: limit in lock-step, s;  skew_s: greatest distance of a stamp from the time of a frame, s
    stamps: the clock of stamps: the scene's, as on /clock, or the wall clock
    start_s: s, for which a node outside is waited for before the first frame

    Raises ValueError for values out of range.
    """

    wait_s: float = 1.0
    skew_s: float = 0.1
    stamps: Literal["scene", "wall"] = "scene"
    start_s: float = 10.0

    def __post_init__(self) -> None:
        for name, most in (("wait_s", MOST_WAIT_S), ("skew_s", 10.0), ("start_s", 20.0)):
            if not 0.0 <= getattr(self, name) <= most:
                raise ValueError(f"{name}: found {getattr(self, name)}, expected 0 to {most:g}")


def _check_names(world: str, clock_topic: str) -> None:
    """Raise ValueError for a name of the world's frame, or of the topic of a clock, that ROS does not allow."""
    if not 0 < len(world) <= 255 or world.startswith("/"):
        raise ValueError(f"world: found {world!r:.80}, expected the name of a frame, such as 'map'")
    if clock_topic:
        try:
            check_topic(clock_topic)
        except ValueError as error:
            raise ValueError(f"clock: {error}") from None


class FrameExchange(OutsideTally):
    """The questions of one node, and the answers to them.

    answers: topics on which they come
    transforms: of frames of reference;  listens_to_tf: whether /tf and /tf_static are received
    clock_topic: of the clock that it sends; "": none
    topics: that it receives

    Raises ValueError for names of the world's frame and of the clock's topic that ROS does not allow.
    """

    def __init__(
        self,
        answers: Collection[AnswerTopic],
        transforms: FrameTransforms,
        timing: Timing,
        *,
        listens_to_tf: bool = True,
        clock_topic: str = "",
    ) -> None:
        super().__init__(topic.name for topic in answers)
        _check_names(transforms.world, clock_topic)
        self.transforms, self.clock_topic = transforms, clock_topic
        self._timing = timing
        self._topics = {topic.name: topic for topic in answers}
        received = [OutsideTopic(topic.name, topic.type_name) for topic in answers]
        self.topics = (*(_TF_TOPICS if listens_to_tf else ()), *received)
        self._times: dict[int, int] = {}  # of the newest frames, ns
        self._open: dict[tuple[int, str], bool] = {}  # questions without an answer: whether their frame went on
        self._answered: set[tuple[int, str]] = set()
        self._early: list[Answer] = []  # late ones, which arrived before the newest question
        self._silent = 0

    def start(self, outside: Outside, questions: Collection[str]) -> bool:
        """Wait for a node outside that answers; False if there is none. questions: topics that it may subscribe to"""
        topics = list(self._topics)
        if self.clock_topic:
            outside.announce(self.clock_topic, type_store.CLOCK)
        if not outside.wait(self._timing.start_s, lambda: all(map(outside.present, topics))):
            self.note_absent(outside, topics, 0)
            return False
        outside.wait(_SUBSCRIBE_S, lambda: any(map(outside.heard, questions)), topics)
        return True

    def begin(self, frame: int, time_ns: int) -> None:
        """A frame has begun; in real time, the questions of earlier ones are given up."""
        self._times[frame] = time_ns
        if len(self._times) > KEPT:
            del self._times[min(self._times)]
            oldest = min(self._times)
            self._open = {key: late for key, late in self._open.items() if key[0] >= oldest}
            self._answered = {key for key in self._answered if key[0] >= oldest}
        for key in self._open:
            self._open[key] = self._open[key] or key[0] < frame

    def ask(self, outside: Outside, frame: int, topics: Collection[str]) -> None:
        """A question about a frame is sent next, answered on these topics; what came before is no answer to it."""
        self._early.extend(self._take(outside))
        for topic in topics:
            self._open[frame, topic] = False
            self.counts["asked"] += 1

    def open_frame(self, outside: Outside, frame: int, time_ns: int, topics: Collection[str]) -> None:
        """Begin a frame and ask about it, with its clock."""
        self.begin(frame, time_ns)
        self.ask(outside, frame, topics)
        if self.clock_topic:
            outside.send(self.clock_topic, clock(time_ns))

    def collect(self, outside: Outside, frame: int) -> list[Answer]:
        """The answers that have arrived; in lock-step, those to the questions about a frame are waited for."""
        answers, self._early = self._early, []

        def settled() -> bool:
            answers.extend(self._take(outside))
            return not self._missing(frame)

        if not outside.waits:
            settled()
            return answers
        limit_s = self._timing.wait_s if self._silent < MOST_SILENT else min(BRIEF_S, self._timing.wait_s)
        if outside.wait(limit_s, settled, self._missing(frame)):
            self._silent = 0
            return answers
        missing = self._missing(frame)
        self._silent += 1
        self.note_missing(outside, missing, frame)
        for topic in missing:
            self._open[frame, topic] = True
        return answers

    def results(self, outside: Outside) -> dict[str, Any]:
        """The counts, for the results of a node."""
        if not outside.waits:
            newest = max(self._times, default=0)
            self.note_absent(outside, self._missing(newest), newest)
        return super().results(outside)

    # -- inside --------------------------------------------------------------------------------------------------------

    def _missing(self, frame: int) -> list[str]:
        return [topic for about, topic in self._open if about == frame and not self._open[about, topic]]

    def _take(self, outside: Outside) -> Iterator[Answer]:
        for arrival in self._without_floods(outside.take()):
            try:
                if arrival.topic in self._topics:
                    self.note_publisher(arrival)
                    yield self._answer(self._topics[arrival.topic], arrival.message, outside)
                else:
                    self._add_transforms(arrival.message, static=arrival.topic == TF_STATIC)
            except MessageError as error:
                self.refuse(error)

    def _without_floods(self, arrivals: list[Arrival]) -> list[Arrival]:
        """What has arrived, without the messages with most transforms if these are too many."""
        sizes = {
            row: len(each.message.transforms) for row, each in enumerate(arrivals) if each.topic not in self._topics
        }
        left = MOST_TRANSFORMS_AT_ONCE
        for row, size in sorted(sizes.items(), key=lambda item: item[1]):
            left -= size
            if left < 0:
                self.refuse(MessageError(f"too many transforms: more than {MOST_TRANSFORMS_AT_ONCE} at once"))
                del sizes[row]
        return [each for row, each in enumerate(arrivals) if row in sizes or each.topic in self._topics]

    def _answer(self, topic: AnswerTopic, message: RosMessage, outside: Outside) -> Answer:
        received = topic.read(message)
        about = self._about(received.time_ns, topic.name, outside)
        placement = self.transforms.place(received.frame_id, received.time_ns, about.time_ns + about.skew_ns)
        if about.late:  # it is slow, not silent; what uses the answer may refuse it
            self._silent = 0
        content = topic.use(received, about, placement)
        for reason, number in getattr(received, "dropped", {}).items():
            self.leave_out(reason, number)
        self.unclassified += getattr(received, "unclassified", 0)
        del self._open[about.frame, topic.name]
        self._answered.add((about.frame, topic.name))
        self.note_answer(topic.name, about.frame, late=about.late)
        return Answer(topic.name, about, content)

    def _about(self, stamp_ns: int, topic: str, outside: Outside) -> About:
        """The frame that a stamp belongs to: the nearest one, no further away than is allowed."""
        time_ns = self._scene_time(stamp_ns, outside)
        frame = min(self._times, key=lambda frame: (abs(self._times[frame] - time_ns), frame), default=None)
        if frame is None or abs(self._times[frame] - time_ns) > self._timing.skew_s * 1e9:
            if self._times and time_ns < min(self._times.values()):  # it is at work on what it got long ago
                self._silent = 0
            raise MessageError(f"stamp: found {stamp_ns} ns, expected at most {self._timing.skew_s:g} s from a frame")
        late, is_newest = self._open.get((frame, topic)), frame == max(self._times)
        skew_ns = time_ns - self._times[frame]
        # In lock-step, the scene's time stands still: what is nearer to the next frame is about that one.
        if outside.waits and is_newest and 2 * skew_ns > self._period_ns() > 0:
            raise MessageError(f"before its question: found {skew_ns} ns after the newest frame")
        if late is None:
            if (frame, topic) in self._answered:
                raise MessageError("duplicate: another answer to this question")
            raise MessageError("before its question: not asked yet" if is_newest else "no question: not asked")
        return About(frame, self._times[frame], skew_ns, late)

    def _period_ns(self) -> int:
        """The shortest time between two of the newest frames, ns; 0: unknown."""
        return min((after - before for before, after in itertools.pairwise(sorted(self._times.values()))), default=0)

    def _scene_time(self, stamp_ns: int, outside: Outside) -> int:
        """The scene's time at a stamp; raises MessageError for a wall-clock time before the first frame."""
        if self._timing.stamps == "scene":
            return stamp_ns
        arrivals = {frame: at for frame, at in outside.clock_arrivals_ns.items() if frame in self._times}
        frames = sorted(frame for frame, at in arrivals.items() if at <= stamp_ns)
        if not frames:
            raise MessageError(f"stamp: found {stamp_ns} ns, expected a time after the first clock")
        frame = frames[-1]
        if outside.waits:  # the scene's time stands still within a frame
            return self._times[frame]
        # Between two clocks by their times of arrival; after the newest one, at the pace before it.
        other = min((other for other in arrivals if other > frame), default=frames[-2] if len(frames) > 1 else None)
        pace = 1.0
        if other is not None:
            pace = (self._times[other] - self._times[frame]) / ((arrivals[other] - arrivals[frame]) or 1)
        return self._times[frame] + round((stamp_ns - arrivals[frame]) * pace)

    def _add_transforms(self, message: RosMessage, *, static: bool) -> None:
        received = received_transforms(message)
        for reason, number in received.dropped.items():
            self.leave_out(reason, number)
        for parent, child, time_ns, position, rotation in received.transforms:
            try:
                self.transforms.add(parent, child, time_ns, Placement(position, rotation), static=static)
            except MessageError as error:
                self.leave_out(str(error).partition(":")[0], 1)
