"""Attacks on a run from outside, and their effects at every security level."""

import time
from functools import partial

import zenoh

from mast_zenoh.mesh.security.credentials import ROUTER
from mast_zenoh.mesh.security.levels import endpoint, router_settings
from mast_zenoh.mesh.session import open_router
from mast_zenoh.study.attacked_run import Outcome, listen
from mast_zenoh.study.choices import words
from mast_zenoh.study.definition import Attempt

# Messages that each attempt forges; s for which it listens, and waits for a node that it lures.
MESSAGES, LISTEN_S, LURE_S = 20, 1.5, 3.0


def study(levels="open,tls,mtls,acl", n_infrastructure=2):
    """Attacks on the run of scenarios/rogue.py: forging, eavesdropping, and a rogue router.

    levels: security levels, separated by commas
    """
    return dict(
        name="rogue",
        runs=dict(rogue=dict(scenario="rogue", parameters=dict(n_infrastructure=n_infrastructure))),
        security=words(levels),
        attempts=[
            Attempt("no certificate", inject, wire="agent/infra_1/tracks"),
            Attempt("foreign authority", inject, shows="foreign", wire="cc/collated"),
            Attempt("expired certificate", inject, shows="expired", wire="agent/infra_2/detections"),
            Attempt("another node's key", inject, shows="infra_1", wire="cc/picture"),
            Attempt("another node's tap key", inject, shows="infra_2", wire="agent/infra_1/tracks/@tap/0"),
            Attempt("eavesdrop **", partial(eavesdrop, keys="**"), shows="infra_1"),
            Attempt("eavesdrop **/@tap/**", partial(eavesdrop, keys="**/@tap/**"), shows="infra_1"),
            Attempt("eavesdrop one key", partial(eavesdrop, keys="{run}/agent/infra_2/tracks"), shows="infra_1"),
            Attempt("ask the router", ask_router, shows="infra_1"),
            Attempt("duplicate session id", partial(inject, node="ego"), shows="infra_1", wire="agent/ego/tracks"),
            Attempt("rogue router", rogue_router, lures="infra_2", wire="agent/infra_2/pose"),
        ],
        seed=0,
    )


def inject(run, attempt, node=None):
    """Forge messages on a wire. node: whose Zenoh id the session has; None: its own"""
    with run.join(attempt.shows, node and run.zid(node)) as session:
        return run.forge(session, attempt.wire, MESSAGES)


def eavesdrop(run, attempt, keys):
    """Subscribe to a key expression on the whole mesh; {run} stands for the run's prefix."""
    with run.join(attempt.shows) as session:
        if session is None:
            return Outcome()
        heard = listen(session, keys.replace("{run}", run.prefix))
        time.sleep(LISTEN_S)
        return Outcome(True, heard=len(heard))


def ask_router(run, attempt):
    """Query the router's admin space for sessions and their keys."""
    with run.join(attempt.shows) as session:
        if session is None:
            return Outcome()
        replies = [reply.ok for reply in session.get("@/**", timeout=1.0) if reply.ok is not None]
        own = f"@/{session.info.zid()}/"  # every session also replies about itself
        return Outcome(True, heard=sum(not str(reply.key_expr).startswith(own) for reply in replies))


def rogue_router(run, attempt):
    """Redirect a node's connection to a rogue router, itself a client of the real one."""
    settings = {
        "connect/endpoints": [run.endpoint],
        "connect/exit_on_failure": False,
        "connect/timeout_ms": 0,
    }
    if run.level != "open":
        credentials = run.credentials(attempt.shows)
        if not credentials.certificate:
            credentials = run.foreign.issue(ROUTER, ["127.0.0.1"])
        settings |= router_settings("tls", credentials)
    detour, outcome = run.detours[attempt.lures], Outcome(expected=MESSAGES * run.receivers(attempt.wire))
    session, address = open_router(endpoint(run.level, "tcp/127.0.0.1:0"), security=settings)
    with session:
        heard = listen(session, f"{run.prefix}/agent/{attempt.lures}/*")
        detour.redirect(address)
        try:
            if run.wait(lambda: clients(session), LURE_S):
                lured = clients(session)
                run.wait(lambda: heard, LURE_S)
                overheard = len(heard)
                outcome = run.forge(session, attempt.wire, MESSAGES)
                outcome.lured, outcome.heard = lured, overheard
        finally:
            detour.redirect(run.endpoint)
    run.next_frame()
    return outcome


def clients(session):
    """The number of clients of a router in this process."""
    return sum(each.whatami == zenoh.WhatAmI.CLIENT for each in session.info.transports())
