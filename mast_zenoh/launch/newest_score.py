"""The score of the newest frame of a run: what the main agent's picture misses and invents, while the run plays.

It reads three keys (clock, truth, and the picture as the main agent receives it), decodes one frame at a time, and
scores it as the evaluator will. In real time it measures the latency of the picture too.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable
from statistics import median
from typing import Any, NamedTuple

import zenoh

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.config import registry
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.control.results import EVALUATOR
from mast_zenoh.errors import MastError
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Message
from mast_zenoh.metrics import Record, Scorer, Series
from mast_zenoh.metrics.record import PICTURE_RECEIVED, Snapshot
from mast_zenoh.runtime.host import Outgoing
from mast_zenoh.runtime.protocol.stamp import stamp_of
from mast_zenoh.wiring.model import TAP, Wiring

_TRUTHS = 16  # frames by which a picture may be late and still be scored
_PICTURES = 16  # whose latencies are measured at once
_CLOCKS = 256
_MAX_BYTES = 1 << 20  # of a scored message, about 1,000 objects: the launcher must not be kept busy by a hostile one


class NewestScore(NamedTuple):
    """Counts of objects in the picture of an agent about a frame.

    rmse_m: of the matched objects, m; None without any
    latency_ms: median of the newest pictures, from the clock of their frame to their arrival; None in lock-step
    """

    agent: str
    frame: int
    missed: int
    false: int
    matched: int
    rmse_m: float | None
    latency_ms: float | None = None


class ScoredKeys(NamedTuple):
    """Main agent of a run, and the keys of clock and truth and of the picture that it receives."""

    agent: str
    clock: str
    truth: str
    picture: str
    scorer: Scorer


def scored_keys(resolved: Resolved) -> ScoredKeys | None:
    """What is scored; None if the run has no evaluator, or no picture that can be read without touching its wires."""
    evaluator = resolved.nodes.get(EVALUATOR)
    agents = evaluator.config.get("agents") if evaluator else None
    if not evaluator or not agents:
        return None
    keys = {}
    for wire in Wiring.from_json(resolved.wiring).wires:
        ends = {end.node: leg.key for leg in wire.every_leg for end in leg.subscribers}
        keys[wire.message] = ends.get(agents[0], "") if wire.message == "picture" else wire.legs[0].key
    clock, truth, picture = (keys.get(message, "") for message in ("clock", "truth", "picture"))
    if not (clock and truth and picture) or TAP in picture.split("/"):
        return None
    try:
        scorer = registry.build(evaluator.config.get("scorer") or {"type": "Scorer"}, Scorer, "scorer")
    except MastError:  # of a user's own evaluator
        return None
    return ScoredKeys(str(agents[0]), clock, truth, picture, scorer)


def score(keys: ScoredKeys, truth: Message, picture: Message) -> NewestScore | None:
    """The score of a picture; None if it or the truth does not fit the run."""
    frame, body = truth.header.frame, truth.body
    record = Record([str(name) for name in body["agents"]])
    try:
        objects = ObjectStates.of(
            body["position"], id=body["id"], size=body["size"], yaw=body["yaw"], velocity=body["velocity"]
        )
        record.add_truth(frame, objects, body["points"], body["agent_position"], body["agent_object"])
        states = Snapshot.of(ObjectStates.from_columns(picture.body))
        record.add(frame, [Series(keys.agent, PICTURE_RECEIVED)], states)
        scores = keys.scorer.score(record)
    except ValueError:
        return None
    missed, false, matched = (int(counts[0, 0]) for counts in (scores.fn, scores.fp, scores.tp))
    rmse_m = float((scores.squared_error[0, 0] / matched) ** 0.5) if matched else None
    return NewestScore(keys.agent, frame, missed, false, matched, rmse_m)


class InProcessScores:
    """Scores of a run in this process; `take` is given every message that is sent."""

    def __init__(self, keys: ScoredKeys) -> None:
        self._keys = keys
        self._truths: deque[Outgoing] = deque(maxlen=_TRUTHS)
        self._pictures: deque[Outgoing] = deque(maxlen=1)
        self._kept = {keys.truth: self._truths, keys.picture: self._pictures}

    def take(self, message: Outgoing) -> None:
        """Keep a message if it is needed."""
        if message.key in self._kept:
            self._kept[message.key].append(message)

    def newest(self) -> NewestScore | None:
        """The score of the newest picture."""
        messages = [each.payload for each in (*self._truths, *self._pictures) if isinstance(each.payload, Message)]
        if not self._pictures or not messages:
            return None
        *truths, picture = messages
        truth = next((each for each in truths if each.header.frame == picture.header.frame), None)
        return None if truth is None else score(self._keys, truth, picture)


class MeshScores:
    """Scores of a run on a mesh, through a session of the router in this process."""

    def __init__(self, session: zenoh.Session, prefix: str, keys: ScoredKeys, *, realtime: bool) -> None:
        self._keys = keys
        self._truths: deque[tuple[int, zenoh.Sample]] = deque(maxlen=_TRUTHS)
        self._arrivals: deque[tuple[int, zenoh.Sample]] = deque(maxlen=_PICTURES)
        self._clocks: deque[tuple[int, zenoh.Sample]] = deque(maxlen=_CLOCKS)
        ring = zenoh.handlers.RingChannel
        self._truth: Any = session.declare_subscriber(f"{prefix}/{keys.truth}", ring(_TRUTHS))
        # A ring costs less, but does not say when a message has arrived. Only real time has latencies.
        into = [_timed(queue) if realtime else ring(1) for queue in (self._arrivals, self._clocks)]
        self._picture: Any = session.declare_subscriber(f"{prefix}/{keys.picture}", into[0])
        self._clock: Any = session.declare_subscriber(f"{prefix}/{keys.clock}", into[1]) if realtime else None

    def newest(self) -> NewestScore | None:
        """The score of the newest picture; None if there is none, or its truth is not known any more."""
        for sample in _taken(self._truth):
            if len(sample.payload) <= _MAX_BYTES:
                self._truths.append((_step(sample), sample))
        if self._clock is None:
            self._arrivals.extend((0, sample) for sample in _taken(self._picture))
        arrivals = list(self._arrivals)
        if not arrivals:
            return None
        try:
            newest = arrivals[-1][1].payload
            if len(newest) > _MAX_BYTES:
                return None
            picture = codec.decode(newest.to_bytes(), "picture")
            truth = dict(self._truths).get(picture.header.frame)
            scored = (
                None if truth is None else score(self._keys, codec.decode(truth.payload.to_bytes(), "truth"), picture)
            )
        except MastError:  # what is no message is not scored
            return None
        return None if scored is None else scored._replace(latency_ms=self._latency_ms(arrivals))

    def close(self) -> None:
        """End the subscriptions."""
        for subscriber in (self._truth, self._picture, self._clock):
            if subscriber is not None:
                subscriber.undeclare()

    def _latency_ms(self, arrivals: Iterable[tuple[int, zenoh.Sample]]) -> float | None:
        if self._clock is None:
            return None
        began = {_step(sample): at_ns for at_ns, sample in reversed(list(self._clocks))}
        latencies = []
        for at_ns, sample in arrivals:
            if len(sample.payload) > _MAX_BYTES:
                continue
            try:
                frame = codec.decode_header_only(sample.payload.to_bytes(), "picture").frame
            except MastError:  # anybody may send anything on an open mesh
                continue
            if frame in began:
                latencies.append((at_ns - began[frame]) * 1e-6)
        return median(latencies) if latencies else None


def _timed(queue: deque[tuple[int, zenoh.Sample]]) -> Any:
    """A handler that only notes each message with the time of its arrival, ns."""
    now: Callable[[], int] = time.monotonic_ns
    return zenoh.handlers.Callback(lambda sample: queue.append((now(), sample)), indirect=False)


def _taken(subscriber: Any) -> list[zenoh.Sample]:
    samples = []
    while (sample := subscriber.try_recv()) is not None:
        samples.append(sample)
    return samples


def _step(sample: zenoh.Sample) -> int:
    return stamp_of(sample.attachment)[1]
