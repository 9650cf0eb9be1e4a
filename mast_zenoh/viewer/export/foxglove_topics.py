"""The topics of a run in Foxglove and Lichtblick."""

from __future__ import annotations

from mast_zenoh.metrics.record import Series
from mast_zenoh.viewer.frame import FrameSource
from mast_zenoh.viewer.routes import TRUTH

TRANSFORMS, BUILDINGS, CHANGES, LOG = "/tf", "/scene/buildings", "/changes", "/log"


def objects(run: FrameSource) -> dict[Series, str]:
    """The topic of the objects of each series."""
    return {series: f"/{topic}" for series, topic in run.topics.items()}


def missed(run: FrameSource) -> dict[Series, str]:
    """The topic of the objects that each estimate misses."""
    return {series: f"{topic}/missed" for series, topic in objects(run).items() if series != TRUTH}


def scores(series: Series) -> str:
    """The topic of the scores of an estimate."""
    return f"/scores/{series.agent}/{series.estimator}"


def camera(agent: str) -> str:
    """The topic of the calibration of an agent's camera."""
    return f"/agent/{agent}/camera"


def image(agent: str) -> str:
    """The topic of the image of an agent's camera."""
    return f"{camera(agent)}/image"
