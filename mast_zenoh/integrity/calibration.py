"""The data on which the shipped thresholds were calibrated, which no test may use."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from mast_zenoh.errors import ConfigurationError

#: Seeds, and generated junctions (`Intersection.scene_index`), of the runs from which thresholds were chosen. (Runs of
#: seeds 201 and 202 on other junctions showed a weakness of a statistic, and are test data no more.)
CALIBRATION_SEEDS = range(101, 203)
CALIBRATION_SCENES = range(4)


def refuse_calibration_data(seeds: Iterable[int], scene: Mapping[str, Any], place: str) -> None:
    """Raise ConfigurationError if a test would use seeds or a scene from which thresholds were chosen.

    scene: its configuration, as from `scenes.parse_scene`;  place: named in the error
    """
    used = sorted(set(seeds).intersection(CALIBRATION_SEEDS))
    if used:
        raise ConfigurationError(
            f"{place}: seed {used[0]}: thresholds were calibrated on seeds {_span(CALIBRATION_SEEDS)}, "
            "expected other seeds: a defence tested on its calibration data looks better than it is"
        )
    if scene.get("type") == "Intersection" and scene.get("scene_index", 0) in CALIBRATION_SCENES:
        raise ConfigurationError(
            f"{place}: scene intersection:{scene.get('scene_index', 0)}: thresholds were calibrated on the junctions "
            f"{_span(CALIBRATION_SCENES)}, expected intersection:{CALIBRATION_SCENES.stop} or above: a defence tested "
            "on its calibration data looks better than it is"
        )


def _span(numbers: range) -> str:
    return f"{numbers.start} to {numbers.stop - 1}"
