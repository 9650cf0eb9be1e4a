"""Loads the reference run of a comparison and checks that it is comparable."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh.errors import NotComparable
from mast_zenoh.runs.driven import course_of
from mast_zenoh.runs.run import Run

#: Settings of the evaluator that do not change how two runs are scored: users' metrics, which only add rows, and what
#: describes the experiment itself (its faults, how long its agents use a picture, and when its world obeys drivers).
_NOT_OF_SCORING = (
    *("agents", "metrics", "faults", "picture_ages_s", "estimate_ages_s"),
    *("take_over_s", "hold_s", "car_limits", "played_drivers", "drivers"),
)
#: m; a driven car that is this far from where it is in the other run goes another way.
WAY_M = 1.0


@dataclass(frozen=True, eq=False)
class Reference:
    """The reference run of a comparison, and the name that it has in the text."""

    run: Run
    name: str


def reference(run: Run, other: Path) -> Reference:
    """Load the reference run with which `run` is compared.

    Raises NotComparable if either has no results, or if their scene, seed, agents, length or scoring differ, and
    RunFolderError if the folder holds no run.
    """
    second = Run(other)
    for each in (run, second):
        if not each.files.summary.get("agents"):
            problem = "has a damaged metrics.json" if each.metrics_damaged else "has no results (metrics.json)"
            raise NotComparable(f"{each.path}: {problem}: expected a run that was scored")
    folders = f"{run.path} and {other}"
    if difference := _agents_difference(run, second):
        raise NotComparable(f"{folders}: {difference}: expected the same agents in both")
    frames = [each.files.summary.get("frames") for each in (run, second)]
    if frames[0] != frames[1]:
        raise NotComparable(f"{folders}: found {frames[0]} and {frames[1]} frames, expected the same number in both")
    if difference := _scoring_difference(run, second):
        raise NotComparable(
            f"{folders}: {difference}: expected runs that were scored the same way; run one of them again with the "
            "evaluator of the other"
        )
    seeds = [each.files.record.get("seed") for each in (run, second)]
    if seeds[0] != seeds[1] or not _same_scene(run, second):
        scenes = [each.files.scene.name if each.files.scene else "an unknown scene" for each in (run, second)]
        raise NotComparable(
            f"{folders}: found {scenes[0]} with seed {seeds[0]}, and {scenes[1]} with seed {seeds[1]}: expected the "
            "same scene and seed, so that differences are due to what was changed"
        )
    name = second.name if second.name not in (run.name, "") else other.resolve().name
    return Reference(second, name)


def same_ways(run: Run, other: Run) -> bool:
    """Whether each driven car is within WAY_M of where it is in another run, in all frames; True: no driven cars.

    Elsewhere, sensors see other objects: then errors differ for this reason, too. A course that is not known counts as
    another way.
    """
    cars, others = ({*(each.files.summary.get("driven") or ())} for each in (run, other))
    return cars == others and all(_same_way(run, other, car) for car in cars)


def of_errors(run: Run, reference: Reference | None) -> Reference | None:
    """The run over which errors are compared; None where driven cars go another way: by the run's own measurements."""
    return reference if reference is None or same_ways(run, reference.run) else None


def _same_way(run: Run, other: Run, car: str) -> bool:
    courses = [course for each in (run, other) if (course := course_of(each, car)) is not None]
    if len(courses) < 2:
        return False
    here, there = (np.column_stack([course["x"], course["y"]]) for course in courses)
    return here.shape == there.shape and bool((np.linalg.norm(here - there, axis=1) <= WAY_M).all())


def _agents_difference(one: Run, other: Run) -> str:
    """Agents that only one of two runs has, scored or not, in words; empty: none."""
    here, there = (
        {*each.files.summary["agents"], *(each.files.scene.agent_names if each.files.scene else ())}
        for each in (one, other)
    )
    parts = [
        f"{', '.join(sorted(names))} only in the {position}"
        for names, position in ((here - there, "first"), (there - here, "second"))
        if names
    ]
    # Without the scene, a run knows only the agents that it scored.
    known = one.files.scene is not None and other.files.scene is not None
    if not known and set(one.files.summary["agents"]) == set(other.files.summary["agents"]):
        return ""
    return f"found {' and '.join(parts)}" if parts else ""


def _scoring_difference(one: Run, other: Run) -> str:
    """How the scoring of two runs differs, in words; empty: no known difference."""
    configs = [each.evaluator_config for each in (one, other)]
    if all(config is not None for config in configs):
        here, there = (
            _flat("evaluator", {key: value for key, value in (config or {}).items() if key not in _NOT_OF_SCORING})
            for config in configs
        )
        for name in sorted(here.keys() | there.keys()):
            values = [settings.get(name, "nothing") for settings in (here, there)]
            if values[0] != values[1]:
                return f"{name}: found {values[0]} and {values[1]}"
    scored = [each.scored_frames for each in (one, other)]
    if None not in scored and scored[0] != scored[1]:
        return f"scored_frames: found {scored[0]} and {scored[1]}"
    return ""


def _flat(name: str, value: Any) -> dict[str, Any]:
    """The leaves of nested settings by dotted name."""
    if not isinstance(value, Mapping):
        return {name: value}
    return {key: leaf for part, inner in value.items() for key, leaf in _flat(f"{name}.{part}", inner).items()}


def _same_scene(one: Run, other: Run) -> bool:
    """Whether two runs have the same scene.

    Compares object positions in all frames or, without recordings, the scene settings; and these where cars are driven,
    because what is in the scene then follows from the run.
    """
    driven = any("driven" in each.files.summary for each in (one, other))
    if driven or one.files.scene is None or other.files.scene is None:
        return bool(one.files.scenario.get("scene") == other.files.scenario.get("scene"))
    frames = int(one.files.summary["frames"])
    for frame in range(min(frames, len(one.files.scene), len(other.files.scene))):
        here, there = one.files.scene.truth_at(frame), other.files.scene.truth_at(frame)
        if not np.array_equal(here.id, there.id) or not np.array_equal(here.position, there.position):
            return False
    return True
