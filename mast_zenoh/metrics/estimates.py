"""The estimates of a run, in order of computation: their keys, and their names everywhere in reports."""

from __future__ import annotations

from typing import NamedTuple

#: An agent's estimate from its own sensors alone, as computed, and as received by the broker.
LOCAL, RECEIVED = "local", "received"
#: The command centre's picture: as computed, by its frame, shared by all agents; as received by an agent; and the
#: newest one available to the agent in each frame, which may be about an earlier frame.
PICTURE, PICTURE_RECEIVED, PICTURE_ON_ARRIVAL = "picture", "picture_received", "picture_on_arrival"
#: What no wire of a map carries: it is measured where messages arrive.
DERIVED = (RECEIVED, PICTURE_RECEIVED, PICTURE_ON_ARRIVAL)
#: An agent's estimate from its own sensors and the picture together.
MISSION = "mission"


class EstimateName(NamedTuple):
    """How an estimate is called; "ego" stands for the agent whose estimate it is.

    column:  in tables
    panel:   as the title of a picture
    subject: as the subject of a sentence
    place:   as the place of errors
    noun:    inside a sentence
    agent:   as the subject, with the name of the agent
    """

    column: str
    panel: str
    subject: str
    place: str
    noun: str
    agent: str = "{} ({estimate})"


ESTIMATES = {
    LOCAL: EstimateName(
        "ego alone",
        "the ego alone: its own tracks",
        "the ego alone",
        "in what the ego sees alone",
        "what the ego sees alone",
        "{}",
    ),
    RECEIVED: EstimateName(
        "alone, as received",
        "the ego's tracks as they are received",
        "received",
        "in the ego's tracks as they are received",
        "the ego's tracks as they are received",
        "{} as received",
    ),
    PICTURE: EstimateName(
        "picture", "the common picture", "the picture", "in the common picture", "the picture", "the picture"
    ),
    PICTURE_RECEIVED: EstimateName(
        "picture as received",
        "the picture as the ego receives it",
        "the picture that the ego receives",
        "in the picture that the ego receives",
        "the picture that the ego receives",
    ),
    PICTURE_ON_ARRIVAL: EstimateName(
        "picture on arrival",
        "the picture when it reaches the ego",
        "the picture that the ego holds",
        "in the picture when it reaches the ego",
        "the picture on arrival",
    ),
    MISSION: EstimateName(
        "ego with picture",
        "the ego with the picture",
        "the ego with the picture",
        "for the ego with the picture",
        "what the ego acts on",
        "the mission estimate of {}",
    ),
}
ESTIMATORS = tuple(ESTIMATES)
#: The estimates that every run has; those in transit are of interest if something changed them.
MAIN = (LOCAL, PICTURE, MISSION)
#: Of an agent's sensors alone; of the picture on its way to the agent; and all that such a picture can affect.
OWN = (LOCAL, RECEIVED)
IN_TRANSIT = (PICTURE_RECEIVED, PICTURE_ON_ARRIVAL)
BEHIND_DOWNLINK = (*IN_TRANSIT, MISSION)
#: The ground truth where it stands beside estimates.
TRUTH = "truth"


def rank_of(estimator: str) -> int:
    """Index of an estimator in ESTIMATORS; others come last."""
    return ESTIMATORS.index(estimator) if estimator in ESTIMATORS else len(ESTIMATORS)


def column_name(estimate: str) -> str:
    """Its name in tables; the key of an estimate that a user's evaluator made up."""
    return ESTIMATES[estimate].column if estimate in ESTIMATES else estimate


def subject_of(agent: str, estimate: str, own_picture: bool = False) -> str:
    """An estimate of a named agent, as the subject of a sentence.

    own_picture: whether each agent has a picture of its own
    """
    if own_picture and estimate == PICTURE:
        return f"the picture of {agent}"
    form = ESTIMATES[estimate].agent if estimate in ESTIMATES else "{} ({estimate})"
    return form.format(agent, estimate=estimate)


def place_of(estimate: str, agent: str, ego: str | None) -> str:
    """Where errors of an estimate are, as a phrase."""
    text = ESTIMATES[estimate].place if estimate in ESTIMATES else f"in {estimate}"
    return text if agent == ego else text.replace("the ego's", f"{agent}'s").replace("the ego", agent)
