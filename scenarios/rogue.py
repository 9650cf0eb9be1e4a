"""A small run with a node of every role, for the attacks of `mast study rogue`."""

from coordinated import scenario as coordinated


def scenario(n_infrastructure=2, scene="intersection", scene_index=None):
    """A coordinated attack by one adversary, with a tap leg, and one link."""
    attacked = coordinated(
        n_adversaries=1, n_infrastructure=n_infrastructure, scene=scene, scene_index=scene_index, attack_start_s=0.5
    )
    return attacked | dict(
        name="rogue",
        links={"ego": "wired"},
        run=dict(mode="realtime", rate=0.25, seed=0, record=False),
    )
