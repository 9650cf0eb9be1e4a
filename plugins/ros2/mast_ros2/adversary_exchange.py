"""What an adversary sends to ROS 2, messages in transit, and what it forwards instead of them.

A row that comes back with the values that were sent keeps its bytes, although ROS cannot express all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_ros2 import type_store
from mast_ros2.frame_exchange import About, AnswerTopic, FrameExchange, Timing
from mast_ros2.liveliness_tokens import ros2_name, topic_prefix
from mast_ros2.object_messages import detection_array, states_of, tracked_objects
from mast_ros2.received_objects import ReceivedObjects, received_tracks
from mast_ros2.received_poses import FrameTransforms, Placement
from mast_ros2.type_store import RosMessage
from mast_zenoh.arrays.states import DETECTION_COLUMNS, Detections, ObjectStates
from mast_zenoh.errors import MessageError
from mast_zenoh.messages.schemas import Body
from mast_zenoh.outside import Outside
from mast_zenoh.tracking.kalman import predicted

Columns = dict[str, NDArray[Any]]

#: The type of the messages about each type of wire.
WIRE_TYPES: Mapping[str, str] = {
    "detections": type_store.DETECTIONS,
    "tracks": type_store.TRACKED_OBJECTS,
    "picture": type_store.TRACKED_OBJECTS,
}
#: Frame of reference that all messages are in: that of the wire, whatever it is.
FRAME = "intercepted"


@dataclass(frozen=True, slots=True)
class _InTransit:
    """A message in transit.

    type: of the message;  body: its columns
    expressed: its objects as they come back if nobody changes them, those that ROS can express
    """

    type: str
    body: Body
    expressed: ObjectStates

    def forged(self, returned: ObjectStates) -> Columns | None:
        """The columns to forward when these objects come back; None: the message as it was.

        An object with an id that was sent is that object: what is equal to what was sent keeps its bytes. Objects that
        ROS cannot express stay as they are, and no other one gets their ids.
        """
        ids = np.arange(len(self.body["score"])) if self.type == "detections" else self.body["id"]
        row_of_id = {number: row for row, number in enumerate(ids.tolist())}
        sent = {number: row for row, number in enumerate(self.expressed.id.tolist())}
        hidden_ids = row_of_id.keys() - sent.keys()
        hidden = sorted(row_of_id[number] for number in hidden_ids)
        returned = returned.select(np.array([number not in hidden_ids for number in returned.id.tolist()], bool))
        known = np.array([row for row, number in enumerate(returned.id.tolist()) if number in sent], int)
        sent_rows = [sent[number] for number in returned.id[known].tolist()]
        rows = np.array([row_of_id[number] for number in returned.id[known].tolist()], int)
        columns, untouched = {}, len(known) == len(returned) and sent_rows == [*range(len(self.expressed))]
        expressed = _columns(self.type, self.expressed)
        for name, values in _columns(self.type, returned).items():
            equal = values[known] == expressed[name][sent_rows]
            equal = equal.all(axis=tuple(range(1, equal.ndim)))
            untouched = untouched and bool(equal.all())
            column = values.astype(self.body[name].dtype)
            column[known[equal]] = self.body[name][rows[equal]]
            columns[name] = np.concatenate([column, self.body[name][hidden]])
        if untouched:
            return None
        if "support" in self.body:
            support = self.body["support"]
            usual = int(np.median(support)) if len(support) else 1
            own = np.full(len(returned), usual, np.int64)
            own[known] = support[rows]
            columns["support"] = np.concatenate([own, support[hidden]])
        return columns | {name: column for name, column in self.body.items() if name not in columns}


class AdversaryExchange(FrameExchange):
    """The exchange of one adversary.

    name: of its node;  wires: by (port, subject) of each, such as ("tracks", "infra_1"), the type of its messages

    What is in transit is sent on /mast/NAME/SUBJECT/PORT/in, and what comes back is received on .../out, both in the
    frame of reference of the wire, which is called `intercepted`. The wire of the picture has no subject.
    """

    def __init__(self, name: str, timing: Timing, wires: Mapping[tuple[str, str], str]) -> None:
        self._messages = wires
        self._types = {wire: WIRE_TYPES[message] for wire, message in wires.items()}
        self._sent: dict[tuple[str, int], _InTransit] = {}  # by topic of the answer, and frame
        self._prefix = topic_prefix(name)
        answers = [
            AnswerTopic(self.topic(wire, "out"), kind, received_tracks, self._use(self.topic(wire, "out")))
            for wire, kind in self._types.items()
        ]
        super().__init__(answers, FrameTransforms(FRAME), timing, listens_to_tf=False)

    def topic(self, wire: tuple[str, str], side: str) -> str:
        """The topic of a wire; side: in or out"""
        port, subject = wire
        return "/".join(part for part in (self._prefix, *map(ros2_name, subject.split("/")), port, side) if part)

    def join(self, outside: Outside) -> bool:
        """Make the topics known, and wait for a node that answers; False if there is none."""
        for wire, kind in self._types.items():
            outside.announce(self.topic(wire, "in"), kind)
        return self.start(outside, [self.topic(wire, "in") for wire in self._types])

    def send(self, outside: Outside, frame: int, wire: tuple[str, str], body: Body) -> bool:
        """Send a message in transit, and ask about it.

        False: it cannot be sent, because its frame is too old or was sent already, because ROS cannot express it, or
        because its wire was not there at the start.
        """
        topic, time_ns = self.topic(wire, "out"), self._times.get(frame)
        if time_ns is None or (topic, frame) in self._sent or wire not in self._types:
            return False
        try:
            message = _message(self._messages[wire], body, time_ns)
            expressed = received_tracks(type_store.decode(message.__msgtype__, type_store.encode(message))).objects
        except (MessageError, ValueError) as error:
            self.refuse(MessageError(f"not sent: {error}"))
            return False
        self._sent[topic, frame] = _InTransit(self._messages[wire], body, expressed)
        for old in [key for key in self._sent if key[1] not in self._times]:
            del self._sent[old]
        self.ask(outside, frame, [topic])
        outside.send(self.topic(wire, "in"), message)
        return True

    def _use(self, topic: str) -> Callable[[ReceivedObjects[ObjectStates], About, Placement], Columns | None]:
        def use(received: ReceivedObjects[ObjectStates], about: About, placement: Placement) -> Columns | None:
            if about.late:
                raise MessageError("late: the message has been forwarded as it was")
            return self._sent[topic, about.frame].forged(predicted(received.objects, -about.skew_ns * 1e-9))

        return use


def _message(kind: str, body: Body, time_ns: int) -> RosMessage:
    if kind == "detections":
        return detection_array(states_of(Detections.from_columns(body)), time_ns, FRAME)
    return tracked_objects(ObjectStates.from_columns(body), time_ns, FRAME)


def _columns(kind: str, states: ObjectStates) -> Columns:
    """The columns of objects in a message of a type, by name."""
    columns = states.columns()
    if kind != "detections":
        return columns
    return {name: columns[name] for name in DETECTION_COLUMNS} | {"covariance": states.covariance[:, :3, :3]}
