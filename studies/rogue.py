"""Attacks on a run, and their effects at every security level."""

from mast_zenoh.study.defences import words


def study(levels="open,tls,mtls,acl", n_infrastructure=2):
    """The attacks of scenarios/rogue.py.

    levels: security levels, separated by commas
    """
    return dict(
        name="rogue",
        runs=dict(rogue=dict(scenario="rogue", parameters=dict(n_infrastructure=n_infrastructure))),
        security=words(levels),
        seed=0,
    )
