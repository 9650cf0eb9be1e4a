"""Measures a run again from its recording.

Useful with a later version, or for a run that was killed before it had results.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from mast_zenoh.config.allowed_code import SHIPPED, AllowedCode
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.control.results import EVALUATOR
from mast_zenoh.errors import RunFolderError
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.launch import notices
from mast_zenoh.launch.recorded_results import results_of
from mast_zenoh.messagelog import reader
from mast_zenoh.messagelog.writer import FILE
from mast_zenoh.run_files import read_object

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
    metrics.json gives its extent. Returns a sentence for each refused table, and one if the recorder was lost in the
    run. Raises RunFolderError if something is missing or damaged, or if metrics of more frames would be replaced, and
    HandlerFailed if the evaluator fails, UntrustedCode.
    """
    resolved = scenario_of(folder, allowed)
    if EVALUATOR not in resolved.nodes:
        raise RunFolderError(f"{folder / 'scenario.json'}: nodes: found no {EVALUATOR!r}, which measures a run")
    resolved.load_modules()
    previous: dict[str, Any] = {}
    with suppress(RunFolderError):
        previous = read_object(folder / METRICS, shaped=False)
    incomplete = incomplete_recording(folder)
    if incomplete and previous:
        _refuse_worse(folder, previous, incomplete)
    results = results_of(resolved, EVALUATOR, folder)
    kept: dict[str, Any] = {name: previous[name] for name in _NOT_RECORDED if name in previous}
    if incomplete:
        kept["recording"] = incomplete._asdict()
    recorder_notices = notices.of_recording(run_folder.json_or_empty(folder / "run.json"))
    return [*run_folder.write_results(folder, {EVALUATOR: results}, kept), *recorder_notices]


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
