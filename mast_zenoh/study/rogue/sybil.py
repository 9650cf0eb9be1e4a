"""An outsider that invents agents."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import zenoh

from mast_zenoh.arrays.states import CLASS_INDEX, ObjectStates
from mast_zenoh.errors import ConfigurationError, MessageError
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header, Message
from mast_zenoh.streams import stream
from mast_zenoh.study.rogue.attacked_run import NOTHING, AttackedRun
from mast_zenoh.study.rogue.attempts import Attempt, Outcome

_FRAME_S = 10.0
_FLUSH_S = 0.5
#: Variances of a false track: x y z l w h vx vy vz.
_VARIANCE = np.diag([0.04] * 3 + [0.02] * 3 + [0.5] * 3)


class Sybil(Attempt):
    """Send tracks in the name of an agent that does not run: one message a frame, with valid headers.

    On an open mesh the broker takes it for an agent that joins, and collates its tracks. The broker subscribes to the
    agents of the scenario by name, so an agent that no scenario has is heard nowhere. With ACLs nobody but the agent
    itself may publish on its keys.

    identity: name of the agent; objects: number of standing vehicles that it claims, within `spread_m` of the origin
    messages: number of frames; seed: of the places
    The outcome's `heard` is the number of the broker's batches with tracks of this agent that the outsider overheard.
    """

    def __init__(
        self,
        name: str,
        identity: str,
        shows: str = NOTHING,
        objects: int = 3,
        spread_m: float = 30.0,
        messages: int = 10,
        seed: int = 0,
    ) -> None:
        super().__init__(name, shows)
        if objects < 0 or messages < 1:
            raise ValueError(f"objects, messages: found {objects}, {messages}, expected 0 and 1 or more")
        self.identity = identity
        self.messages = messages
        position = stream(seed, "sybil", identity).uniform(-spread_m, spread_m, (objects, 3))
        position[:, 2] = 0.8
        self._states = ObjectStates.of(
            position,
            size=np.tile([4.4, 1.8, 1.6], (objects, 1)),
            covariance=np.tile(_VARIANCE, (objects, 1, 1)),
            class_id=np.full(objects, CLASS_INDEX["car"], np.uint8),
        )

    @property
    def key(self) -> str:
        return f"agent/{self.identity}/tracks"

    def make(self, attacked_run: AttackedRun) -> Outcome:
        outcome = Outcome(key=self.key, expected=self.messages * self._receivers(attacked_run))
        try:
            session = attacked_run.join(self.shows)
        except zenoh.ZError:
            return outcome
        with session, self._overheard(attacked_run, session) as batches:
            outcome.admitted = True
            for number in range(self.messages):
                _wait_for_next_frame(attacked_run)
                session.put(
                    f"{attacked_run.prefix}/{self.key}",
                    codec.encode(self.message(attacked_run.frame, attacked_run.period_ns, number)),
                    congestion_control=zenoh.CongestionControl.BLOCK,
                    express=True,
                )
                outcome.sent += 1
            threading.Event().wait(_FLUSH_S)
            outcome.heard = len(batches)
        return outcome

    def message(self, frame: int, period_ns: int, number: int) -> Message:
        """The tracks of a frame, in the world frame."""
        header = Header("tracks", self.identity, frame, frame * period_ns, number)
        reference = {"origin": np.zeros(3), "rotation": np.array([1.0, 0.0, 0.0, 0.0])}
        return codec.conform(header, self._states.columns() | reference)

    def _receivers(self, attacked_run: AttackedRun) -> int:
        """The number of nodes that receive its messages."""
        try:
            return attacked_run.subscriber_count(self.key)
        except ConfigurationError:  # no scenario has this agent
            return 0

    @contextmanager
    def _overheard(self, attacked_run: AttackedRun, session: zenoh.Session) -> Iterator[list[int]]:
        """The frames of overheard batches with tracks of this agent, while it is open."""
        frames: list[int] = []

        def take(sample: zenoh.Sample) -> None:
            try:
                batch = codec.decode(sample.payload.to_bytes(), "collated")
                if self.identity in batch.body["agents"].tolist():
                    frames.append(batch.header.frame)
            except MessageError:
                pass  # of another outsider

        handler = zenoh.handlers.Callback(take, indirect=False)
        subscriber = session.declare_subscriber(f"{attacked_run.prefix}/cc/collated", handler)
        try:
            yield frames
        finally:
            subscriber.undeclare()


def _wait_for_next_frame(attacked_run: AttackedRun) -> None:
    last = attacked_run.frame
    attacked_run.wait(lambda: attacked_run.frame > last, _FRAME_S, "the run continues")
