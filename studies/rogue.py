"""What attackers achieve against a run, at every level of security."""


def study(levels="open,tls,mtls,acl", n_infrastructure=2):
    """levels: security levels, separated by commas; scenarios/rogue.py has the attempts made at each."""
    return dict(
        name="rogue",
        runs=dict(rogue=dict(scenario="rogue", parameters=dict(n_infrastructure=n_infrastructure))),
        security=[level.strip() for level in levels.split(",")],
        seed=0,
    )
