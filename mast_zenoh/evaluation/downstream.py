"""Which estimates an interposer on a wire can influence: those that are made from what it sends."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mast_zenoh.arrays.states import Bools
from mast_zenoh.metrics.record import LOCAL, MISSION, PICTURE, PICTURE_ON_ARRIVAL, PICTURE_RECEIVED, RECEIVED
from mast_zenoh.wiring.model import Passage

_OF_THE_CENTRE = (PICTURE, PICTURE_RECEIVED, PICTURE_ON_ARRIVAL, MISSION)
_OF_THE_DOWNLINK = (PICTURE_RECEIVED, PICTURE_ON_ARRIVAL, MISSION)
#: Ports of messages that no estimate is made from: the truth, and estimates, which are scored where they are made.
_FOR_NO_ESTIMATE = ("truth", "mission", "report", "observation", "directive")


def reached(passages: Sequence[Passage], series: Sequence[tuple[str, str]], is_link: Bools) -> Bools:
    """(p, s) bool: whether what is sent on each of p passages can be seen in each of s series (agent, estimator).

    An agent's own tracks are made from what it senses alone. A port of which nothing is known may reach everything
    else. What links do to tracks on their way reaches, here, only the tracks as they are received: whether the
    picture lacks an object because of it depends on who else reports that object (`metrics.cut_off`).
    """
    result = np.zeros((len(passages), len(series)), bool)
    for row, passage in enumerate(passages):
        for column, (agent, estimator) in enumerate(series):
            result[row, column] = _reaches(passage, agent, estimator, bool(is_link[row]))
    return result


def _reaches(passage: Passage, agent: str, estimator: str, is_link: bool) -> bool:
    own, port = agent == passage.subject, passage.port
    if port in ("detections", "pose"):
        return own or estimator in _OF_THE_CENTRE
    if port == "tracks":
        return (own and estimator == RECEIVED) or (not is_link and estimator in _OF_THE_CENTRE)
    if port in ("status", "collated"):
        return not is_link and estimator in _OF_THE_CENTRE
    if port == "picture":
        return estimator in _OF_THE_DOWNLINK and passage.before in ("", agent)
    return port not in _FOR_NO_ESTIMATE and (estimator != LOCAL or port == "clock")
