"""A run with a compromised node that forges control messages; its effects are measured from the run folder."""

import re
import tempfile
from collections.abc import Collection, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import zenoh

from insider.forgeries import FALSE, MALFORMED, Forgery, all_forgeries, send
from insider.position import MARKER, Position, position
from mast_zenoh import streams, version
from mast_zenoh.config.resolved import Resolved, driver_of
from mast_zenoh.errors import RunFolderError
from mast_zenoh.launch import run
from mast_zenoh.run_folder import json_or_empty
from mast_zenoh.run_folder.recording.difference import compare
from mast_zenoh.study.attacked_run import AttackedRun

_END_S = 90.0


@dataclass(frozen=True)
class Finding:
    """A run with an insider, compared with its undisturbed twin.

    node:    the compromised node; others: all other nodes
    ended:   whether the run ended by itself; crash: the exception that ended the launcher, or ""
    failure: the run's error as in run.json and on the command line; "" for status "ok"
    frames:  number played; expected: number in the scenario
    changed: wires whose messages differ from the twin's; metrics: whether metrics.json is equal to the twin's
    strays:  new files outside the run folder
    """

    node: str
    others: Collection[str]
    ended: bool
    failure: str
    frames: int
    expected: int
    changed: Collection[str]
    metrics: bool
    strays: Collection[str]
    crash: str = ""

    @property
    def verdict(self) -> str:
        """What the insider achieved, in words; see `succeeded`."""
        if self.strays:
            return f"succeeds: wrote outside the run folder ({', '.join(sorted(self.strays))})"
        if self.crash:
            return f"succeeds: crashed the launcher ({self.crash})"
        if not self.ended:
            return "succeeds: stalled the run"
        if self.failure:
            mentioned = _first_mentioned(self.failure, [self.node, *self.others])
            if mentioned == self.node:
                return "ends the run, and is named"
            return f"succeeds: ends the run, and {mentioned or 'no node'} is named"
        if self.frames < self.expected:
            return f"succeeds: stopped the run early, after {self.frames} of {self.expected} frames"
        if self.changed:
            return f"succeeds: changed other nodes' messages ({len(self.changed)} wires)"
        return "no effect" if self.metrics else "succeeds: the run looks sound, but differs"

    @property
    def succeeded(self) -> bool:
        """Whether the insider did something that no compromised node must be able to do."""
        return self.verdict.startswith("succeeds")


def select_messages(position: Position, *, own: bool = False, messages: int = 120, seed: int = 1) -> list[Forgery]:
    """Forged messages of a node: kinds take turns, in random order within each kind.

    own: true: false messages in the node's own name; false: messages in the names of other nodes, the driver and the
         launcher, and malformed ones in its own name
    """

    def is_selected(forgery: Forgery) -> bool:
        in_own_name = forgery.sender == position.node
        if own:
            return in_own_name and forgery.defect == FALSE and forgery.control not in ("leave", "drain")
        return not in_own_name or forgery.defect == MALFORMED

    candidates = [each for each in all_forgeries(position, messages, seed) if is_selected(each)]
    by_control: dict[str, list[Forgery]] = {}
    for index in streams.stream(seed, "order", position.node).permutation(len(candidates)):
        by_control.setdefault(candidates[index].control, []).append(candidates[index])
    rounds = (kind[turn] for turn in range(messages) for kind in by_control.values() if turn < len(kind))
    return list(islice(rounds, messages))


def infiltrate(
    resolved: Resolved, folder: Path, level: str, node: str, twin: Path, *, own: bool = False
) -> tuple[bool, int, Finding]:
    """(whether the insider got a session, how many messages it sent, their effects).

    resolved: a recorded lock-step run; node: whose certificate and key it has; own: see `select_messages`
    twin: folder of the same run without the insider
    """
    before = _files_outside(folder)
    admitted, sent = False, 0
    with AttackedRun(resolved, folder, level) as attacked_run:
        with suppress(zenoh.ZError), attacked_run.join(node) as session:
            if session is not None:
                admitted = True
                forged = select_messages(position(resolved, node, version.version_string()), own=own)
                sent = send(session, attacked_run.prefix, forged)
                attacked_run.wait_until_ended(_END_S)
        finished = attacked_run.wait_until_ended(_END_S)
        ended_in_time = finished is not None
        finished = finished or attacked_run.stop()
    strays = {
        str(path) for path in _files_outside(folder) - before if MARKER in path.name or path.parent == folder.parent
    }
    finding = _assess(resolved, node, finished, ended_in_time, twin, strays)
    return admitted, sent, replace(finding, crash=attacked_run.crash)


def _assess(
    resolved: Resolved, node: str, finished: run.EndedRun | None, ended_in_time: bool, twin: Path, strays: set[str]
) -> Finding:
    driver = driver_of(resolved.nodes)
    others = [name for name in resolved.nodes if name != node]
    if finished is None:
        return Finding(node, others, False, "", 0, resolved.frames, (), False, strays)
    played = (finished.record["nodes"].get(driver, {}).get("last_frame") or 0) + 1
    changed: set[str] = set()
    with suppress(RunFolderError):
        difference = compare(twin, finished.folder, taps=True)
        changed = {*difference.differing, *difference.only_a, *difference.only_b}
    metrics = json_or_empty(twin / "metrics.json") == json_or_empty(finished.folder / "metrics.json")
    failure = str(finished.error) if finished.error else ""
    return Finding(node, others, ended_in_time, failure, played, resolved.frames, changed, metrics, strays)


def _files_outside(folder: Path) -> set[Path]:
    """Files in folders that a forged path could lead to, except the run folder."""
    places = {folder.parent, Path.cwd(), Path.home(), Path(tempfile.gettempdir()), Path("/tmp")}
    return {path for place in places if place.is_dir() for path in place.iterdir()} - {folder}


def _first_mentioned(text: str, nodes: Iterable[str]) -> str:
    """The node mentioned first in a text; "" for none."""
    offsets = {
        node: match.start() for node in nodes if (match := re.search(rf"(?<![\w-]){re.escape(node)}(?![\w-])", text))
    }
    return min(offsets, key=lambda node: offsets[node], default="")
