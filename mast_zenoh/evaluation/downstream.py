"""Estimates that an interposer on a wire can influence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mast_zenoh.arrays.states import Bools
from mast_zenoh.metrics.record import LOCAL, MISSION, PICTURE, PICTURE_ON_ARRIVAL, PICTURE_RECEIVED, RECEIVED
from mast_zenoh.wiring.model import Passage
from mast_zenoh.wiring.subjects import agent_of

_FROM_CENTER = (PICTURE, PICTURE_RECEIVED, PICTURE_ON_ARRIVAL, MISSION)
_FROM_DOWNLINK = (PICTURE_RECEIVED, PICTURE_ON_ARRIVAL, MISSION)
#: Ports of messages that no estimate depends on: the truth, and estimates, which are scored at their source.
_WITHOUT_ESTIMATE = ("truth", "mission", "report", "observation", "directive")


def influence(passages: Sequence[Passage], series: Sequence[tuple[str, str]], is_link: Bools) -> Bools:
    """Whether messages of each of p passages can affect each of s series: (p, s).

    A series is (agent, estimator). An agent's own tracks depend on its sensors alone. An unknown port may affect all
    other estimates. is_link: (p,) passages of links, whose effects on tracks count only for the tracks as received:
    whether the picture lacks an object because of them depends on the other agents that report it (`metrics.cut_off`).
    """
    result = np.zeros((len(passages), len(series)), bool)
    for row, passage in enumerate(passages):
        for column, (agent, estimator) in enumerate(series):
            result[row, column] = _influences(passage, agent, estimator, bool(is_link[row]))
    return result


def _influences(passage: Passage, agent: str, estimator: str, is_link: bool) -> bool:
    own, port = agent == agent_of(passage.subject), passage.port
    if port in ("detections", "pose"):
        return own or estimator in _FROM_CENTER
    if port == "tracks":
        return (own and estimator == RECEIVED) or (not is_link and estimator in _FROM_CENTER)
    if port in ("status", "collated"):
        return not is_link and estimator in _FROM_CENTER
    if port == "picture":
        return estimator in _FROM_DOWNLINK and passage.before in ("", agent)
    return port not in _WITHOUT_ESTIMATE and (estimator != LOCAL or port == "clock")
