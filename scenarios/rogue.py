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


def outsider():
    """Attacks by an outsider.

    shows: the certificate that the attacker presents: nothing, one from its own authority (foreign), an expired one,
    or the certificate of a node that it has taken over. wire: the key on which it forges messages.
    """
    return [
        dict(type="Inject", name="no certificate", shows="nothing", wire="agent/infra_1/tracks"),
        dict(type="Inject", name="foreign authority", shows="foreign", wire="cc/collated"),
        dict(type="Inject", name="expired certificate", shows="expired", wire="agent/infra_2/detections"),
        dict(type="Inject", name="another node's key", shows="infra_1", wire="cc/picture"),
        dict(type="Inject", name="another node's tap key", shows="infra_2", wire="agent/infra_1/tracks/@tap/0"),
        dict(type="Eavesdrop", name="eavesdrop **", shows="infra_1", keys="**"),
        dict(type="Eavesdrop", name="eavesdrop **/@tap/**", shows="infra_1", keys="**/@tap/**"),
        dict(type="Eavesdrop", name="eavesdrop one key", shows="infra_1", keys="{run}/agent/infra_2/tracks"),
        dict(type="AskRouter", name="ask the router", shows="infra_1"),
        dict(
            type="DuplicateSession", name="duplicate session id", shows="infra_1", node="ego", wire="agent/ego/tracks"
        ),
        dict(type="RogueRouter", name="rogue router", node="infra_2", wire="agent/infra_2/pose"),
    ]
