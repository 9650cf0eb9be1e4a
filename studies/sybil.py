"""An outsider that invents agents, at every security level."""

from mast_zenoh.study.defences import words


def study(levels="open,tls,mtls,acl"):
    """The attacks of scenarios/sybil.py.

    levels: security levels, separated by commas
    """
    return dict(
        name="sybil",
        runs=dict(sybil=dict(scenario="sybil")),
        security=words(levels),
        seed=0,
    )
