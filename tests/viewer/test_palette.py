"""The colours of states can be told apart, with and without a colour-vision deficiency."""

import numpy as np
import pytest

from mast_zenoh.arrays.states import Floats
from mast_zenoh.integrity import STATES
from mast_zenoh.show.palette import GROUNDS, KEYS, rgb

#: Linear RGB as seen with full deficiency: Machado, Oliveira and Fernandes (2009), table 1.
VISION = {
    "normal": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
_WHITE = np.array([0.95047, 1.0, 1.08883])


def linear(colour: str) -> Floats:
    value = np.array(rgb(colour)) / 255.0
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def lab(colour: str, vision: str) -> Floats:
    """CIE L*a*b* of a colour as seen with a deficiency."""
    xyz = _TO_XYZ @ np.clip(VISION[vision] @ linear(colour), 0.0, 1.0) / _WHITE
    x, y, z = np.where(xyz > 216.0 / 24389.0, np.cbrt(xyz), (24389.0 / 27.0 * xyz + 16.0) / 116.0)
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


def difference(one: str, other: str, vision: str) -> float:
    return float(np.linalg.norm(lab(one, vision) - lab(other, vision)))


def contrast(one: str, other: str) -> float:
    """The ratio of luminances of WCAG 2.1, 1 to 21."""
    low, high = sorted(_TO_XYZ[1] @ linear(colour) + 0.05 for colour in (one, other))
    return float(high / low)


@pytest.mark.parametrize("ground", GROUNDS)
@pytest.mark.parametrize("name", KEYS)
def test_an_undecided_agent_differs_from_all_other_states(name: str, ground: str) -> None:
    colours = KEYS[name][ground].states
    assert tuple(colours) == STATES
    for vision in VISION:
        for state in colours.keys() - {"undecided"}:
            assert difference(colours["undecided"], colours[state], vision) > 20.0, (vision, state)
    assert contrast(colours["undecided"], GROUNDS[ground].ground) > 4.5, "its label is readable"
