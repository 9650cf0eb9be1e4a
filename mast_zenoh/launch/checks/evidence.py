"""The outcome of a check, and the record of a run: messages by key, reports of links, down times of nodes."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import MessageError, RunFolderError
from mast_zenoh.links import FATES
from mast_zenoh.messages import codec
from mast_zenoh.messages.packed import check_kernels
from mast_zenoh.messages.schemas import Body
from mast_zenoh.run_folder import read_object
from mast_zenoh.run_folder.recording import reader
from mast_zenoh.run_folder.recording.format import MALFORMED
from mast_zenoh.wiring.model import Wiring


class Check(NamedTuple):
    """The outcome of a check.

    name:   name of the check
    ok:     False: the check failed
    detail: a sentence: the findings, or why nothing was checked
    values: measured values, plain
    """

    name: str
    ok: bool
    detail: str
    values: dict[str, Any]

    @classmethod
    def skipped(cls, name: str, reason: str) -> Check:
        """The outcome if there was nothing to check."""
        return cls(name, True, f"not checked: {reason}", {"checked": False})


#: s of scene time by which events of a real-time run may be early or late.
REALTIME_SLACK_S = 1.5
#: s of scene time after the heal of a network in which delayed messages still arrive or are lost.
NETWORK_SLACK_S = 5.0


class TracksSummary(NamedTuple):
    """Summary of a track message: number of tracks, greatest absolute value in SI."""

    rows: int
    magnitude: float


class SentMessage(NamedTuple):
    """A valid message on one leg.

    content: for tracks, TracksSummary; for a collation, the rows of each agent whose tracks are of its own frame; for a
             picture, (n, 3) m, positions; else None
    step:    the current frame when it was sent; -1: unknown
    """

    frame: int
    seq: int
    time_ns: int
    content: Any = None
    step: int = -1


class Fate(NamedTuple):
    """A link's report of a message: one of links.FATES, and its delay."""

    name: str
    delay_s: float


#: (frame, sequence number) of a message
Id = tuple[int, int]


@dataclass
class RunEvidence:
    """The record of a run.

    run, metrics: run.json and metrics.json
    sent:      valid messages by key, in the order (frame, publisher, sequence)
    malformed: number of malformed messages by key
    fates:     reports of links by (link, number of the message type) and message
    times_ns:  times of the frames that were played
    """

    folder: Path
    resolved: Resolved
    wiring: Wiring
    run: Mapping[str, Any]
    metrics: Mapping[str, Any]
    sent: dict[str, list[SentMessage]] = field(default_factory=lambda: defaultdict(list))
    malformed: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    fates: dict[tuple[str, int], dict[Id, list[Fate]]] = field(default_factory=lambda: defaultdict(dict))
    times_ns: dict[int, int] = field(default_factory=dict)

    @classmethod
    def read(cls, folder: Path, resolved: Resolved) -> RunEvidence:
        """Read the evidence in a run folder.

        Raises RunFolderError if the run or its recording is incomplete, ConfigurationError without kernels to read it.
        """
        run = read_object(folder / "run.json")
        if run["status"] not in ("ok", "handler_failures"):
            raise RunFolderError(f"the run did not finish: {run['status']}")
        metrics = folder / "metrics.json"
        scores = read_object(metrics) if metrics.is_file() else {}
        evidence = cls(folder, resolved, Wiring.from_json(resolved.wiring), run, scores)
        check_kernels(evidence.wiring.codecs, str(folder))
        for message in reader.read(folder):
            key = message.key.removesuffix(f"/{MALFORMED}")
            if message.malformed:
                evidence.malformed[key] += 1
                continue
            content = None
            if message.message in _SUMMARIES:
                try:
                    body = codec.decode(message.payload, message.message).body
                except MessageError:  # valid header, invalid body: subscribers refuse it
                    evidence.malformed[key] += 1
                    continue
                content = _SUMMARIES[message.message](body)
                if message.message == "link_report":
                    evidence._add_report(message.publisher, body)
            evidence.sent[key].append(SentMessage(message.frame, message.seq, message.time_ns, content, message.step))
            if message.message == "clock":
                evidence.times_ns[message.frame] = message.time_ns
        lost = run.get("recorded", {}).get("lost", 0)
        if lost or not evidence.times_ns:
            raise RunFolderError(f"the recording lacks {lost or 'all'} messages")
        return evidence

    def _add_report(self, link: str, body: Body) -> None:
        for port, frame, seq, fate, delay_s in zip(
            *(body[name].tolist() for name in ("port", "frame", "seq", "fate", "delay_s")), strict=True
        ):
            fates = self.fates[link, port]
            fates.setdefault((frame, seq), []).append(Fate(FATES[fate], delay_s))

    @property
    def lockstep(self) -> bool:
        """Whether the run was in lock-step."""
        return self.resolved.mode == "lockstep"

    @cached_property
    def last(self) -> int:
        """The last frame."""
        return max(self.times_ns)

    @cached_property
    def end_s(self) -> float:
        """Time of the last frame, s of scene time."""
        return self.times_ns[self.last] * 1e-9

    def frames_in(self, seconds: float) -> int:
        """The number of frames in a duration, rounded up."""
        return math.ceil(seconds * 1e9 / self.resolved.period_ns)

    @property
    def slack(self) -> int:
        """Frames by which events may be early or late: none in lock-step."""
        return 0 if self.lockstep else self.frames_in(REALTIME_SLACK_S)

    def role(self, role: str) -> list[str]:
        """The nodes of a role."""
        return [name for name, spec in self.resolved.nodes.items() if spec.role == role]

    def restarts(self, node: str) -> list[int]:
        """The frames before which a node is restarted."""
        steps = [step for step in self.resolved.steps if step.node == node]
        return [step.frame for step in steps[1:] if step.action == "start"]

    @cached_property
    def broker_lag(self) -> int:
        """Frames that the broker waits for agents without a message."""
        configs = [self.resolved.nodes[name].config for name in self.role("broker")]
        return max(
            (
                self.frames_in(float(config.get("latency_s", 0.0))) + int(config.get("patience", 0))
                for config in configs
            ),
            default=0,
        )

    def down(self, node: str, first: int, last: int) -> bool:
        """Whether a node is stopped, paused or disconnected in a frame in `first`..`last`."""
        slack = self.slack
        return any(begin - slack <= last and first < end + slack for begin, end in self._absences.get(node, ()))

    @cached_property
    def _absences(self) -> dict[str, list[tuple[int, int]]]:
        absences: dict[str, list[tuple[int, int]]] = {}
        since: dict[str, int] = {}
        for step in self.resolved.steps:  # ordered by frame
            if step.action in ("start", "resume", "connect"):
                back = step.frame + (self.frames_in(NETWORK_SLACK_S) if step.action == "connect" else 0)
                absences.setdefault(step.node, []).append((since.pop(step.node, -1), back))
            else:
                since[step.node] = step.frame
        for node, begin in since.items():
            absences.setdefault(node, []).append((begin, self.last + 1))
        return absences

    def near_network_fault(self, frame: int) -> bool:
        """Whether a network fault may have affected a message of this frame."""
        at_s = self.times_ns.get(frame, 0) * 1e-9
        return any(
            band["at_s"] - REALTIME_SLACK_S <= at_s
            and (band["until_s"] is None or at_s <= band["until_s"] + NETWORK_SLACK_S)
            for band in self.resolved.timeline
            if band["backend"] == "network"
        )

    def unplugged(self, node: str, frame: int) -> bool:
        """Whether a node was disconnected at this frame, or had not reconnected yet."""
        disconnected = any(step.node == node and step.action == "disconnect" for step in self.resolved.steps)
        return disconnected and self.down(node, frame, frame)

    def heals_s(self) -> list[float]:
        """Times at which faults were healed, s of scene time; faults that last to the end have none."""
        return sorted({float(band["until_s"]) for band in self._faults() if band["until_s"] is not None})

    def open_faults(self) -> list[str]:
        """The labels of faults that last until the end."""
        return [band["label"] for band in self._faults() if band["until_s"] is None]

    def _faults(self) -> list[dict[str, Any]]:
        return [band for band in self.resolved.timeline if band["kind"] == "fault"]


def _tracks(body: Body) -> TracksSummary:
    magnitudes = [np.abs(body[name]).max(initial=0.0) for name in ("position", "velocity", "size", "covariance")]
    return TracksSummary(len(body["id"]), float(max(magnitudes)))


def _current_rows(body: Body) -> dict[str, int]:
    counts = np.bincount(body["agent"], minlength=len(body["agents"])).tolist()
    agents = zip(body["agents"], body["age_ns"].tolist(), counts, strict=True)
    return {str(name): count for name, age_ns, count in agents if age_ns == 0}


#: Summary of the content that checks need, by message type; a whole recording may not fit into memory.
_SUMMARIES: dict[str, Callable[[Body], Any]] = {
    "tracks": _tracks,
    "collated": _current_rows,
    "picture": lambda body: body["position"].copy(),
    "link_report": lambda body: None,
}
