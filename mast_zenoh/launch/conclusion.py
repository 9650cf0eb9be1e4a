"""Writes the results and notices of a run that is over."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.control import results
from mast_zenoh.launch import confidence_notices, idle, notices
from mast_zenoh.launch import folder as run_folder


def write(
    resolved: Resolved,
    folder: Path,
    record: dict[str, Any],
    handed_in: Mapping[str, Mapping[str, Any]],
    measured: Mapping[str, Any],
) -> None:
    """Write the results of all nodes into the run folder, and add notices to `record`.

    record:    run.json, with its nodes and timings
    handed_in: what each node returned from `finish`
    measured:  see `folder.write_results`
    """
    run_folder.note_recording(folder, record, handed_in, resolved.nodes)
    collations = results.collations(handed_in, resolved.nodes)
    innovations = confidence_notices.innovations(handed_in, resolved.nodes)
    record["innovations"] = dict(sorted(innovations.items()))
    measured = {"late": results.late(collations), **measured}
    if "replay" in record:
        measured["replay"] = {key: value for key, value in record["replay"].items() if key != "notices"}
    refused = run_folder.write_results(folder, handed_in, measured)
    record["notices"] = notices.of_run(resolved, record, collations, measured, refused)
    metrics = handed_in.get(results.EVALUATOR, {}).get("metrics")
    if isinstance(metrics, Mapping):
        record["notices"] += notices.of_scores(metrics, record["timings"].get("frames"))
        record["notices"] += confidence_notices.of_metrics(metrics, innovations)
    played = record["timings"].get("frames") or 0
    record["notices"] += (idle.of_replay if "replay" in record else idle.of_run)(resolved, played, handed_in)
