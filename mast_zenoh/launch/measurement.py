"""Measures a run once more from its recording: with a later version, or where it was killed before it had results."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from mast_zenoh.config import bundle, loading
from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.control.results import EVALUATOR
from mast_zenoh.errors import RunFolderError
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.launch import notices
from mast_zenoh.messagelog import reader
from mast_zenoh.messagelog.writer import FILE
from mast_zenoh.runtime.replaying import replay

METRICS = "metrics.json"

#: What metrics.json holds of the wall clock and of the broker's counts: no recording tells it.
_NOT_RECORDED = ("late", "latency_ms", "frames_per_second")


def can_fill_in(folder: Path) -> bool:
    """Whether a run folder lacks metrics and holds what they can be measured from."""
    return not (folder / METRICS).exists() and (folder / FILE).is_file()


def measure(folder: Path) -> list[str]:
    """Write metrics.json and the evaluator's tables anew, from the recording in a run folder.

    The times on the wall clock are kept as they were measured in the run. Where the recording ends before the run did,
    `recording` in metrics.json says how far it goes. Returns a sentence for each table that was refused, and one if the
    recorder was lost in the run. Raises RunFolderError where something is missing or damaged, or where metrics of more
    frames would be replaced, and HandlerFailed where the evaluator fails.
    """
    try:
        resolved = Resolved.read(folder)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise RunFolderError(f"{folder}: scenario.json and wiring.json cannot be read: {error!r}") from None
    if EVALUATOR not in resolved.nodes:
        raise RunFolderError(f"{folder / 'scenario.json'}: nodes: found no {EVALUATOR!r}, by which a run is measured")
    for module in resolved.modules:
        loading.module(Path(module))
    evaluator = _found_here(resolved.nodes[EVALUATOR], folder)
    before = run_folder.json_or_empty(folder / METRICS)
    incomplete = _incomplete(folder)
    if incomplete and before:
        _refuse_worse(folder, before, incomplete)
    results = replay(replace(resolved, nodes={**resolved.nodes, EVALUATOR: evaluator}), EVALUATOR, folder)
    kept: dict[str, Any] = {name: before[name] for name in _NOT_RECORDED if name in before}
    if incomplete:
        kept["recording"] = incomplete._asdict()
    lost = notices.of_recording(run_folder.json_or_empty(folder / "run.json"))
    return [*run_folder.write_results(folder, {EVALUATOR: results}, kept), *lost]


class _Incomplete(NamedTuple):
    """How far a recording goes that ends before its run did.

    frames:        of which it holds the truth, counted from the run's first
    played_frames: of the run; of a run that was killed, those that it was to play
    """

    frames: int
    played_frames: int

    def __str__(self) -> str:
        last = f"at frame {self.frames - 1} of {self.played_frames}" if self.frames else "before its first frame"
        return f"the recording ends {last}"


def _incomplete(folder: Path) -> _Incomplete | None:
    """How far the recording in a run folder goes; None: to the end of the run."""
    extent = reader.extent(folder)
    run = run_folder.json_or_empty(folder / "run.json")
    nodes = run.get("nodes") or {}
    last = {node.get("role"): node["last_frame"] for node in nodes.values() if isinstance(node.get("last_frame"), int)}
    # What the recorder never heard, such as the last frame of a run that was stopped, the recording does not lack.
    if extent.whole and extent.last_frame >= last.get("recorder", -1):
        return None
    played = max(last.values()) + 1 if last else int(run.get("frames") or 0)
    return _Incomplete(extent.last_frame + 1, max(played, extent.last_frame + 1))


def _refuse_worse(folder: Path, metrics: dict[str, Any], incomplete: _Incomplete) -> None:
    """Raise RunFolderError if metrics that are there are of more frames than a recording that was cut off."""
    of = metrics.get("recording")
    if isinstance(of, dict) and isinstance(of.get("frames"), int) and of["frames"] <= incomplete.frames:
        return
    raise RunFolderError(
        f"{folder / FILE}: {incomplete}, expected all that was played; {METRICS} is kept as it is: restore the "
        f"recording, or remove {METRICS} to measure the {incomplete.frames} frames that are left"
    )


def _found_here(spec: NodeSpec, folder: Path) -> NodeSpec:
    """The node's spec with a file that is on this machine: that of the run, else ours of the same name."""
    if Path(spec.file).is_file():
        return spec
    found = bundle.find("nodes", Path(spec.file).name, folder)
    return spec if found is None else replace(spec, file=str(found))
