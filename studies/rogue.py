"""Attacks on a run, and their effects at every security level."""


def study(levels="open,tls,mtls,acl", n_infrastructure=2):
    """The attacks of scenarios/rogue.py.

    levels: security levels, separated by commas
    """
    return dict(
        name="rogue",
        runs=dict(rogue=dict(scenario="rogue", parameters=dict(n_infrastructure=n_infrastructure))),
        security=[level.strip() for level in levels.split(",")],
        seed=0,
    )
