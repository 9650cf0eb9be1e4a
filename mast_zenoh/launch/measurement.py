"""Measures a run again from its recording: with other parameters, a later version, or after the run was killed.

A node that measures a run depends on messages alone, so it measures the same from the run's recording.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from mast_zenoh import run_folder
from mast_zenoh.config import plugins
from mast_zenoh.config.loading import SHIPPED, AllowedCode
from mast_zenoh.config.resolved import Resolved, build_node
from mast_zenoh.errors import HandlerFailed, RunFolderError
from mast_zenoh.launch import conclusion, liveness, notices
from mast_zenoh.launch.table_files import TableFiles
from mast_zenoh.mesh.control import failures
from mast_zenoh.mesh.control.results import EVALUATOR, TablePart
from mast_zenoh.mesh.host import Host
from mast_zenoh.messages import user_types
from mast_zenoh.run_folder import read_json, read_object
from mast_zenoh.run_folder.finding import sentence
from mast_zenoh.run_folder.recording import reader
from mast_zenoh.run_folder.recording.format import JOINED, LEFT, MALFORMED, REWIRED, RecordedEvent
from mast_zenoh.run_folder.recording.reader import Recorded, events, file_of, read
from mast_zenoh.run_folder.recording.writer import FILE
from mast_zenoh.wiring.model import ANY, Endpoint, Wiring


def recorded_wirings(path: Path) -> list[tuple[int, Wiring]]:
    """The wirings of the run in a folder, each with the frame after which it holds; the first one with -1.

    Raises RunFolderError if one cannot be read.
    """
    changes = [(event.frame, event.wiring) for event in events(path) if event.what == REWIRED]
    try:
        if not changes or changes[0][0] >= 0:
            changes.insert(0, (-1, read_json(path / "wiring.json")))
        return [(frame, Wiring.from_json(wiring)) for frame, wiring in changes]
    except (KeyError, TypeError, IndexError, AttributeError, ValueError) as error:
        raise RunFolderError(f"{path}: the wiring of the run cannot be read: {error!r}") from None


#: Frames for which messages wait for others of their key and frame: the largest error of times in headers.
_HELD_FRAMES = 8


def listening_host(resolved: Resolved, name: str, node: Any, wiring: Wiring) -> Host:
    """The host of a node that only listens, with the settings of a run; it has not started."""
    return Host.of(resolved, name, node, wiring, encode=True, emit=lambda out: None)


def results_of(
    resolved: Resolved, name: str, path: Path, hand_in: Callable[[TablePart], None] | None = None
) -> dict[str, Any]:
    """The results of a node's `finish` after it has received a recording.

    resolved: the scenario of the recorded run, with the user's modules loaded
    name:     a node of that scenario that receives every key
    path:     the recording, or the folder of the run
    hand_in:  takes the parts of the node's tables; None: they are in the results

    Raises RunFolderError for a recording that is missing or damaged, and HandlerFailed if the node fails.
    """
    path = file_of(path)
    changes = deque(events(path))
    if not changes or changes[0].what != REWIRED:
        raise RunFolderError(f"{path}: the first event is not the wiring that the run began with")
    user_types.use(resolved.messages)
    node = build_node(resolved.nodes[name], name)
    overhearers = [Endpoint(name, port) for port, message in node.inputs.items() if message == ANY]
    wiring = _wiring(changes.popleft(), overhearers, path)
    host = listening_host(resolved, name, node, wiring)
    host.tables.hand_in = hand_in
    present = {}
    while changes and changes[0].what == JOINED and changes[0].frame < 0:
        event = changes.popleft()
        present[event.node] = event.role
    host.start({peer: role for peer, role in present.items() if peer != name})

    def change(event: RecordedEvent) -> None:
        if event.what == REWIRED:
            new = _wiring(event, overhearers, path)
            for key, port_input in new.ports(name).inputs.items():
                host.add_input(key, port_input)
            host.rewired(new)
        elif event.node != name:
            (host.left if event.what == LEFT else host.joined)(event.node, event.role)

    for step, message in _in_order_sent(_by_step(read(path)), [event.frame for event in changes]):
        while changes and step > changes[0].frame:
            change(changes.popleft())
        host.deliver(message.key.removesuffix(f"/{MALFORMED}"), message.payload, message.step, counted=False)
    for event in changes:
        change(event)
    results = host.finish()
    if host.failures:
        failed = failures.summary({name: [failure.entry() for failure in host.failures.values()]})
        raise HandlerFailed(f"{failed}\nnothing was written: the results of the run itself are kept")
    return results


def _in_order_sent(messages: Iterable[tuple[int, Recorded]], changes: Sequence[int]) -> Iterator[tuple[int, Recorded]]:
    """The messages; messages with the same key and frame are in the order of sending.

    changes: frames after which the run changed, ascending; no message is moved across a change
    """
    held: list[tuple[int, int, Recorded]] = []
    upcoming = deque(changes)

    def release(before: int) -> Iterator[tuple[int, Recorded]]:
        ready = sorted((each for each in held if each[1] < before), key=lambda each: each[0])
        held[:] = [each for each in held if each[1] >= before]
        yield from ((step, message) for _, step, message in ready)

    for step, message in messages:
        while upcoming and step > upcoming[0]:
            yield from release(upcoming.popleft() + 1)
        if message.message == "clock":
            yield from release(message.frame - _HELD_FRAMES)
        if message.rank >= 0:
            held.append((message.rank, step, message))
        else:
            yield step, message
    yield from ((step, message) for _, step, message in sorted(held, key=lambda each: each[0]))


def _by_step(messages: Iterable[Recorded]) -> Iterator[tuple[int, Recorded]]:
    """Pairs (step, message): messages by frame, delayed to the step of sending."""
    waiting: list[tuple[int, int, Recorded]] = []
    for count, message in enumerate(messages):
        while waiting and waiting[0][0] < message.frame:
            step, _, late = heapq.heappop(waiting)
            yield step, late
        if message.step > message.frame >= 0:
            heapq.heappush(waiting, (message.step, count, message))
        else:
            yield max(message.frame, message.step), message
    while waiting:
        step, _, late = heapq.heappop(waiting)
        yield step, late


def _wiring(event: RecordedEvent, overhearers: Sequence[Endpoint], path: Path) -> Wiring:
    """The wiring in an event, with these overhearers even if the run lacked them."""
    try:
        wiring = Wiring.from_json(event.wiring)
    except (ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        raise RunFolderError(f"{path}: the wiring of frame {event.frame} cannot be read: {error!r}") from None
    added = [end for end in overhearers if end not in wiring.overhearers]
    return replace(wiring, overhearers=(*wiring.overhearers, *added))


METRICS = "metrics.json"

#: Entries of metrics.json from the wall clock, the broker's counters and the command, which no recording has.
_NOT_RECORDED = ("late", "latency_ms", "frames_per_second", "replay")


def can_fill_in(folder: Path) -> bool:
    """Whether a run folder lacks metrics but has the recording to measure them from."""
    return not (folder / METRICS).exists() and (folder / FILE).is_file()


def measure(folder: Path, allowed: AllowedCode = SHIPPED) -> list[str]:
    """Recompute metrics.json and the evaluator's tables from a run's recording.

    allowed: which of the code that the folder names may run: its evaluator, and classes of users

    Wall-clock times are kept as measured in the run. If the recording ends before the run did, `recording` in
    metrics.json gives its extent. Returns a sentence for each refused table, one if the recorder was lost in the run,
    and one for each plugin that has another version than in the run. Raises RunFolderError if something is missing or
    damaged, if the run is in progress, or if metrics of more frames would be replaced, and HandlerFailed if the
    evaluator fails, UntrustedCode.
    """
    resolved = scenario_of(folder, allowed)
    liveness.finished_record(folder, run_folder.json_or_empty(folder / "run.json"))
    if EVALUATOR not in resolved.nodes:
        raise RunFolderError(f"{folder / 'scenario.json'}: nodes: found no {EVALUATOR!r}, which measures a run")
    resolved.load_modules()
    previous: dict[str, Any] = {}
    with suppress(RunFolderError):
        previous = read_object(folder / METRICS, shaped=False)
    incomplete = incomplete_recording(folder)
    if incomplete and previous:
        _refuse_worse(folder, previous, incomplete)
    tables = TableFiles(folder)
    try:
        results = results_of(resolved, EVALUATOR, folder, partial(tables.add, EVALUATOR, "measured"))
    except BaseException:
        tables.discard(EVALUATOR)  # those of the run are kept
        raise
    tables.close()
    kept: dict[str, Any] = {name: previous[name] for name in _NOT_RECORDED if name in previous}
    if incomplete:
        kept["recording"] = incomplete._asdict()
    record = run_folder.json_or_empty(folder / "run.json")
    recorded_by = record.get("versions") or {}
    others = [
        f"recorded by {name} {recorded_by.get(name) or 'of an unknown version'}, measured by {here}"
        for name, here in plugins.versions_of(resolved.plugins.values()).items()
        if recorded_by.get(name) != here
    ]
    return [
        *conclusion.write_results(folder, {EVALUATOR: results}, kept, tables),
        *map(sentence, notices.of_recording(record)),
        *others,
    ]


def scenario_of(folder: Path, allowed: AllowedCode = SHIPPED) -> Resolved:
    """The scenario of a run; raises RunFolderError if it cannot be read.

    allowed: which of the code that it names may run
    """
    if not folder.is_dir():
        found = "a file" if folder.exists() else "no such folder"
        raise RunFolderError(f"{folder}: found {found}, expected the folder of a run")
    return Resolved.read(folder, allowed)


class Incomplete(NamedTuple):
    """Extent of a recording that ends before its run did.

    frames:        number of frames that it covers, from the run's first
    played_frames: number of frames of the run; of a run that was killed, the planned number
    """

    frames: int
    played_frames: int

    def __str__(self) -> str:
        last = f"at frame {self.frames - 1} of {self.played_frames}" if self.frames else "before its first frame"
        return f"the recording ends {last}"


def incomplete_recording(folder: Path) -> Incomplete | None:
    """Extent of the recording in a run folder; None: it covers the whole run."""
    extent = reader.extent(folder)
    run = run_folder.json_or_empty(folder / "run.json")
    nodes = run.get("nodes") or {}
    last_frames = {
        node.get("role"): node["last_frame"] for node in nodes.values() if isinstance(node.get("last_frame"), int)
    }
    # Messages that never reached the recorder, as in the last frame of a stopped run, are not missing.
    if extent.whole and extent.last_frame >= last_frames.get("recorder", -1):
        return None
    played = max(last_frames.values()) + 1 if last_frames else int(run.get("frames") or 0)
    return Incomplete(extent.last_frame + 1, max(played, extent.last_frame + 1))


def _refuse_worse(folder: Path, metrics: dict[str, Any], incomplete: Incomplete) -> None:
    """Raise RunFolderError if existing metrics cover more frames than the recording."""
    covered = metrics.get("recording")
    if isinstance(covered, dict) and isinstance(covered.get("frames"), int) and covered["frames"] <= incomplete.frames:
        return
    raise RunFolderError(
        f"{folder / FILE}: {incomplete}, expected all that was played; {METRICS} is kept as it is: restore the "
        f"recording, or remove {METRICS} to measure the {incomplete.frames} frames that are left"
    )
