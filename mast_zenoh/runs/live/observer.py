"""Observes a running run: its frames, as many as cost it nothing or all of them, and what happens to its nodes.

Zenoh's own threads fill queues of limited length, so nothing that is done with a frame holds back the run.

Puts the messages of a running run together to frames; what comes too late or is forged is counted.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import zenoh

from mast_zenoh.config.resolved import Resolved, driver_of
from mast_zenoh.errors import MessageError
from mast_zenoh.mesh.control import prefix
from mast_zenoh.mesh.session import direct
from mast_zenoh.messages import codec
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.live.address import LiveAddress
from mast_zenoh.runs.live.measurement import FrameMeter, seen
from mast_zenoh.runs.live.reception import KEPT, ArrivedMessage, Reception, Sample, WireMeter, WireState
from mast_zenoh.wiring.model import Wiring

#: Most frames a second that are measured.
_MOST_FRAMES_PER_S = 10.0
#: Share of a processor that measuring aims at, by mode. In lock-step every frame waits for the slowest node, so that
#: whatever else runs on this computer slows the run.
_PROCESSOR_SHARE = {"lockstep": 0.03, "realtime": 0.3}
#: s between two looks at what has arrived; where every frame is received.
POLL_S, EVERY_POLL_S = 0.05, 0.01
#: Frames behind the clock: by then, the messages about a frame have arrived.
_BEHIND = 2
#: Frames by which other keys can be ahead of the clock, which is taken first: with more, this process waited for a
#: processor meanwhile, and messages about the frames at the clock may have been dropped, so that it takes later ones,
#: some times at most, as anybody may forge a step on an open mesh.
_LEAD, _POLLS_AT_MOST = KEPT // 2, 5
#: s without a clock after which the last frame is taken if nothing of it is missing: the run has paused or ended.
_SILENCE_S = 0.5
#: Longest wait after a subscription for the keys on which nothing comes, s from the first clock on. On a busy machine,
#: publishers learn of a subscription late.
_SETTLING_S = 1.0
#: s between two questions whether a silent run is over.
_ASK_S = 2.0
#: Questions without an answer after which a run elsewhere has ended: one can get lost.
_QUESTIONS = 3
#: Fewest frames for which reception pauses: those after a new subscription are not whole.
_FEWEST_SKIPPED = 20
#: s before the end of a run from which on everything is received, so that its last frame can be measured.
_LAST_S = 0.5
#: Longest wait for an answer of the router, s.
_ROUTER_S = 1.0
_MOST_NOTES = 10
#: s for which the wiring is asked for after an epoch, and between two questions.
_ASK_WIRING_FOR_S, _ASK_WIRING_EVERY_S = 3.0, 0.5
_MOST_INTERCEPTIONS = 200
#: Whole frames that wait, above which there is no time to measure every one.
_MOST_WAITING = 5
#: s without measurements after which they are tried again, first and at most: each time twice as long.
_PAUSE_S, _LONGEST_PAUSE_S = 5.0, 320.0


class Observer:
    """Receives a run passively: it is no member of the mesh, and no node waits for it.

    session: a client of the run's router, with the viewer's credentials if the mesh is secure
    every:   all frames are received, and measured where there is time for it; else as many as the run does not feel

    run:    as of the newest frame that `frames` has measured;  interceptions: as in run.json, since it joined
    wiring: the current one;  meter: measures its frames;  address: how the run is reached
    types:  message types of the keys that frames need;  clock_key: the one of the clock
    tally:  of frames and messages, where every frame is received
    """

    def __init__(self, address: LiveAddress, session: zenoh.Session, *, every: bool = False) -> None:
        self.address = address
        self.session = session
        self.meter = FrameMeter(address.resolved)
        self.roles = address.roles
        self.interceptions: list[dict[str, Any]] = []
        self._base = prefix(address.id)
        timespan = address.resolved.timespan
        frames = None if timespan is None else max(1, timespan.frames)
        room = room_for(address.resolved) if every else KEPT
        self._reception = Reception(session, self._base, frames, room)
        self._wires = WireMeter(self._reception)
        self.types: dict[str, str] = {}
        self.clock_key = ""
        # In lock-step the next frame waits until all copies of a message have been sent. So if frames are fast, this
        # observer receives copies only for the moment that a measured frame needs.
        self._in_bursts = address.resolved.mode == "lockstep" and not every
        self._listening = self._receiving = True
        self._last = -1  # the newest frame that has been measured
        #: The newest frame of which parts may be missing, because of a new subscription; None: not known yet.
        self._incomplete: int | None = None
        self._settling_until: float | None = None  # since the first clock after a subscription
        self._silent: set[str] = set()  # keys for which the last wait was in vain
        self._due = self._effort_s = 0.0
        self._share = _PROCESSOR_SHARE[address.resolved.mode]
        self._measured_at, self._newest_then = 0.0, -1
        self._frames_per_s = 0.0
        self._newest, self._since = -1, time.monotonic()
        self._asked, self._unanswered = self._since, 0
        self.tally = Tally()
        self._assembler = FrameAssembler((), "", self.tally, patience_for(address.resolved)) if every else None
        self._resume_at, self._pause_s = 0.0, _PAUSE_S
        #: Whether each node is there, of those that have been: set in Zenoh's thread.
        self._presence: dict[str, bool] = {}
        self._epoch_began = threading.Event()
        self._ask_wiring_until = self._ask_wiring_at = 0.0
        self._declared = [
            session.liveliness().declare_subscriber(f"{self._base}/alive/*", direct(self._on_alive), history=True)
        ]
        if address.credentials is None:  # wires of a secure run cannot change
            self._declared.append(session.declare_subscriber(f"{self._base}/@control/epoch", direct(self._on_epoch)))
        # After the subscription: a change between the two would be missed.
        self.wiring = Wiring.from_json(address.resolved.wiring)
        if (current := address.current_wiring(session)) is not None:
            self.wiring, self.roles = current
        self.run = seen(address, self.wiring, self.meter.agents)
        self._follow()

    @property
    def down(self) -> list[str]:
        """Nodes that were there, and are not any more; none when the run is ending."""
        inserted = {each["node"] for each in self.interceptions if each["action"] == "intercept"}  # their wires heal
        down = {node for node, there in self._presence.copy().items() if not there} - inserted
        return [] if driver_of(self.address.resolved.nodes) in down else sorted(down)

    @property
    def frame(self) -> int:
        """The newest frame that has begun; -1: none yet."""
        return self._newest

    def advance(self) -> Frame | None:
        """Take what has arrived, and measure the newest whole frame; None if there is no newer one."""
        self.keep_up()
        now, newest = time.monotonic(), self._newest
        if now < self._due:
            if self._in_bursts and self._ends_soon:
                self._receive(everything=True)
            elif self._in_bursts and (self._due - now) * self._frames_per_s > _FEWEST_SKIPPED:
                self._receive(everything=False)
            return None
        if not self._receiving:
            self._receive(everything=True)
            return None
        if now - self._since > _SILENCE_S:
            return self.last_frame()
        return self._shown(newest - _BEHIND) if self._is_whole(newest - _BEHIND) else None

    def frames(
        self,
        stop: threading.Event,
        ended: Callable[[], None] = lambda: None,
        measured: Callable[[], bool] = lambda: True,
    ) -> Iterator[Frame]:
        """The frames until the run ends, its newest one included, or until `stop` is set: then none of those that wait.

        ended: called when the run has ended;  measured: where every frame is received, whether outcomes are of use now
        """
        if self._assembler is not None:
            yield from self._every_frame(self._assembler, stop, ended, measured)
            return
        while not stop.is_set():
            frame = self.advance()
            if frame is not None:
                begun = time.process_time()
                yield frame
                self._due += max(0.0, time.process_time() - begun - self._effort_s) / self._share
            elif self.is_over():
                ended()
                if (frame := self.last_frame()) is not None:
                    yield frame
                return
            stop.wait(POLL_S)

    def _every_frame(
        self,
        assembler: FrameAssembler,
        stop: threading.Event,
        ended: Callable[[], None],
        measured: Callable[[], bool],
    ) -> Iterator[Frame]:
        """See `frames`."""
        over = False
        while not over and not stop.wait(EVERY_POLL_S):
            over = self.is_over()  # asked first: what has arrived until then is taken
            if over:
                ended()
            self._add(assembler, self.keep_up())
            waiting = deque(assembler.whole(silent=self._unpublished(), over=over))
            while waiting and not stop.is_set():
                (number, messages), wanted = waiting.popleft(), measured()
                frame = self._measured(number, messages) if wanted and self._has_time(len(waiting)) else None
                if frame is None:
                    frame = self.meter.unmeasured(self.run, number, messages, self.wiring)
                    self.tally.unmeasured += wanted and frame is not None
                if frame is not None:
                    self.tally.refused += frame.refused
                    yield frame
                else:  # its clock is invalid
                    self.tally.frames -= 1
                    self.tally.lost += 1

    def _add(self, assembler: FrameAssembler, arrived: Iterable[ArrivedMessage]) -> None:
        """Sort messages by the frames that they are about; those that receivers refuse are counted."""
        timespan = self.address.resolved.timespan
        # The clock first: it tells which frames there can be.
        for key, step, content in sorted(arrived, key=lambda each: each.key != self.clock_key):
            payload = content.to_bytes()
            try:
                header = codec.decode_header_only(payload, self.types[key])
            except (MessageError, KeyError):
                self.tally.refused += 1
                continue
            if timespan is not None and timespan.refusal(header, step):
                self.tally.refused += 1
            else:
                assembler.add(key, header.frame, Sample(step, payload))

    def _unpublished(self) -> Collection[str]:
        """The keys of nodes that are down."""
        down = self.down
        return {leg.key for _, leg in self.wiring.legs() if leg.publisher.node in down} if down else ()

    def _has_time(self, waiting: int) -> bool:
        """Whether there is time to measure a frame. waiting: number of whole frames after it"""
        now = time.monotonic()
        if waiting > _MOST_WAITING and now >= self._resume_at:
            self._resume_at = now + self._pause_s
            self._pause_s = min(2 * self._pause_s, _LONGEST_PAUSE_S)
        return now >= self._resume_at

    def last_frame(self) -> Frame | None:
        """The newest whole frame of a run that is over or silent; None if there is none that has not been measured."""
        self.keep_up()
        number = self._newest if self._is_heard(self._newest) else self._newest - _BEHIND
        return self._shown(number) if self._is_heard(number) or self._is_whole(number) else None

    def listen(self, *, everything: bool) -> None:
        """Receive everything that frames need, or only the clock, which costs the run nothing."""
        if everything != self._listening:
            self._listening = everything
            self._receive(everything=everything)

    def keep_up(self) -> list[ArrivedMessage]:
        """Follow changes of the run without measuring frames; returns what has arrived."""
        self._take_updates()
        arrived = self._reception.poll()
        for _ in range(_POLLS_AT_MOST):
            if self._reception.lead(self.clock_key) <= _LEAD:
                break
            arrived += self._reception.poll()
        newest = self._reception.newest_step(self.clock_key)
        if newest != self._newest:
            self._newest, self._since = newest, time.monotonic()
        if self._receiving and self._incomplete is None and newest >= 0:
            self._settle()
        return arrived

    def note(self, sentence: str) -> None:
        """Add to what the page says about the view, once; the latest ten are kept."""
        if sentence not in self.meter.notes:
            self.meter.notes[:] = [*self.meter.notes, sentence][-_MOST_NOTES:]

    def wires(self) -> list[WireState]:
        """The wires that are received, those with interposers first."""
        return self._wires.states(self.wiring, self.types, self.roles, self._newest)

    def is_over(self) -> bool:
        """Whether the run has ended; asks only if it has been silent for some time.

        Of a run without a folder, no answer counts as the end if several questions in a row have none.
        """
        now = time.monotonic()
        if now - self._since < _SILENCE_S:
            self._unanswered = 0
        elif now - self._asked >= _ASK_S:
            self._asked = now
            self._unanswered = self._unanswered + 1 if self.address.is_over(self.session) else 0
        return self._unanswered >= (1 if self.address.folder is not None else _QUESTIONS)

    def close(self) -> None:
        """Unsubscribe from everything."""
        for entity in self._declared:
            entity.undeclare()
        self._reception.close()

    @property
    def _ends_soon(self) -> bool:
        """Whether the run has played all but its last frames, as far as its scenario says."""
        remaining = self.address.resolved.frames - 1 - self._newest
        return remaining <= max(_FEWEST_SKIPPED, _LAST_S * self._frames_per_s)

    def _is_heard(self, number: int) -> bool:
        """Whether a new frame is complete: a message of every key has been sent in it, or later."""
        return number > self._last and all(
            self._reception.newest_step(key) >= number for key in self.meter.keys_of_series(self.wiring)
        )

    def _is_whole(self, number: int) -> bool:
        """Whether a new frame, of some time ago, is as complete as it becomes."""
        return self._incomplete is not None and number > max(self._last, self._incomplete)

    def _measured(self, number: int, messages: Iterable[tuple[str, Sample]]) -> Frame | None:
        """Measure a frame; None if it cannot be measured."""
        try:
            return self.meter.measure(self.run, number, messages, self.wiring, self.roles)
        except Exception as error:  # of an open mesh anything may come: one frame is lost, and the page says so
            self.note(f"frame {number} cannot be measured: {error!r:.200}")
            self._last = max(self._last, number)
            return None

    def _shown(self, number: int) -> Frame | None:
        """Measure a frame, and set when the next one is due; None if it cannot be measured."""
        now, newest = time.monotonic(), self._newest
        begun = time.process_time()
        measured = self._measured(number, self._reception.sent_since(number))
        self._wires.note(now, self.types)
        self._frames_per_s = (newest - self._newest_then) / (now - self._measured_at)
        self._measured_at, self._newest_then = now, newest
        # What is done with a frame takes about as long as measuring it.
        self._effort_s = time.process_time() - begun
        self._due = now + max(1.0 / _MOST_FRAMES_PER_S, 2.0 * self._effort_s / self._share)
        if measured is not None:
            self._last = number
            self.run = measured.run
        return measured

    def _follow(self) -> None:
        """Receive the keys of the current wiring."""
        self.types = self.meter.keys(self.wiring)
        self.clock_key = self.meter.clock_key(self.wiring)
        if self._assembler is not None:
            self._assembler.follow(self.meter.keys_of_series(self.wiring), self.clock_key)
        self._subscribe()

    def _receive(self, *, everything: bool) -> None:
        """Subscribe to everything, or to the clock alone."""
        if everything != self._receiving:
            self._receiving = everything
            self._subscribe()

    def _subscribe(self) -> None:
        self._incomplete = self._settling_until = None
        self._silent = {key for key in self._silent if self._reception.newest_step(key) < 0}
        keys = self.types if self._receiving else [self.clock_key]
        self._reception.subscribe(sorted(keys, key=lambda key: key != self.clock_key))  # messages of a key are taken so
        if self._receiving:  # wait until the router knows: it takes what a session sends in order
            for _ in self.session.liveliness().get(f"{self._base}/alive/*", timeout=_ROUTER_S):
                pass

    def _settle(self) -> None:
        """Take the publishers as knowing of the subscription once each has been heard, or after a wait."""
        now = time.monotonic()
        if self._settling_until is None:
            self._settling_until = now + _SETTLING_S
        unheard = {key for key in self.meter.keys_of_series(self.wiring) if self._reception.newest_step(key) < 0}
        if unheard <= self._silent or now >= self._settling_until:
            self._silent = unheard
            self._incomplete = self._newest + SETTLING

    def _on_alive(self, sample: zenoh.Sample) -> None:
        node = str(sample.key_expr).rpartition("/")[2]
        if node in self.roles:  # anybody may announce any name on an open mesh
            self._presence[node] = sample.kind == zenoh.SampleKind.PUT

    def _on_epoch(self, _: zenoh.Sample) -> None:
        self._epoch_began.set()

    def _take_updates(self) -> None:
        """Ask for the wiring for some time after each epoch: epochs are not signed on an open mesh, so only hints."""
        now = time.monotonic()
        if self._epoch_began.is_set():
            self._epoch_began.clear()
            self._ask_wiring_until = now + _ASK_WIRING_FOR_S
        if self._ask_wiring_at <= now < self._ask_wiring_until:
            self._ask_wiring_at = now + _ASK_WIRING_EVERY_S
            current = self.address.current_wiring(self.session)
            if current is not None and current[0] != self.wiring and self.meter.clock_key(current[0]):
                self.roles |= current[1]
                self._rewire(current[0])

    def _rewire(self, wiring: Wiring) -> None:
        """Follow a change of the wiring, and note which nodes were inserted or removed."""
        before, after = ({passage.node for passage in each.passages()} for each in (self.wiring, wiring))
        for action, known, nodes in (("intercept", wiring, after - before), ("release", self.wiring, before - after)):
            for node in sorted(nodes):
                wires = sorted({passage.wire for passage in known.passages() if passage.node == node})
                event = {"action": action, "node": node, "wires": wires, "frame": max(self._last, 0)}
                self.interceptions = [*self.interceptions, event][-_MOST_INTERCEPTIONS:]
        self.wiring = wiring
        self.run = self.run.with_(wiring=wiring.to_json())
        self._follow()


#: Frames of which parts may be missing after every key has been heard since a subscription.
SETTLING = 3
#: For how long a silent key is waited for, whose node is there. Frames, at least, and in lock-step, in which every
#: message comes, though on a busy machine after the clocks of later frames. s, in real time, in which machines and
#: links delay messages.
PATIENCE, _LOCKSTEP_PATIENCE, _PATIENCE_S = 10, 100, 5.0
#: Frames at the beginning, for which a key that has not been heard yet is waited for at most: on a busy machine,
#: publishers learn of a subscription late.
SETTLING_AT_MOST = 100
#: Messages of one key about one frame, at most: a publisher of a run sends one, and a link may repeat it.
MOST_PER_KEY = 32
#: s of a run in real time for which messages can wait, and the fewest and most of a key.
_ROOM_S, _LEAST_ROOM, _MOST_ROOM = 20.0, 64, 512


@dataclass
class Tally:
    """Numbers of frames and messages of a running run.

    frames:     that were complete, or waited for as long as they can be;  unmeasured: of them, without outcomes
    lost:       frames that never came: there was no room, or the router dropped them
    late:       messages that came after their frame
    refused:    messages that receivers refuse as well, or that nobody sends
    """

    frames: int = 0
    unmeasured: int = 0
    lost: int = 0
    late: int = 0
    refused: int = 0

    def sentences(self) -> list[str]:
        """What is missing from the frames, in words; [] if nothing is."""
        words = {
            "frames were lost: there was no room for them, or the router dropped them; "
            "others may lack messages": self.lost,
            "messages came after their frame, and are missing from it": self.late,
            "invalid messages were left out": self.refused,
            "frames were not evaluated in time: their markers have the colour of unevaluated ones": self.unmeasured,
        }
        return [f"{number} {text}" for text, number in words.items() if number]


class FrameAssembler:
    """Puts messages together by the frame that they are about.

    A frame is whole when every key has been heard of it or of a later frame, of those that were heard in the latest
    frames. Who joins a running run begins when every key has been heard.

    keys: of messages that a frame has;  clock: the one of them that every frame has
    patience: number of these latest frames, for which a frame waits at most
    """

    def __init__(self, keys: Collection[str], clock: str, tally: Tally, patience: int = PATIENCE) -> None:
        self.tally = tally
        self._patience = patience
        self._frames: dict[int, dict[str, list[Sample]]] = {}
        self._next = -1  # the frame that is due; -1: none has begun
        self._joined = -1  # the first frame of which the clock was heard
        self._newest_clock = -1
        self.follow(keys, clock)

    def follow(self, keys: Collection[str], clock: str) -> None:
        """Go on with other keys: the wiring has changed."""
        self._clock = clock
        self._newest = dict.fromkeys(keys, -1)  # by key, the latest frame that it was heard of
        self._unheard = set(keys)
        self._heard = dict.fromkeys(keys, self._newest_clock)  # by key, the clock then

    def add(self, key: str, frame: int, sample: Sample) -> None:
        """Add a message about a frame."""
        self._unheard.discard(key)
        if key == self._clock and frame > self._newest_clock:
            if self._joined < 0:
                self._joined = frame
            self._newest_clock = frame
        if self._next < 0 <= self._joined:
            self._begin()
        if frame < self._next or self._next < 0:
            self.tally.late += key != self._clock and self.tally.frames > 0
            return
        samples = self._frames.setdefault(frame, {}).setdefault(key, []) if frame <= self._last else []
        if frame > self._last or len(samples) >= MOST_PER_KEY:
            self.tally.refused += 1
            return
        samples.append(sample)
        if key in self._newest:
            self._newest[key] = max(self._newest[key], frame)
            self._heard[key] = self._newest_clock

    def whole(
        self, *, silent: Collection[str] = (), over: bool = False
    ) -> Iterator[tuple[int, list[tuple[str, Sample]]]]:
        """The frames that are whole now, in order, with their messages.

        silent: keys on which nothing comes for now;  over: nothing more comes at all
        """
        while 0 <= self._next <= self._newest_clock and (over or self._is_whole(silent)):
            if self._clock in self._frames.get(self._next, ()):
                number, by_key = self._next, self._frames.pop(self._next)
                self._next += 1
                self.tally.frames += 1
                yield number, [(key, sample) for key, samples in by_key.items() for sample in samples]
                continue
            begun = [number for number, by_key in self._frames.items() if self._clock in by_key]
            following = min(begun, default=self._newest_clock + 1)
            self.tally.lost += following - self._next
            self._next = following
            self._frames = {number: by_key for number, by_key in self._frames.items() if number >= following}

    def _begin(self) -> None:
        """Set the first frame, if it is known by now: of those before it, parts may be missing."""
        if self._joined == 0:
            self._next = 0
        elif not self._unheard or self._newest_clock >= self._joined + SETTLING_AT_MOST:
            self._next = self._newest_clock + SETTLING
        self._heard = dict.fromkeys(self._heard, self._newest_clock)

    @property
    def _last(self) -> int:
        """The last frame about which there can be messages by now."""
        return self._newest_clock + self._patience

    def _is_whole(self, silent: Collection[str]) -> bool:
        if self._newest_clock >= self._next + self._patience:
            return True
        since = self._newest_clock - self._patience
        awaited = (key for key, heard in self._heard.items() if heard >= since and key not in silent)
        return all(self._newest[key] >= self._next for key in awaited)


def patience_for(resolved: Resolved) -> int:
    """For how many frames a silent key is waited for."""
    return max(PATIENCE, _frames_in(_PATIENCE_S, resolved)) if resolved.mode == "realtime" else _LOCKSTEP_PATIENCE


def room_for(resolved: Resolved) -> int:
    """How many messages of a key can wait: in real time those of some seconds."""
    if resolved.mode != "realtime":
        return _MOST_ROOM
    return min(max(_frames_in(_ROOM_S, resolved), _LEAST_ROOM), _MOST_ROOM)


def _frames_in(seconds: float, resolved: Resolved) -> int:
    return math.ceil(seconds * resolved.rate / (resolved.period_ns * 1e-9))
