"""Cars that react: the ego drives by what its agent believes, and all others react to it.

A driver follows the lane and the car ahead, and stops at lines. It believes the mission estimate of its agent: own
tracks and the picture. Without an attack it hits nothing. An adversary changes the picture on its way to the ego, or
what its driver tells the car.
"""

from baseline import scenario as baseline

from mast_zenoh.attacks import Attack
from mast_zenoh.driving import Driver
from mast_zenoh.study.defences import resolve_choice

#: The wires of attacks that are not on the picture.
WIRES = {"SeizedCommands": "command"}


def scenario(
    attack=None,
    attack_start_s=4.0,
    wire=None,
    estimate="mission",
    driver="FollowingDriver",
    scene="intersection",
    scene_index=None,
    n_infrastructure=None,
    n_mobile=None,
    cars=1,
):
    """The ego of a generated junction is driven.

    attack: class, such as "GhostAhead" or "SeizedCommands", FILE.py or FILE.py:CLASS, or a dict with one of these as
    `type`, and parameters; None: no adversary;
    attack_start_s: start of the attack, in scene time;
    wire: of the ego, on which the adversary is: picture, detections or command; None: picture, or what the attack
    needs;
    estimate: what the driver believes: mission, safety (own tracks alone) or truth;
    driver: the same of a driver, such as "FollowingDriver";
    cars: number of cars with drivers: the ego, mobile_1, mobile_2, …
    """
    if cars > 1:
        n_mobile = max(n_mobile or 0, cars - 1)
    one = dict(estimate=estimate, driver=resolve_choice(driver, Driver))
    driven = baseline(scene, scene_index, n_infrastructure, n_mobile) | dict(
        name="driving", drivers=dict(ego=one) | {f"mobile_{k}": one for k in range(1, cars)}
    )
    if attack is None:
        return driven
    attack = resolve_choice(attack, Attack)
    wire = wire or WIRES.get(attack["type"], "picture")
    return driven | dict(
        adversaries=dict(adversary_1=dict(type="Adversary", agent="ego", attack=dict(start_s=attack_start_s) | attack)),
        keyexpr=dict(map="testbed.toml", rewrites=["driving.toml", f"on_{wire}.toml"]),
    )
