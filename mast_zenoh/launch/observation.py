"""What a terminal shows of a run: states of processes, what nodes send, the newest score, current events.

Nothing here is a node's own account. Messages that arrive are counted, and the steps in their stamps are read: Zenoh
keeps the newest messages of a key without running Python, so a watched message costs the launcher a microsecond or two.
The score is that of the newest picture, as the main agent receives it, scored as the evaluator will score it.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from statistics import median
from typing import Any, NamedTuple

import zenoh

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.config import registry
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import MastError
from mast_zenoh.launch.context import RunContext
from mast_zenoh.launch.supervisor import Child
from mast_zenoh.mesh.control import prefix
from mast_zenoh.mesh.control.results import EVALUATOR
from mast_zenoh.mesh.host import Outgoing
from mast_zenoh.mesh.protocol.traffic import MISDIRECTED, stamp_of
from mast_zenoh.mesh.session import direct
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Message
from mast_zenoh.metrics import Record, Scorer, Series
from mast_zenoh.metrics.estimates import PICTURE_RECEIVED
from mast_zenoh.metrics.record import Snapshot
from mast_zenoh.wiring.model import TAP, Wiring


class Status(NamedTuple):
    """What is shown of a run.

    frame:  number of frames that have begun
    states: of every node, one word
    activities: of nodes that are heard
    events: attacks, faults and interceptions of this moment
    score:  of the newest picture; None: not known
    """

    frame: int
    states: Mapping[str, str]
    activities: Mapping[str, Activity]
    events: Sequence[str] = ()
    score: NewestScore | None = None


_CAPACITY = 32  # messages of a key between two calls of `read`; with more, missing ones are not counted
_WINDOW_S = 2.0  # over which rates are measured
_SHORTEST_S = 0.2  # for a rate

#: Message types that a node sends in every frame, even if there is nothing in them.
_EVERY_FRAME = ("clock", "truth", "tracks", "collated", "picture")


class Activity(NamedTuple):
    """What one node has sent lately; None: not known.

    rate_hz: frames per second in which it has sent something
    lag:     frames by which its newest message is behind the scene
    drops:   frames without a message, between the first and the newest one
    """

    rate_hz: float | None = None
    lag: int | None = None
    drops: int | None = None


class Activities:
    """Watches one key of each node, through the router's own session: its messages cross no link for that.

    frame: returns the newest frame of the run
    Hidden legs are not watched: their publishers wait until the node behind them has subscribed.
    """

    def __init__(self, session: zenoh.Session, prefix: str, wiring: Wiring, frame: Callable[[], int]) -> None:
        self._frame = frame
        self._keys = {
            node: _Key(session, prefix, key, counted=counted) for node, (key, counted) in watched_keys(wiring).items()
        }

    def read(self) -> None:
        """Take what has arrived; to be called often, such as 20 times a second."""
        for key in self._keys.values():
            key.read(self._frame)

    def of(self, node: str) -> Activity:
        """What a node has sent, as of the last `read`."""
        key = self._keys.get(node)
        return Activity() if key is None else key.activity(self._frame())

    def close(self) -> None:
        """End the subscriptions."""
        for key in self._keys.values():
            key.subscriber.undeclare()
        self._keys = {}


def watched_keys(wiring: Wiring) -> dict[str, tuple[str, bool]]:
    """By node, the key on which it is heard, and whether it sends something there in every frame.

    A leg before an interposer only where the node sends nothing else in every frame.
    """
    ranked: dict[str, tuple[tuple[bool, bool], str]] = {}
    for wire, leg in wiring.legs():
        node, rank = leg.publisher.node, (wire.message in _EVERY_FRAME, TAP not in leg.key.split("/"))
        if node not in ranked or rank > ranked[node][0]:
            ranked[node] = rank, leg.key
    return {node: (key, counted) for node, ((counted, _), key) in ranked.items()}


class _Key:
    """The messages of one key: the newest step, and the number of frames with and without a message."""

    def __init__(self, session: zenoh.Session, prefix: str, key: str, *, counted: bool) -> None:
        self.subscriber: Any = session.declare_subscriber(f"{prefix}/{key}", zenoh.handlers.RingChannel(_CAPACITY))
        self._key = key
        self._counted = counted
        self._newest = -1
        self._frames = 0
        self._drops = 0
        self._history: deque[tuple[float, int]] = deque()  # times of `read`, s, and frames up to then

    def read(self, frame: Callable[[], int]) -> None:
        """Take what has arrived."""
        steps: list[int] = []
        while (sample := self.subscriber.try_recv()) is not None:
            steps.append(_step(sample, self._key))
        # A step beyond the scene is forged. Its clock may arrive here a moment after the message.
        newest = max((step for step in steps if step <= frame() + 1), default=-1)
        if newest > self._newest:
            passed = newest - self._newest if self._newest >= 0 else 1
            seen = passed if len(steps) >= _CAPACITY else len({step for step in steps if self._newest < step <= newest})
            self._frames += seen
            self._drops += max(0, passed - seen)
            self._newest = newest
        now = time.monotonic()
        self._history.append((now, self._frames))
        while now - self._history[0][0] > _WINDOW_S:
            self._history.popleft()

    def activity(self, frame: int) -> Activity:
        """What has arrived up to the last `read`; frame: the newest of the run."""
        if self._newest < 0:
            return Activity()
        (begun, before), (now, frames) = self._history[0], self._history[-1]
        rate_hz = (frames - before) / (now - begun) if now - begun >= _SHORTEST_S else None
        return Activity(rate_hz, max(0, frame - self._newest), self._drops if self._counted else None)


_TRUTHS = 16  # frames by which a picture may be late and still be scored
_PICTURES = 16  # whose latencies are measured at once
_CLOCKS = 256
_MAX_BYTES = 1 << 20  # of a scored message, about 1,000 objects: the launcher must not be kept busy by a hostile one


class NewestScore(NamedTuple):
    """Counts of objects in the picture of an agent about a frame.

    rmse_m: of the matched objects, m; None without any
    latency_ms: median of the newest pictures, from the clock of their frame to their arrival; None in lock-step, and
        until a picture has arrived whose clock was heard
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
        self._clock: Any = session.declare_subscriber(f"{prefix}/{keys.clock}", into[1]) if realtime else None
        self._picture: Any = session.declare_subscriber(f"{prefix}/{keys.picture}", into[0])

    def newest(self) -> NewestScore | None:
        """The score of the newest picture; None if there is none, or its truth is not known any more."""
        for sample in _taken(self._truth):
            if len(sample.payload) <= _MAX_BYTES:
                self._truths.append((_step(sample, self._keys.truth), sample))
        if self._clock is None:
            self._arrivals.extend((0, sample) for sample in _taken(self._picture))
        picture_key = self._keys.picture
        arrivals = [item for item in list(self._arrivals) if _step(item[1], picture_key) != MISDIRECTED[1]]
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
        began = {_step(sample, self._keys.clock): at_ns for at_ns, sample in reversed(list(self._clocks))}
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
    return direct(lambda sample: queue.append((now(), sample)))


def _taken(subscriber: Any) -> list[zenoh.Sample]:
    samples = []
    while (sample := subscriber.try_recv()) is not None:
        samples.append(sample)
    return samples


def _step(sample: zenoh.Sample, key: str) -> int:
    return stamp_of(sample.attachment, key)[1]


_SCORE_PERIOD_S = 0.5
_SCORE_SHARE = 0.02  # of the launcher's time that scoring takes at most


class Observation:
    """Observes a run for the display, through the session of the router in this process.

    session: None: no router is here, so only the processes are observed: observing more would cost the network

    It subscribes after the first frame, when every publisher has found its subscribers, and anew after each change of
    the wiring. It decodes nothing but one truth and one picture, twice a second.
    """

    def __init__(self, context: RunContext, session: zenoh.Session | None) -> None:
        self._context = context
        self._session = session
        self._observed: Resolved | None = None
        self._activities: Activities | None = None
        self._scores: MeshScores | None = None
        self._score = _Throttled(lambda: None if self._scores is None else self._scores.newest())

    def advance(self) -> None:
        """Take what has arrived; to be called in every iteration of the launcher's loop."""
        if self._session is None or self._context.frame < 0:
            return
        if self._observed is not self._context.resolved:
            self._follow(self._session, self._context.resolved)
        if self._activities is not None:
            self._activities.read()

    def close(self) -> None:
        """End all subscriptions."""
        for part in (self._activities, self._scores):
            if part is not None:
                part.close()
        self._activities = self._scores = None

    def status(self, children: Mapping[str, Child], waiting: str = "") -> Status:
        """What is to be shown now; waiting: for which nodes the end of the run waits."""
        context = self._context
        states = {name: state_of(child, context.frame) for name, child in children.items()}
        activities = {} if self._activities is None else {name: self._activities.of(name) for name in children}
        inserted = interceptions(context.record.get("interceptions", ()))
        inserted += [waiting] if waiting else []
        return _status(context.resolved, context.frame, states, activities, inserted, self._score.newest())

    def _follow(self, session: zenoh.Session, resolved: Resolved) -> None:
        self.close()
        self._observed = resolved
        base = prefix(self._context.run_id)
        wiring = Wiring.from_json(resolved.wiring)
        self._activities = Activities(session, base, wiring, lambda: self._context.frame)
        keys = scored_keys(resolved)
        if keys is not None:
            self._scores = MeshScores(session, base, keys, realtime=resolved.mode == "realtime")


class InProcessObservation:
    """Observes a run in this process: all nodes are always at the same frame, and nothing is lost between them.

    scored: whether to score the picture
    tap:    for `InProcess`, takes every message that is sent; None: nothing is scored
    """

    def __init__(self, resolved: Resolved, *, scored: bool) -> None:
        self._resolved = resolved
        self._keys = scored_keys(resolved) if scored else None
        self.tap = None if self._keys is None else self._take
        self._truths: deque[Message] = deque(maxlen=_TRUTHS)
        self._picture: Message | None = None
        self._score = _Throttled(self._newest)

    def status(self, frame: int, present: Iterable[str]) -> Status:
        """What is to be shown; frame: number of frames played; present: the nodes that have not left."""
        here = set(present)
        states = {name: "running" if name in here else "away" for name in self._resolved.nodes}
        return _status(self._resolved, frame - 1, states, {}, [], self._score.newest())

    def _take(self, message: Outgoing) -> None:
        """Keep a message if it is needed to score the picture."""
        if self._keys is not None and isinstance(message.payload, Message):
            if message.key == self._keys.truth:
                self._truths.append(message.payload)
            elif message.key == self._keys.picture:
                self._picture = message.payload

    def _newest(self) -> NewestScore | None:
        if self._keys is None or self._picture is None:
            return None
        frame = self._picture.header.frame
        truth = next((each for each in self._truths if each.header.frame == frame), None)
        return None if truth is None else score(self._keys, truth, self._picture)


def _status(
    resolved: Resolved,
    frame: int,
    states: Mapping[str, str],
    activities: Mapping[str, Activity],
    interceptions: Sequence[str],
    score: NewestScore | None,
) -> Status:
    """What is shown of a frame: nodes that run and are attacked, or have a fault, are in that state."""
    events = current_events(resolved, frame)
    struck = {name: event["kind"] for event in events for name in event["nodes"]}
    states = {name: struck.get(name, state) if state == "running" else state for name, state in states.items()}
    labels = [f"{event['kind']}: {event['label']}" for event in events]
    return Status(frame + 1, states, activities, [*labels, *interceptions], score)


class _Throttled:
    """The score of the newest picture, computed twice a second or less."""

    def __init__(self, score: Callable[[], NewestScore | None]) -> None:
        self._compute = score
        self._score: NewestScore | None = None
        self._next_s = 0.0

    def newest(self) -> NewestScore | None:
        """The score, or the previous one."""
        begun = time.monotonic()
        if begun >= self._next_s:
            self._score = self._compute()
            done = time.monotonic()
            self._next_s = max(begun + _SCORE_PERIOD_S, done + (done - begun) / _SCORE_SHARE)
        return self._score


def state_of(child: Child, frame: int) -> str:
    """The state of a process as one word; frame: the newest of the run, -1 before the first."""
    if child.exit is not None:
        return "done" if child.exit == 0 and child.handed_in else "away" if child.exit_expected else "dead"
    if child.paused:
        return "paused"
    if child.cut_off:
        return "cut off"
    return "running" if frame >= 0 else "starting"


def current_events(resolved: Resolved, frame: int) -> list[dict[str, Any]]:
    """The attacks and faults of the scenario's timeline that are active in a frame."""
    now_s = frame * resolved.period_ns * 1e-9
    return [
        event
        for event in resolved.timeline
        if frame >= 0 and event["at_s"] <= now_s and (event["until_s"] is None or now_s < event["until_s"])
    ]


def interceptions(changes: Iterable[Mapping[str, Any]]) -> list[str]:
    """The nodes that were inserted during the run and are still there; changes: of run.json."""
    present: dict[str, str] = {}
    for change in changes:
        present.pop(change["node"], None)
        if change["action"] == "intercept":
            present[change["node"]] = f"interception: {change['node']} on {', '.join(change['wires'])}"
    return list(present.values())
