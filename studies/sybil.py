"""An outsider that invents agents, at every security level."""


def study(levels="open,tls,mtls,acl"):
    """The attacks of scenarios/sybil.py.

    levels: security levels, separated by commas
    """
    return dict(
        name="sybil",
        runs=dict(sybil=dict(scenario="sybil")),
        security=[level.strip() for level in levels.split(",")],
        seed=0,
    )
