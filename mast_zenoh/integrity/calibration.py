"""The data on which thresholds were chosen, and match losses of honest agents in them."""

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

    scene: its configuration, as from `parse_scene`;  place: named in the error
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


# fmt: off
#: 250 quantiles of 674 match losses of honest agents with the ego, see `Made`: unattacked runs of 200 frames with seeds
#: 101 to 103 on the junctions 0 to 3, one loss a second (`tools/calibrate_integrity.py 101 103 --frames 200 --losses`).
MATCH_LOSSES: tuple[float, ...] = (
    0.182, 0.233, 0.256, 0.307, 0.319, 0.329, 0.353, 0.357, 0.372, 0.378, 0.401, 0.417, 0.427, 0.430, 0.444,
    0.449, 0.454, 0.466, 0.470, 0.471, 0.474, 0.479, 0.487, 0.494, 0.495, 0.496, 0.501, 0.504, 0.506, 0.515,
    0.522, 0.524, 0.529, 0.531, 0.535, 0.536, 0.539, 0.542, 0.543, 0.547, 0.550, 0.555, 0.558, 0.560, 0.560,
    0.561, 0.564, 0.566, 0.568, 0.570, 0.571, 0.573, 0.575, 0.577, 0.579, 0.581, 0.585, 0.587, 0.589, 0.590,
    0.594, 0.595, 0.598, 0.600, 0.602, 0.603, 0.604, 0.613, 0.615, 0.621, 0.624, 0.626, 0.628, 0.630, 0.632,
    0.632, 0.635, 0.636, 0.637, 0.640, 0.642, 0.644, 0.645, 0.646, 0.649, 0.653, 0.655, 0.658, 0.660, 0.662,
    0.665, 0.668, 0.670, 0.671, 0.672, 0.673, 0.673, 0.675, 0.678, 0.682, 0.684, 0.686, 0.687, 0.688, 0.689,
    0.691, 0.693, 0.695, 0.697, 0.698, 0.698, 0.699, 0.700, 0.704, 0.706, 0.708, 0.709, 0.712, 0.713, 0.715,
    0.719, 0.721, 0.723, 0.725, 0.729, 0.731, 0.733, 0.734, 0.737, 0.738, 0.740, 0.741, 0.743, 0.749, 0.751,
    0.752, 0.755, 0.756, 0.757, 0.761, 0.766, 0.767, 0.769, 0.772, 0.776, 0.777, 0.780, 0.785, 0.789, 0.790,
    0.795, 0.795, 0.800, 0.800, 0.803, 0.808, 0.810, 0.813, 0.815, 0.817, 0.819, 0.820, 0.824, 0.825, 0.828,
    0.831, 0.835, 0.836, 0.839, 0.844, 0.845, 0.848, 0.850, 0.859, 0.860, 0.862, 0.866, 0.869, 0.873, 0.876,
    0.881, 0.882, 0.884, 0.885, 0.888, 0.890, 0.893, 0.894, 0.904, 0.911, 0.919, 0.922, 0.924, 0.928, 0.932,
    0.934, 0.937, 0.941, 0.946, 0.952, 0.955, 0.959, 0.961, 0.964, 0.967, 0.972, 0.978, 0.990, 0.997, 1.005,
    1.008, 1.010, 1.021, 1.028, 1.030, 1.034, 1.036, 1.051, 1.054, 1.063, 1.071, 1.076, 1.083, 1.094, 1.104,
    1.115, 1.128, 1.146, 1.154, 1.191, 1.201, 1.209, 1.220, 1.236, 1.247, 1.260, 1.280, 1.331, 1.390, 1.458,
    1.516, 1.680, 1.807, 1.819, 1.865, 1.870, 1.872, 1.911, 2.012, 2.154,
)
# fmt: on
