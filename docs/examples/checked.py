import numpy as np

import mast_zenoh as mast
from mast_zenoh.launch.checks import RunCheck
from mast_zenoh.scenario import load


class PictureNeverEmpty(RunCheck):
    """Once there is a picture, it always has an object."""

    def check(self, folder):
        frames = np.unique(mast.open(folder).picture["frame"].to_numpy())
        missing = int(np.sum(np.diff(frames) - 1))
        return missing == 0, f"{missing} frames without any object after the first one"


def scenario():
    _, base = load("baseline")
    return base | dict(name="checked")
