"""Facts about runs at the top of their reports."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mast_zenoh.viewer.run import RunRecord


def facts(run: RunRecord) -> list[str]:
    """What identifies a run: id, status, scene, length, seed, mode and speed."""
    facts = [f"run {run.run['id']}"] if "id" in run.run else []
    facts += [str(run.run["status"])] if "status" in run.run else []
    facts += [f"scene {run.recording.name}"] if run.recording else []
    facts += [_frames(run)] if "frames" in run.metrics else []
    facts += [f"seed {run.run['seed']}"] if "seed" in run.run else []
    facts += [_origin(run.run["replay"])] if run.run.get("replay") else []
    facts += [f"{run.run['mode']} on {run.run.get('runtime', 'mesh')}"] if "mode" in run.run else []
    unsigned = run.run.get("unsigned_control")
    facts += [f"{unsigned} control messages obeyed without a signature"] if unsigned else []
    speed = run.run.get("timings", {}).get("frames_per_second")
    facts += [f"{speed:.0f} frames/s"] if speed else []
    latency = run.metrics.get("latency_ms", {}).get("sim_to_picture", {})
    if latency.get("p50") is not None and latency.get("p99"):  # lock-step has no latency: scene time stands still
        facts.append(f"simulator to picture {latency['p50']:.1f} ms (99 %: {latency['p99']:.1f} ms)")
    ages = run.metrics.get("picture_age_s", {})
    age = ages.get("ego", next(iter(ages.values()), {}))
    facts += [f"pictures used at an age of {age['mean']:.2f} s (at most {age['max']:.2f} s)"] if age.get("max") else []
    return facts


def _origin(replay: Mapping[str, Any]) -> str:
    """What a replay replays."""
    changed = ", ".join(f"{node} ({', '.join(keys)})" for node, keys in replay.get("changed", {}).items())
    return f"replay of run {replay.get('run')} from the {replay.get('from')}" + (
        f", changed: {changed}" if changed else ""
    )


def healing(run: RunRecord) -> list[str]:
    """When faults healed, and how soon the picture then equalled the fault-free one."""
    heals, converged = run.checks.get("heals_s") or [], run.checks.get("converged_after_s")
    facts = [f"healed at {', '.join(f'{each:g}' for each in heals)} s"] if heals else []
    if isinstance(converged, (int, float)):
        facts.append(f"the picture converged to the unfaulted one {converged:.1f} s after the heal")
    return facts


def facts_of_compared(runs: Mapping[str, RunRecord]) -> list[str]:
    """What compared runs have in common, and which of them failed; runs: by label."""
    facts = [f"{len(runs)} runs"]
    scenes = {run.recording.name for run in runs.values() if run.recording}
    seeds = {str(run.run["seed"]) for run in runs.values() if "seed" in run.run}
    frames = {_frames(run) for run in runs.values() if "frames" in run.metrics}
    facts += [f"scene {', '.join(sorted(scenes))}"] if scenes else []
    facts += [f"seed {', '.join(sorted(seeds))}"] if seeds else []
    facts += [f"each {frames.pop()}"] if len(frames) == 1 else []
    bad = [label for label, run in runs.items() if run.run.get("status") != "ok"]
    return facts + ([f"did not end well: {', '.join(bad)}"] if bad else [])


def _frames(run: RunRecord) -> str:
    scored = run.metrics.get("scored_frames")
    return f"{run.metrics['frames']} frames" + (f", scored from {scored[0]} to {scored[-1]}" if scored else "")
