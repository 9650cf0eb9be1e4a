"""Describes where adversaries sat in a run, and how the run failed if it did."""

from __future__ import annotations

from mast_zenoh.messagelog import churn
from mast_zenoh.report.comparison import Reference
from mast_zenoh.report.narrative.phrases import capital, count, join_names, plural
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.interposers import failures_of, frames_of, interposers


def compromised(run: RunFolder) -> str:
    """Positions of adversaries in words; empty: none.

    `two of four roadside sensors`, `the picture's path to ego`
    """
    hostile = [each for each in interposers(run) if not each.is_link]
    kinds = {agent.name: agent.kind for agent in run.recording.agents} if run.recording else {}
    compromised_agents = {agent for each in hostile for agent in each.agents}
    names = set(kinds) or set(run.metrics.get("agents", {})) | compromised_agents
    places = []
    for kind, noun in (("static", "roadside sensor"), ("mobile", "vehicle")):
        group = {name for name in names if kinds.get(name, "static" if name.startswith("infra") else "mobile") == kind}
        number = len(group & compromised_agents)
        if number and len(group) == 1:
            places.append(f"the {noun}")
        elif number:
            places.append(f"{'all' if number == len(group) else f'{count(number)} of'} {count(len(group))} {noun}s")
    places += dict.fromkeys(f"the picture's path to {agent}" for each in hostile for agent in each.before)
    other_wires = [wire for each in hostile if not each.agents and not each.before for wire in each.wires]
    places += dict.fromkeys(f"the wire {wire}" for wire in other_wires)
    return " and ".join(places)


def status(run: RunFolder) -> str:
    """How a run failed, in a sentence without a full stop; empty: it did not."""
    failed = {name: failures_of(node) for name, node in run.run.get("nodes", {}).items() if failures_of(node)}
    if failed:
        names = [f"{name} failed in {plural(frames_of(entries), 'frame')}" for name, entries in failed.items()]
        return f"Handlers of {join_names(names)}: the numbers may be wrong"
    if lost := run.lost:
        return f"{churn.sentence(lost)}: from then on it is not the run that the scenario describes"
    state, partial = run.run.get("status", "ok"), _partly_recorded(run)
    if state == "ok":
        return capital(partial)
    text = f"The run did not end well ({state}): read the numbers with that in mind"
    if state == "killed":
        text = "The run was cut off: its launcher ended before it could record the outcome"
    elif state == "running":
        text = "The run is still in progress, or was cut off: its outcome is not known"
    return f"{text}; {partial}" if partial else text


def _partly_recorded(run: RunFolder) -> str:
    """A note if the numbers come from an incomplete recording; else empty."""
    recording = run.metrics.get("recording")
    if not recording:
        return ""
    if not recording["frames"]:
        return "the recording from which it was measured holds no frame"
    last = f"frame {recording['frames'] - 1} of {recording['played_frames']}"
    return f"the recording from which it was measured ends at {last}, so the numbers are of these frames alone"


def reference_status(reference: Reference | None) -> str:
    """`compared with unattacked, which failed`; empty: no reference, or it ended well."""
    if reference is None or not status(reference.run):
        return ""
    state = reference.run.run.get("status")
    ends = {
        "running": "has not ended",
        "killed": "was cut off",
        "interrupted": "was interrupted",
        "ok": "was measured from part of its recording",
    }
    return f"compared with {reference.name}, which {ends.get(str(state), 'failed')}"
