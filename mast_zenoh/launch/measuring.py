"""Measures a run once more from its recording: with a later version, or where it was killed before it had results."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from mast_zenoh import bundle, loading
from mast_zenoh.errors import RunFolderError
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.launch import notices
from mast_zenoh.messagelog.writer import FILE
from mast_zenoh.resolved import NodeSpec, Resolved
from mast_zenoh.runtime.replaying import replay
from mast_zenoh.runtime.results import EVALUATOR

METRICS = "metrics.json"

#: What metrics.json holds of the wall clock and of the broker's counts: no recording tells it.
_NOT_RECORDED = ("late", "latency_ms", "frames_per_second")


def can_fill_in(folder: Path) -> bool:
    """Whether a run folder lacks metrics and holds what they can be measured from."""
    return not (folder / METRICS).exists() and (folder / FILE).is_file()


def measure(folder: Path) -> list[str]:
    """Write metrics.json and the evaluator's tables anew, from the recording in a run folder.

    The times on the wall clock are kept as they were measured in the run. Returns a sentence for each table that was
    refused, and one if the recording is known to be incomplete. Raises RunFolderError where something is missing or
    damaged, and HandlerFailed where the evaluator fails.
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
    results = replay(replace(resolved, nodes={**resolved.nodes, EVALUATOR: evaluator}), EVALUATOR, folder)
    before = run_folder.json_or_empty(folder / METRICS)
    kept = {name: before[name] for name in _NOT_RECORDED if name in before}
    incomplete = notices.of_recording(run_folder.json_or_empty(folder / "run.json"))
    return [*run_folder.write_results(folder, {EVALUATOR: results}, kept), *incomplete]


def _found_here(spec: NodeSpec, folder: Path) -> NodeSpec:
    """The node's spec with a file that is on this machine: that of the run, else ours of the same name."""
    if Path(spec.file).is_file():
        return spec
    found = bundle.find("nodes", Path(spec.file).name, folder)
    return spec if found is None else replace(spec, file=str(found))
