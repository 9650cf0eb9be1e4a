"""What a terminal shows of a run on a mesh: states of processes, what nodes send, the newest score, current events."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import zenoh

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.control import prefix
from mast_zenoh.launch.activity import Activities
from mast_zenoh.launch.context import RunContext
from mast_zenoh.launch.display import Status
from mast_zenoh.launch.newest_score import InProcessScores, MeshScores, NewestScore, scored_keys
from mast_zenoh.launch.supervisor import Child
from mast_zenoh.wiring.model import Wiring

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

    def status(self, children: Mapping[str, Child]) -> Status:
        """What is to be shown now."""
        context = self._context
        events = current_events(context.resolved, context.frame)
        struck = {name: event["kind"] for event in events for name in event["nodes"]}
        states = {name: state_of(child, context.frame) for name, child in children.items()}
        states = {name: struck.get(name, state) if state == "running" else state for name, state in states.items()}
        activities = {} if self._activities is None else {name: self._activities.of(name) for name in children}
        labels = [*map(label_of, events), *interceptions(context.record.get("interceptions", ()))]
        return Status(context.frame + 1, states, activities, labels, self._score.newest())

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
    tap:    for `InProcess`; None: not scored
    """

    def __init__(self, resolved: Resolved, *, scored: bool) -> None:
        self._resolved = resolved
        keys = scored_keys(resolved) if scored else None
        scores = None if keys is None else InProcessScores(keys)
        self.tap = None if scores is None else scores.take
        self._scores = _Throttled(lambda: None if scores is None else scores.newest())

    def status(self, frame: int, present: Iterable[str]) -> Status:
        """What is to be shown; frame: number of frames played; present: the nodes that have not left."""
        events = current_events(self._resolved, frame - 1)
        struck = {name: event["kind"] for event in events for name in event["nodes"]}
        here = set(present)
        states = {name: struck.get(name, "running") if name in here else "away" for name in self._resolved.nodes}
        return Status(frame, states, {}, list(map(label_of, events)), self._scores.newest())


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


def label_of(event: Mapping[str, Any]) -> str:
    """`attack: CoordinatedAttack adversary_1, adversary_2`."""
    return f"{event['kind']}: {event['label']}"


def interceptions(changes: Iterable[Mapping[str, Any]]) -> list[str]:
    """The nodes that were inserted during the run and are still there; changes: of run.json."""
    present: dict[str, str] = {}
    for change in changes:
        present.pop(change["node"], None)
        if change["action"] == "intercept":
            present[change["node"]] = f"interception: {change['node']} on {', '.join(change['wires'])}"
    return list(present.values())
