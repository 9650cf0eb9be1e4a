"""The run that another one is compared with, and whether the two can be compared."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mast_zenoh.errors import NotComparable
from mast_zenoh.report.runfolder import RunFolder


@dataclass(frozen=True, eq=False)
class Reference:
    """The run that another one is compared with, and its name in words."""

    run: RunFolder
    name: str


def reference(run: RunFolder, other: Path) -> Reference:
    """The run in another folder, as what `run` is compared with.

    Raises NotComparable when one of them has no results, or scene, seed or length differ; RunFolderError when
    there is no run in the folder.
    """
    found = RunFolder.load(other)
    for each in (run, found):
        if not each.metrics.get("agents"):
            raise NotComparable(f"{each.path}: has no results (metrics.json): expected a run that was scored")
    places = f"{run.path} and {other}"
    if run.ego not in found.metrics["agents"]:
        raise NotComparable(f"{places}: found no agent {run.ego} in the second, expected the same agents")
    frames = [each.metrics.get("frames") for each in (run, found)]
    if frames[0] != frames[1]:
        raise NotComparable(f"{places}: found {frames[0]} and {frames[1]} frames, expected as many in both")
    seeds = [each.run.get("seed") for each in (run, found)]
    if seeds[0] != seeds[1] or not _same_scene(run, found):
        scenes = [each.recording.name if each.recording else "an unknown scene" for each in (run, found)]
        raise NotComparable(
            f"{places}: found {scenes[0]} with seed {seeds[0]}, and {scenes[1]} with seed {seeds[1]}: expected the "
            "same scene and seed, so that differences are due to what was changed"
        )
    name = found.label if found.label not in (run.label, "") else other.resolve().name
    return Reference(found, name)


def _same_scene(one: RunFolder, other: RunFolder) -> bool:
    """Whether objects are at the same places in the frames of both; without recordings, whether scenarios say so."""
    if one.recording is None or other.recording is None:
        return bool(one.scenario.get("scene") == other.scenario.get("scene"))
    frames = int(one.metrics["frames"])
    for frame in range(min(frames, len(one.recording), len(other.recording))):
        here, there = one.recording.truth_at(frame), other.recording.truth_at(frame)
        if not np.array_equal(here.id, there.id) or not np.array_equal(here.position, there.position):
            return False
    return True
