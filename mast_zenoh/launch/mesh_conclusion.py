"""Concludes a run on a mesh: completes its record, and raises its error."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mast_zenoh.control.results import EVALUATOR
from mast_zenoh.errors import RunError, StallError
from mast_zenoh.launch import conclusion, ending, latency
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.launch.context import RunContext
from mast_zenoh.launch.protocol.endings import churn_of
from mast_zenoh.launch.reports import Reports
from mast_zenoh.launch.supervisor import Supervisor
from mast_zenoh.wiring.model import Wiring


def conclude(context: RunContext, supervisor: Supervisor[Any], reports: Reports, begun: float) -> None:
    """Write the results into the run folder, and raise the run's error if it has one.

    begun: when the run began, s on the monotonic clock
    """
    record, stop, outcomes = context.record, context.stop, reports.outcomes
    record["nodes"] = supervisor.to_json(reports.by_node())
    driver: Mapping[str, Any] = next((o for o in outcomes.values() if "sent_ns" in o), {})
    if context.first_frame_s is not None:
        record["timings"]["start_s"] = round(context.first_frame_s - begun, 3)
    if driver:
        record["timings"] |= run_folder.rates(driver["frames"], driver["wall_s"])
        record["churn"] = churn_of(outcomes, context)
    lost = [child for child in supervisor.children.values() if not child.handed_in and not child.exit_expected]
    record["message"] = "; ".join(f"{child.name} {child.ended}" for child in lost)
    record["invalid_control"] = context.invalid.entry()
    if context.secure != "open":  # no node can have obeyed an unsigned message, whatever it reports
        record["nodes"] = {name: node | {"unsigned_control": 0} for name, node in record["nodes"].items()}
    unsigned = [node["unsigned_control"] or 0 for node in record["nodes"].values()]
    record["unsigned_control"] = context.signatures.obeyed + sum(unsigned)
    handed_in = {name: outcome["results"] for name, outcome in outcomes.items()}
    measured: dict[str, Any] = {}
    if context.resolved.mode == "realtime":
        measured["latency_ms"] = latency.latency_ms(Wiring.from_json(context.resolved.wiring), outcomes)
        measured["frames_per_second"] = record["timings"].get("frames_per_second")
    conclusion.write(context.resolved, context.folder, record, handed_in, measured)
    if isinstance(stop.problem, StallError):
        stop.problem = ending.of_stall(stop.problem, record["notices"])
    if stop.problem is None and EVALUATOR not in handed_in:
        stop.problem = RunError("the evaluator handed in no results")
    if stop.problem is not None:
        raise stop.problem
