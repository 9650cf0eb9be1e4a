"""Adversaries against a command centre that judges agents and objects."""

from coordinated import scenario as coordinated

from mast_zenoh.attacks import Coordination
from mast_zenoh.config.registry import known_types, parameters_of
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.integrity import Integrity
from mast_zenoh.study.choices import adversary_base, resolve_choice

#: What the adversaries know besides their own wires, and the rewrites that let them hear it.
KNOWLEDGE = {
    "own": [],
    "picture": ["knowledge_picture.toml"],
    "trust": ["knowledge_picture.toml", "knowledge_trust.toml"],
}
#: Wires of attacks that are not on tracks and views.
WIRES = {"PoseDrift": "pose", "TrustFlip": "detections view"}


def scenario(
    defence="NoIntegrity",
    attack=None,
    knowledge="own",
    wires=None,
    attack_start_s=None,
    n_adversaries=2,
    compromised=(),
    scene="intersection",
    scene_index=None,
    n_infrastructure=None,
    n_mobile=None,
):
    """As `coordinated`, with an integrity stage.

    defence: class, such as "NoIntegrity", FILE.py or FILE.py:CLASS, or a dict with one of these as `type`, and
    parameters;
    attack: the same of an attack or of a coordination, such as "BlindSpot" or "Collusion"; None: that of
    `coordinated`, on tracks alone;
    knowledge: what its adversaries know: own (and each other's views with a coordination), picture (as well), or trust
    (white box: picture and trust); wires: those that they are on: detections, pose, tracks, view; None: tracks and
    view, or what the attack needs;
    attack_start_s: start of the attack, in scene time; None: 4 s, or as the class of `attack` says;
    n_adversaries: agents compromised, the ego included if it is;
    compromised: agents to compromise first, such as ["ego"] or ["infra_4", "infra_1"]; the others follow, poles first.
    """
    start_s = 4.0 if attack_start_s is None else attack_start_s
    attacked = coordinated(
        n_adversaries=n_adversaries,
        attack_start_s=start_s,
        compromised=compromised,
        scene=scene,
        scene_index=scene_index,
        n_infrastructure=n_infrastructure,
        n_mobile=n_mobile,
    )
    center = attacked["command_center"]
    stage = resolve_choice(defence, Integrity)
    heard = KNOWLEDGE.get(knowledge)
    if heard is None:
        raise ConfigurationError(f"knowledge: found {knowledge!r}{nearest(str(knowledge), KNOWLEDGE)}")
    if attack is None and wires not in (None, "tracks"):
        raise ConfigurationError(
            f"wires: found {wires!r}, expected none without `attack`: that of coordinated is on tracks"
        )
    rewrites = [*attacked["keyexpr"]["rewrites"], "views.toml"]
    if attack is not None:
        base = adversary_base(attack)
        attack = resolve_choice(attack, base)
        wires = wires or WIRES.get(attack["type"], "tracks view")
        directed = base is Coordination
        known = known_types(base).get(attack["type"])
        own_start = parameters_of(known).get("start_s") if known is not None else None
        if own_start is not None:
            has_default = attack_start_s is None and own_start.default is not own_start.empty
            attack = dict(start_s=own_start.default if has_default else start_s) | attack
        own = dict(type="CoordinatedAttack", start_s=attack.get("start_s", start_s)) if directed else attack
        attacked |= dict(
            adversaries={name: config | dict(attack=own) for name, config in attacked["adversaries"].items()},
            coordinator=dict(coordination=attack) if directed else None,
        )
        rewrites = [f"on_{wire}.toml" for wire in wires.split()] + ["coordination.toml"] * directed + ["views.toml"]
    return attacked | dict(
        name="defended",
        command_center=center | dict(pipeline=center["pipeline"] | dict(integrity=stage)),
        keyexpr=dict(map="testbed.toml", rewrites=[*rewrites, *heard]),
    )
