"""Differences between agents that each have a picture of their own: how far these differ, and whom a lie deceives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from mast_zenoh.arrays.boxes import Boxes
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.assignment import SetDistance, centre_distance
from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.metrics.scores import FALSE, MISSED, Scores, mean_and_std

#: Each picture is compared with those of so many agents that follow in the list: with nine agents, all with all.
COMPARED = 4


def with_pictures(scores: Scores) -> list[str]:
    """The agents with a picture of their own."""
    own = {agent for agent, estimator in scores.series if estimator == PICTURE}
    return [agent for agent in scores.agents if agent in own]


def of_pictures(
    names: Sequence[str],
    frames: Ints,
    deceived: Bools,
    differences: Floats,
    period_s: float,
    lies_from: int | None,
) -> dict[str, Any]:
    """The part `pictures` of metrics.json; {} with fewer than two pictures. Agents must not share one.

    names: of a agents with pictures;  frames: (f,) the frames that count
    deceived: (f, a), see `deceived_agents`;  differences: (p, f) m, see `differences`
    lies_from: frame of the first message that an adversary changed, from which on shares count; None: no lie

    Keys:
    count: number of pictures
    difference_gospa_m: GOSPA between the pictures of two agents, of what is in range of both: `mean` and `std`
    deceived.lies_from_s: frame of the first message that an adversary changed; None: none
    deceived.share: 0 to 1, agents whose picture has an error that an adversary caused: `mean` and `std` over frames
    deceived.most: 0 to 1, the greatest share
    deceived.first_s: the first such frame; None: never
    deceived.half_after_s: how much later half of the agents are deceived; None: never
    deceived.agents: by agent, the share of the frames
    deceived.since_s: by agent, the first such frame; None: never
    consistency: for `position` and `velocity`: `nees` (the mean), the agents `above` and `below` the bounds, and
        `agents`
    """
    if len(names) < 2:
        return {}
    since = int(np.searchsorted(frames, lies_from or 0))
    frames, deceived = frames[since:], deceived.T[:, since:]
    share = deceived.mean(axis=0)
    wrong = np.flatnonzero(share > 0.0)
    half = np.flatnonzero(share >= 0.5)
    first_s = float(frames[wrong[0]]) * period_s if len(wrong) else None
    half_after_s = (float(frames[half[0]]) * period_s - first_s) if len(half) and first_s is not None else None
    return {
        "count": len(names),
        "difference_gospa_m": mean_and_std(differences.ravel()),
        "deceived": {
            "lies_from_s": None if lies_from is None else lies_from * period_s,
            "share": mean_and_std(share),
            "most": float(share.max(initial=0.0)),
            "first_s": first_s,
            "half_after_s": half_after_s,
            "agents": {
                name: float(each.mean()) if len(each) else 0.0 for name, each in zip(names, deceived, strict=True)
            },
            "since_s": {
                name: float(frames[each.argmax()]) * period_s if each.any() else None
                for name, each in zip(names, deceived, strict=True)
            },
        },
    }


def consistency_of_pictures(consistency: Mapping[str, Any]) -> dict[str, Any]:
    """The part `pictures.consistency`: how confident the pictures of agents are, compared with their accuracy.

    consistency: as in metrics.json, see `Consistency.summary`

    By quantity: `agents`, by name, `nees`, `low` and `high` of each picture with a defined value; `nees`, their mean;
    `above` and `below`, names of the agents whose NEES is outside its 95 % bounds. Only `above` breaks the promise of a
    covariance, which is an upper limit of the error.
    """
    pictures = {agent: estimates[PICTURE] for agent, estimates in consistency.items() if PICTURE in estimates}
    part: dict[str, Any] = {}
    for quantity in ("position", "velocity"):
        agents = {
            agent: {key: picture[quantity][key] for key in ("nees", "low", "high")}
            for agent, picture in pictures.items()
            if picture[quantity]["nees"] is not None
        }
        part[quantity] = {
            "nees": mean_and_std(np.array([each["nees"] for each in agents.values()]))["mean"],
            "above": [agent for agent, each in agents.items() if each["nees"] > each["high"]],
            "below": [agent for agent, each in agents.items() if each["nees"] < each["low"]],
            "agents": agents,
        }
    return part


def deceived_agents(scores: Scores, blamed: Bools, agents: Sequence[str]) -> Bools:
    """(f, a) whether the picture of each agent is wrong in each frame because of an adversary.

    blamed: as for `of_pictures`; an agent without a picture of its own is not deceived
    """
    judged = scores.judged
    bad = blamed & ((judged.outcome == FALSE) | (judged.outcome == MISSED))
    frame = np.searchsorted(scores.frames, judged.frame[bad])
    wrong = np.zeros((len(scores.frames), len(scores.series) + 1), np.bool_)
    wrong[frame, judged.series[bad]] = True
    rows = {agent: row for row, (agent, estimator) in enumerate(scores.series) if estimator == PICTURE}
    return wrong[:, [rows.get(agent, -1) for agent in agents]]


def differences(scores: Scores, names: Sequence[str], range_m: float, distance: SetDistance) -> Floats:
    """(p, f) m, GOSPA between the pictures of p pairs of agents, of what is in range of both.

    range_m: m, from an agent, in which its picture is scored; distance: of sets
    """
    judged, n_frames = scores.judged, len(scores.frames)
    rows = {agent: row for row, (agent, estimator) in enumerate(scores.series) if estimator == PICTURE}
    steps = range(1, min(COMPARED, len(names) - 1) + 1)
    pairs = sorted({tuple(sorted((a, (a + step) % len(names)))) for a, step in product(range(len(names)), steps)})
    frame = np.searchsorted(scores.frames, judged.frame)
    position = scores.truth.agent_position
    own_rows = [np.flatnonzero(judged.is_track & (judged.series == rows[name])) for name in names]
    one: list[Boxes] = []
    other: list[Boxes] = []
    for number, (a, b) in enumerate(pairs):
        for side, mine, theirs in ((one, a, b), (other, b, a)):
            own = own_rows[mine]
            place = position[frame[own], scores.agents.index(names[theirs])]
            near = own[centre_distance(judged.boxes.position[own], place) <= range_m]
            side.append(judged.boxes.select(near).in_group(number * n_frames + frame[near]))
    gospa = distance.of(Boxes.join(one), Boxes.join(other), len(pairs) * n_frames)[1]
    return gospa.reshape(len(pairs), n_frames)
