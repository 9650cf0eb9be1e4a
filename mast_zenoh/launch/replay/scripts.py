"""Reads a recording once, divides it into the scripts of played nodes, and says what it lacks."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh.config import plugins
from mast_zenoh.config.resolved import DRIVER_ROLE, Resolved
from mast_zenoh.errors import MessageError, RunFolderError, plural
from mast_zenoh.launch.ending import RUNNING
from mast_zenoh.launch.notices import of_recording
from mast_zenoh.launch.replay.cut import ReplayedMesh
from mast_zenoh.links import WIRES, type_number
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Message
from mast_zenoh.run_folder import versions
from mast_zenoh.run_folder.finding import names, sentence
from mast_zenoh.run_folder.recording import churn
from mast_zenoh.run_folder.recording.format import MALFORMED
from mast_zenoh.run_folder.recording.reader import Recorded, is_whole, read
from mast_zenoh.run_folder.recording.script import Output, Script, path_of
from mast_zenoh.run_folder.recording.writer import FILE
from mast_zenoh.wiring.model import Wire

#: Number of frames of an endless replay: weeks, at a thousand frames a second.
ENDLESS_FRAMES = 10**9
_PACKAGE = "mast-zenoh"


@dataclass
class Messages:
    """The messages of a recording that a replay needs.

    times_ns: time of each frame with a clock, ns;  truths: frames with truth
    sent:     by key, (step, rank, bytes) of each message that a node sent
    numbers:  by wire, the sequence numbers of its messages;  outsiders: number of messages that no node sent
    """

    times_ns: dict[int, int] = field(default_factory=dict)
    truths: set[int] = field(default_factory=set)
    sent: defaultdict[str, list[tuple[int, tuple[int, int], bytes]]] = field(default_factory=lambda: defaultdict(list))
    numbers: defaultdict[str, set[int]] = field(default_factory=lambda: defaultdict(set))
    outsiders: int = 0

    def add(self, message: Recorded) -> None:
        """Add a message in the order of the recording."""
        if message.step < 0:
            self.outsiders += 1
            return
        if not message.malformed:
            self.numbers[message.wire].add(message.seq)
            if message.message == "clock":
                self.times_ns.setdefault(message.frame, message.time_ns)
            elif message.message == "truth":
                self.truths.add(message.frame)
        key = message.key.removesuffix(f"/{MALFORMED}")
        self.sent[key].append((message.step, (message.frame, message.rank), message.payload))


@dataclass(frozen=True)
class Scripts:
    """The scripts of all played nodes.

    by_node: a script for each;  frames: number of frames of one repetition
    notices: a sentence for each thing that the recording lacks
    """

    by_node: Mapping[str, Script]
    frames: int
    notices: list[str]


def read_scripts(
    folder: Path,
    cut: ReplayedMesh,
    roles: Mapping[str, str],
    *,
    period_ns: int,
    planned: int,
    frames: int | None = None,
    repeats: int | None = 1,
) -> Scripts:
    """Read the recording of a run folder.

    planned: number of frames of the recorded run;  frames: at most to play, None: all
    repeats: None: endless

    Raises RunFolderError for a recording that is missing or damaged, or without what live nodes need.
    """
    messages = Messages()
    for message in read(folder):
        messages.add(message)
    whole = is_whole(folder)
    recorded = _whole_frames(folder, messages, whole)
    silent = _check_inputs(folder, cut, messages)
    n_frames = min(recorded, frames or recorded)
    times_ns = [messages.times_ns.get(frame, frame * period_ns) for frame in range(n_frames)]
    scripts = {}
    for name in sorted(cut.played):
        outputs, sent = _lines(name, cut, messages, n_frames, without_clock=roles[name] == DRIVER_ROLE)
        count = max(1, ENDLESS_FRAMES // n_frames) if repeats is None else repeats
        scripts[name] = Script(path_of(name), outputs, sent, times_ns, period_ns, count)
    notices = []
    if recorded < planned and n_frames == recorded:
        reason = "" if whole else " (its writer was killed, or the file was cut off)"
        extent = f"after {plural(recorded, 'whole frame')} of {planned}{reason}"
        notices.append(f"the recording ends {extent}: these are played")
    if missing := sum(frame not in messages.times_ns for frame in range(n_frames)):
        frames_without = plural(missing, "frame")
        notices.append(f"no clock is recorded of {frames_without}: the times are multiples of the scene's period")
    gaps = {wire.key: gap for wire in _played(cut) if (gap := _gap(messages.numbers[wire.key]))}
    if gaps:
        worst = max(sorted(gaps), key=lambda wire: gaps[wire])
        where = f"{plural(len(gaps), 'wire')} (most: {worst}, {gaps[worst]})"
        notices.append(f"{plural(sum(gaps.values()), 'message')} on {where} were not recorded, and are not played")
    if silent:
        notices.append(f"no message is recorded on {names(silent, 3)}")
    if messages.outsiders:
        foreign = plural(messages.outsiders, "message")
        notices.append(f"{foreign} without the mark of the run's nodes are not played: outsiders sent them")
    return Scripts(scripts, n_frames, notices)


def _whole_frames(folder: Path, messages: Messages, whole: bool) -> int:
    """Number of frames that the recording covers; the last one is incomplete if it was cut off."""
    covered = messages.truths or messages.times_ns.keys()
    count = max(covered, default=-1) + (1 if whole else 0)
    if count <= 0:
        raise RunFolderError(f"{folder / FILE}: found no whole frame, expected the clock and the truth of at least one")
    if not messages.times_ns:
        raise RunFolderError(f"{folder / FILE}: found no message on the clock's wire, expected one for each frame")
    return count


def _played(cut: ReplayedMesh) -> Iterator[Wire]:
    return (wire for wire in cut.wiring.wires if wire.legs[0].publisher.node in cut.played)


def _check_inputs(folder: Path, cut: ReplayedMesh, messages: Messages) -> list[str]:
    """Raise RunFolderError if all wires to an input of a live node are empty.

    Returns single wires that are, though others to the same input are not.
    """
    filled: defaultdict[tuple[str, str], dict[str, bool]] = defaultdict(dict)
    for wire in _played(cut):
        for end in (*wire.subscribers, *(listener.end for listener in wire.listeners)):
            if end.node in cut.live:
                filled[end.node, end.port][wire.key] = any(messages.sent[leg.key] for leg in wire.every_leg)
    silent: dict[str, None] = {}
    for (node, port), wires in filled.items():
        if not any(wires.values()):
            how = "with points.recorded=true" if port == "points" else "again"
            raise RunFolderError(
                f"{folder / FILE}: found no message on {', '.join(list(wires)[:3])}, expected those that {node} "
                f"receives as {port!r}: cut the run elsewhere with --from, or record it {how}"
            )
        silent |= dict.fromkeys(key for key, any_ in wires.items() if not any_)
    return list(silent)


def _lines(
    name: str, cut: ReplayedMesh, messages: Messages, frames: int, *, without_clock: bool
) -> tuple[list[Output], dict[int, list[tuple[int, bytes]]]]:
    """The outputs of a node, and what it sent by step."""
    passed = {passage.message: passage.wire for passage in cut.wiring.passages() if passage.node == name}
    counts = {key: max(numbers, default=-1) + 1 for key, numbers in messages.numbers.items()}
    outputs: list[Output] = []
    lines: list[tuple[int, tuple[int, int], int, bytes]] = []
    for wire, leg in cut.wiring.legs():
        if leg.publisher.node != name:
            continue
        reports = wire.message == "link_report"
        reported = [counts.get(passed.get(message, ""), 0) for message in WIRES] if reports else []
        outputs.append(Output(leg.publisher.port, wire.subject, wire.message, counts.get(wire.key, 0), reported))
        if wire.message != "clock" or not without_clock:
            index = len(outputs) - 1
            played = ((step, rank, data) for step, rank, data in messages.sent[leg.key] if step < frames)
            if reports:
                played = ((step, rank, restricted(data, passed)) for step, rank, data in played)
            lines += [(step, rank, index, data) for step, rank, data in played]
    sent: defaultdict[int, list[tuple[int, bytes]]] = defaultdict(list)
    for step, _, index, data in sorted(lines, key=lambda line: line[:2]):
        sent[step].append((index, data))
    return outputs, dict(sent)


def _gap(numbers: set[int]) -> int:
    """How many sequence numbers are missing before the last one."""
    return max(numbers, default=-1) + 1 - len(numbers)


def restricted(payload: bytes, wires: Collection[str]) -> bytes:
    """A link report with the rows about some wires alone; unchanged if it has no others, or is malformed.

    wires: by message type
    """
    try:
        header, body = codec.decode(payload, "link_report")
    except MessageError:
        return payload
    kept = np.isin(body["port"], [type_number(message) for message in wires])
    if kept.all():
        return payload
    return codec.encode(Message(header, {name: column[kept] for name, column in body.items()}))


def of_run(record: Mapping[str, Any], resolved: Resolved) -> list[str]:
    """A sentence for each circumstance of a recorded run that its replay does not share.

    record: run.json
    """
    sentences = []
    status, message = record.get("status"), str(record.get("message") or "")
    if status == RUNNING:
        sentences.append("the recorded run has not ended, by its run.json, and was started on another machine")
    elif status != "ok":
        reason = f": {message.splitlines()[0]}" if message else ""
        sentences.append(f"the recorded run ended as {str(status).replace('_', ' ')!r}{reason}")
    recorded_by = record.get("versions") or {}
    for name, here in {_PACKAGE: versions()[_PACKAGE], **plugins.versions_of(resolved.plugins.values())}.items():
        if recorded_by.get(name) != here:
            sentences.append(
                f"recorded by {name} {recorded_by.get(name) or 'of an unknown version'}, replayed by {here}: live "
                "nodes may compute other numbers"
            )
    if record.get("mode") == "realtime":
        sentences.append(
            "recorded in real time, where late messages are late: the picture depended on the speed of the machine and "
            "may differ from the recorded one"
        )
    if resolved.network:
        sentences.append(
            "recorded on hosts in network namespaces, which are not set up again: messages are played as the recorder "
            "received them, though other nodes may not have"
        )
    if record.get("churn"):
        sentences.append(
            f"{churn.sentence(record['churn'])} in the recorded run: in the replay these nodes stay, and played ones "
            "send what was recorded"
        )
    return [*sentences, *map(sentence, of_recording(record))]
