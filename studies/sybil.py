"""Agents that an outsider invents, at every security level."""

import numpy as np

from mast_zenoh.arrays.states import CLASS_INDEX, ObjectStates
from mast_zenoh.errors import MessageError
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header
from mast_zenoh.streams import stream
from mast_zenoh.study.attacked_run import Outcome, listen
from mast_zenoh.study.choices import words
from mast_zenoh.study.definition import Attempt

MESSAGES = 10  # one a frame
# Standing vehicles that each agent claims, m around the origin; variances of x y z l w h vx vy vz.
OBJECTS, SPREAD_M, VARIANCES = 3, 30.0, [0.04] * 3 + [0.02] * 3 + [0.5] * 3


def study(levels="open,tls,mtls,acl"):
    """Tracks of the absent agents of scenarios/sybil.py, and of an agent that no scenario has.

    levels: security levels, separated by commas
    """
    return dict(
        name="sybil",
        runs=dict(sybil=dict(scenario="sybil")),
        security=words(levels),
        attempts=[
            Attempt("absent agent", claim, wire="agent/infra_3/tracks"),
            Attempt("absent agent, another's key", claim, wire="agent/infra_4/tracks", shows="infra_1"),
            Attempt("agent that nobody knows", claim, wire="agent/ghost/tracks"),
        ],
        seed=0,
    )


def claim(run, attempt):
    """Send tracks in the name of an agent that does not run, with valid headers.

    On an open mesh the broker takes it for an agent that joins, and collates its tracks. It subscribes to the agents of
    the scenario by name, so an agent that no scenario has is heard nowhere. With ACLs nobody but the agent itself may
    publish on its keys. `heard`: batches of the broker with tracks of this agent
    """
    agent = attempt.wire.split("/")[1]
    with run.join(attempt.shows) as session:
        outcome = Outcome(session is not None, expected=MESSAGES * run.receivers(attempt.wire))
        if session is not None:
            batches = listen(session, f"{run.prefix}/cc/collated")
            for number in range(MESSAGES):
                message = tracks(agent, run.next_frame(), run.resolved.period_ns, number)
                run.put(session, attempt.wire, codec.encode(message))
                outcome.sent += 1
            run.flush()
            outcome.heard = sum(are_in(batch, agent) for batch in batches)
    return outcome


def tracks(agent, frame, period_ns, number):
    """The tracks of an agent in a frame, in the world frame."""
    position = stream(0, "sybil", agent).uniform(-SPREAD_M, SPREAD_M, (OBJECTS, 3))
    position[:, 2] = 0.8
    states = ObjectStates.of(
        position,
        size=np.tile([4.4, 1.8, 1.6], (OBJECTS, 1)),
        covariance=np.tile(np.diag(VARIANCES), (OBJECTS, 1, 1)),
        class_id=np.full(OBJECTS, CLASS_INDEX["car"], np.uint8),
    )
    reference = dict(origin=np.zeros(3), rotation=np.array([1.0, 0.0, 0.0, 0.0]))
    return codec.conform(Header("tracks", agent, frame, frame * period_ns, number), states.columns() | reference)


def are_in(batch, agent):
    """Whether a batch of the broker has tracks of an agent."""
    try:
        return agent in codec.decode(batch.payload.to_bytes(), "collated").body["agents"].tolist()
    except MessageError:  # of another outsider
        return False
