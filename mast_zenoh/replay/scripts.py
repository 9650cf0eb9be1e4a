"""Reads a recording once, and divides it into the scripts of the nodes that are played."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from mast_zenoh.config.resolved import DRIVER_ROLE
from mast_zenoh.errors import RunFolderError
from mast_zenoh.links import WIRES
from mast_zenoh.messagelog.format import MALFORMED
from mast_zenoh.messagelog.reader import Recorded, is_whole, read
from mast_zenoh.messagelog.script import Output, Script, path_of
from mast_zenoh.messagelog.writer import FILE
from mast_zenoh.replay import findings
from mast_zenoh.replay.cut import Cut
from mast_zenoh.replay.link_reports import restricted
from mast_zenoh.wiring.model import Wire

#: Number of frames of an endless replay: weeks, at a thousand frames a second.
ENDLESS_FRAMES = 10**9


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
    cut: Cut,
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
    notices = [
        *findings.of_extent(n_frames, recorded, planned, whole=whole),
        *findings.of_clocks(sum(frame not in messages.times_ns for frame in range(n_frames))),
        *findings.of_gaps({wire.key: _gap(messages.numbers[wire.key]) for wire in _played(cut)}),
        *findings.of_silent(silent),
        *findings.of_outsiders(messages.outsiders),
    ]
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


def _played(cut: Cut) -> Iterator[Wire]:
    return (wire for wire in cut.wiring.wires if wire.legs[0].publisher.node in cut.played)


def _check_inputs(folder: Path, cut: Cut, messages: Messages) -> list[str]:
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
            raise RunFolderError(
                f"{folder / FILE}: found no message on {', '.join(list(wires)[:3])}, expected those that {node} "
                f"receives as {port!r}: cut the run elsewhere with --from, or record it again"
            )
        silent |= dict.fromkeys(key for key, any_ in wires.items() if not any_)
    return list(silent)


def _lines(
    name: str, cut: Cut, messages: Messages, frames: int, *, without_clock: bool
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
