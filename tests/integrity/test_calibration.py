"""Data for calibration and data for tests never mix."""

import pytest

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.integrity.calibration import CALIBRATION_SCENES, refuse_calibration_data

JUNCTION = {"type": "Intersection", "scene_index": 4}


def test_other_seeds_and_junctions_are_accepted() -> None:
    refuse_calibration_data([0, 100, 203], JUNCTION, "study")
    refuse_calibration_data([0], {"type": "AV2Log", "path": "log"}, "study")


@pytest.mark.parametrize("seed", [101, 150, 202])
def test_a_calibration_seed_is_refused(seed: int) -> None:
    with pytest.raises(ConfigurationError, match=f"study.*{seed}: thresholds"):
        refuse_calibration_data([0, seed], JUNCTION, "study")


@pytest.mark.parametrize("index", CALIBRATION_SCENES)
def test_a_calibration_junction_is_refused(index: int) -> None:
    with pytest.raises(ConfigurationError, match=f"scene intersection:{index}.*intersection:4"):
        refuse_calibration_data([0], {"type": "Intersection", "scene_index": index}, "study")
