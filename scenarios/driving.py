"""Cars that react: the ego drives by what its agent believes, and all others react to it.

A driver follows the lane and the car ahead, and stops at lines. It believes the mission estimate of its agent: own
tracks and the picture. Without an attack it hits nothing. An adversary changes the picture on its way to the ego, what
agents tell the command centre, what the ego's sensors detect, or what its driver tells the car.
"""

from baseline import scenario as baseline

from mast_zenoh.attacks import Attack
from mast_zenoh.driving import Driver
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.integrity import Integrity
from mast_zenoh.scenario import choose_scene, victims_of
from mast_zenoh.study.choices import measured_by, resolve_choice

#: Attacks by name, each with the wires on which it is by default, see `wire`.
ATTACKS = {
    "ghost_ahead": (dict(type="GhostAhead"), "picture"),
    "phantom_queue": (dict(type="PhantomQueue"), "picture"),
    "cut_in": (dict(type="CutIn"), "picture"),
    "intruder": (dict(type="LaneIntrusion", into="ego"), "picture"),
    "displaced_leader": (dict(type="LaneIntrusion", into="neighbour"), "detections picture"),
    "hidden_leader": (dict(type="HideAhead", what="lane"), "detections picture"),
    "hidden_crosser": (dict(type="HideAhead", what="crossing"), "detections picture"),
    # The picture as it was: 1000 lies per second are all of its objects.
    "stale_picture": (dict(type="Replay", delay_s=2.0, budget=1000.0), "picture"),
}
#: The wires of other attacks that are not on the picture.
WIRES = {"SeizedCommands": "command"}
#: The key of each wire of the ego.
KEYS = {"picture": "cc/picture", "detections": "agent/ego/detections", "command": "agent/ego/command"}


def scenario(
    attack=None,
    attack_start_s=None,
    wire=None,
    n_adversaries=None,
    compromised=(),
    defence=None,
    veto=False,
    estimate="mission",
    driver="FollowingDriver",
    scene="intersection",
    scene_index=None,
    n_infrastructure=None,
    n_mobile=None,
    n_vehicles=None,
    n_bicycles=None,
    n_pedestrians=None,
    cars=1,
    metrics=(),
):
    """The ego of a generated junction is driven.

    attack: ghost_ahead, phantom_queue, cut_in, intruder, displaced_leader, hidden_leader, hidden_crosser or
    stale_picture; a class, such as "SeizedCommands", FILE.py or FILE.py:CLASS; or a dict with one of these as `type`,
    and parameters; None: no adversary;
    attack_start_s: start of the attack, in scene time; None: as its class says, 4 s for those that come with mast;
    wire: where the adversary is: picture, detections or command of the ego, "detections picture" for both; or tracks:
    n_adversaries other agents lie to the command centre, those of `compromised` first, then poles; None: picture, or
    what the attack needs; n_adversaries: None: as many as are named, or two;
    defence: of the command centre, such as "FaultOrLie", FILE.py or FILE.py:CLASS, or a dict; None: none;
    veto: whether the driver's own sensors overrule the mission estimate;
    estimate: what the driver believes: mission, safety (own tracks alone) or truth;
    driver: the same of a driver, such as "FollowingDriver";
    n_vehicles, n_bicycles, n_pedestrians: of the junction; None: as many as it usually has;
    cars: number of cars with drivers: the ego, mobile_1, mobile_2, …;
    metrics: of your own, each a class, FILE.py or FILE.py:CLASS, or a dict.
    """
    if cars < 1:
        raise ConfigurationError(f"cars: found {cars}, expected 1 or more")
    if cars > 1:
        n_mobile = max(n_mobile or 0, cars - 1)
    scene = choose_scene(scene, n_vehicles=n_vehicles, n_bicycles=n_bicycles, n_pedestrians=n_pedestrians)
    content = baseline(scene, scene_index, n_infrastructure, n_mobile)
    one = dict(estimate=estimate, driver=resolve_choice(driver, Driver)) | ({"veto": True} if veto else {})
    content |= dict(name="driving", drivers=dict(ego=one) | {f"mobile_{k}": one for k in range(1, cars)})
    rewrites = []
    if attack is not None:
        attack, usual = ATTACKS.get(attack, (attack, None)) if isinstance(attack, str) else (attack, None)
        attack = resolve_choice(attack, Attack)
        attack = ({} if attack_start_s is None else dict(start_s=attack_start_s)) | attack
        wire = wire or usual or WIRES.get(attack["type"], "picture")
        if wire == "tracks":
            count = (len(compromised) or 2) if n_adversaries is None else n_adversaries
            if count < len(compromised):
                raise ConfigurationError(
                    f"n_adversaries: found {count}, expected {len(compromised)}, as in `compromised`"
                )
            victims, inserts = victims_of(content["scene"], count, compromised), ["on_tracks.toml"]
        else:
            refuse_unused(f"wire=tracks, not {wire}", n_adversaries=n_adversaries, compromised=compromised)
            inserts = [on_wire(name, f"adversary_{number}") for number, name in enumerate(wire.split(), 1)]
            victims = ["ego"] * len(inserts)
        rewrites = ["driving.toml", *inserts]
        content |= dict(
            adversaries={
                f"adversary_{number}": dict(type="Adversary", agent=victim, attack=attack)
                for number, victim in enumerate(victims, 1)
            }
        )
    else:
        refuse_unused("an attack", wire=wire, n_adversaries=n_adversaries, compromised=compromised)
    if defence is not None:
        center = content["command_center"]
        stage = dict(integrity=resolve_choice(defence, Integrity))
        content |= dict(command_center=center | dict(pipeline=center["pipeline"] | stage))
        rewrites = [*(rewrites or ["driving.toml"]), "views.toml"]
    content |= measured_by(metrics, content)
    return content | dict(keyexpr=dict(map="testbed.toml", rewrites=rewrites))


def refuse_unused(needed, **parameters):
    """Raise ConfigurationError for parameters that have no effect."""
    for name, value in parameters.items():
        if value is not None and value != ():
            raise ConfigurationError(f"{name}: found {value!r}, expected nothing: it needs {needed}")


def on_wire(name, adversary):
    """What puts one adversary of the ego on one of its wires: each wire has an adversary of its own."""
    if name not in KEYS:
        raise ConfigurationError(f"wire: found {name!r}, expected tracks alone, or one or more of {', '.join(KEYS)}")
    to = dict(to="agent") if name == "picture" else {}
    insert = dict(wire=KEYS[name], role="adversary", node=adversary, input=name, output=f"{name}_out")
    return dict(insert=[insert | to])
