"""A realistic network: wired infrastructure, cars on radio, optional attack."""

from baseline import scenario as baseline
from coordinated import scenario as coordinated
from uncoordinated import scenario as uncoordinated

from mast_zenoh.errors import ConfigurationError, nearest

ATTACKS = {"none": baseline, "uncoordinated": uncoordinated, "coordinated": coordinated}


def scenario(
    attack="none",
    n_adversaries=2,
    infrastructure="wired",
    mobile="wireless_v2x",
    max_age_s=1.0,
    scene="intersection",
    scene_index=None,
    n_infrastructure=None,
    n_mobile=None,
):
    """A run with network links between agents and command centre.

    attack: none, uncoordinated or coordinated; n_adversaries: agents compromised, if there is an attack;
    infrastructure, mobile: link profiles of static and of mobile agents (perfect, wired, wireless_v2x); max_age_s: the
    maximum age of an agent's tracks that the command centre uses;
    n_mobile: None: two cars besides the ego on a generated junction, else all of the scene.
    """
    if n_mobile is None and str(scene).startswith("intersection"):
        n_mobile = 2
    if attack not in ATTACKS:
        raise ConfigurationError(f"attack: found {attack!r}{nearest(str(attack), ATTACKS)}")
    attack_options = {} if attack == "none" else dict(n_adversaries=n_adversaries)
    place = dict(scene=scene, scene_index=scene_index, n_infrastructure=n_infrastructure, n_mobile=n_mobile)
    return ATTACKS[attack](**attack_options, **place) | dict(
        name="realistic_network",
        links={"infra_*": infrastructure, "*": mobile},
        broker=dict(latency_s=0.0, max_age_s=max_age_s),
    )
