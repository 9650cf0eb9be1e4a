"""A run one of whose nodes is compromised: what comes of it, measured from what the run leaves behind."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Collection, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import zenoh

from mast_zenoh import version
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import RunFolderError
from mast_zenoh.launch import run
from mast_zenoh.launch.folder import json_or_empty
from mast_zenoh.messagelog.difference import compare
from mast_zenoh.study.rogue.insiders import Insider
from mast_zenoh.study.rogue.position import MARKER, position
from mast_zenoh.study.rogue.siege import Siege, attackers_own

_END_S = 90.0


@dataclass(frozen=True)
class Finding:
    """What a run leaves behind, beside its undisturbed twin.

    node:    the compromised one; others: all other nodes
    ended:   whether it ended by itself; crash: the exception with which the launcher did, if it did
    failure: why it failed, as run.json and the command line say it; "" for a run that is "ok"
    frames:  that were played; expected: that the scenario has
    changed: wires on which messages are not those of the twin; metrics: whether metrics.json is
    strays:  files outside the run folder that were not there before
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
        """What the insider has achieved, in words; see `succeeded`."""
        if self.strays:
            return f"succeeds: wrote outside the run folder ({', '.join(sorted(self.strays))})"
        if self.crash:
            return f"succeeds: crashed the launcher ({self.crash})"
        if not self.ended:
            return "succeeds: stalled the run"
        if self.failure:
            named = _first_named(self.failure, [self.node, *self.others])
            if named == self.node:
                return "ends the run, and is named"
            return f"succeeds: ends the run, and {named or 'nobody'} is named"
        if self.frames < self.expected:
            return f"succeeds: stopped the run early, after {self.frames} of {self.expected} frames"
        if self.changed:
            return f"succeeds: changed what others said ({len(self.changed)} wires)"
        return "no effect" if self.metrics else "succeeds: the run looks sound, but differs"

    @property
    def succeeded(self) -> bool:
        """Whether it has done what no compromised node may do."""
        return self.verdict.startswith("succeeds")


def infiltrate(resolved: Resolved, folder: Path, level: str, insider: Insider, twin: Path) -> tuple[bool, int, Finding]:
    """(whether the insider got a session, how many messages it sent, what came of them).

    resolved: in lock-step, and recorded; twin: the folder of the same run, undisturbed
    """
    before = _outside(folder)
    admitted, sent = False, 0
    with Siege(resolved, folder, level) as siege:
        siege.known(insider.node)
        with suppress(zenoh.ZError), siege.join(insider.node) as session:
            admitted = True
            with attackers_own(insider.name, insider.act):
                sent = insider.act(siege, session, position(resolved, insider.node, version.version_string()))
            siege.ended(_END_S)
        ended = siege.ended(_END_S)
        in_time = ended is not None
        ended = ended or siege.end()
    strays = {str(path) for path in _outside(folder) - before if MARKER in path.name or path.parent == folder.parent}
    found = _finding(resolved, insider.node, ended, in_time, twin, strays)
    return admitted, sent, replace(found, crash=siege.crash)


def _finding(
    resolved: Resolved, node: str, ended: run.Run | None, in_time: bool, twin: Path, strays: set[str]
) -> Finding:
    driver = next(name for name, spec in resolved.nodes.items() if spec.role == "simulator")
    others = [name for name in resolved.nodes if name != node]
    if ended is None:
        return Finding(node, others, False, "", 0, resolved.frames, (), False, strays)
    played = (ended.record["nodes"].get(driver, {}).get("last_frame") or 0) + 1
    changed: set[str] = set()
    with suppress(RunFolderError):
        found = compare(twin, ended.folder, taps=True)
        changed = {*found.differing, *found.only_a, *found.only_b}
    metrics = json_or_empty(twin / "metrics.json") == json_or_empty(ended.folder / "metrics.json")
    failure = str(ended.error) if ended.error else ""
    return Finding(node, others, in_time, failure, played, resolved.frames, changed, metrics, strays)


def _outside(folder: Path) -> set[Path]:
    """What lies in the places where a forged path could lead, but not in the run folder."""
    places = {folder.parent, Path.cwd(), Path.home(), Path(tempfile.gettempdir()), Path("/tmp")}
    return {path for place in places if place.is_dir() for path in place.iterdir()} - {folder}


def _first_named(text: str, nodes: Iterable[str]) -> str:
    """The node that is named first in a text; "" for none."""
    places = {
        node: found.start() for node in nodes if (found := re.search(rf"(?<![\w-]){re.escape(node)}(?![\w-])", text))
    }
    return min(places, key=lambda node: places[node], default="")
