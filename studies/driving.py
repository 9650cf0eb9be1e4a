"""What attacks do to a driven car, and what a defence or its own sensors spare it."""

from mast_zenoh.config import plugins, registry
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.integrity import Integrity
from mast_zenoh.study.choices import parse_choices, several, with_preset, words
from mast_zenoh.study.defences.driving_matrix import DrivingMatrix

#: Attacks of the scenario `driving`, each with where it is (`wire`): on what the ego receives, on what two poles send,
#: or on what the ego receives and what its own sensors detect.
ATTACKS = (
    "ghost_ahead@picture",
    "phantom_queue@picture",
    "phantom_queue@tracks",
    "cut_in@picture",
    "cut_in@tracks",
    "intruder@picture",
    "stale_picture@picture",
    "displaced_leader@detections+picture",
    "hidden_leader@detections+picture",
)
#: Parameters of each defence.
DEFENCES = {"none": {}, "FaultOrLie": dict(defence="FaultOrLie"), "veto": dict(veto=True)}
#: A driver with the constants of PDM-Closed (Dauner et al., 2023), not those of 2000: it keeps up with the traffic, so
#: that it has to brake for others.
DRIVER = dict(
    type="FollowingDriver",
    following=dict(type="IntelligentDriverModel", acceleration=1.5, braking=3.0, headway_s=1.5, gap_m=1.0),
)
#: The first 30 generated junctions from 4 on (thresholds were calibrated on 0 to 3) at which the ego, driven by DRIVER
#: on the truth and without attack (seed 0, 15 s), has something within 30 m ahead of it in its lane for a fifth of the
#: time. One seed of each, so that pairs are independent of each other.
JUNCTIONS = (5, 8, 13, 14, 15, 16, 17, 19, 20, 21, 22, 27, 29, 30, 33, 34, 36, 37, 38, 39)
JUNCTIONS += (40, 43, 44, 45, 46, 49, 50, 53, 54, 57)
# On two cores, quick takes a minute or two and full 25 minutes.
PRESETS = dict(
    quick=dict(attacks="phantom_queue@picture,phantom_queue@tracks", scenes="intersection:6,intersection:13", trials=1),
    full=dict(attacks=ATTACKS, scenes=",".join(f"intersection:{index}" for index in JUNCTIONS), trials=1),
)


def study(
    preset="full",
    attacks=None,
    defences="none,FaultOrLie,veto",
    scenes=None,
    trials=None,
    frames=150,
    attack_start_s=2.0,
    driver=None,
    seed=0,
    metrics=None,
):
    """Attacks against defences, in pairs: the same scenes and seeds for all.

    preset: quick or full; it sets all that is None;
    attacks: NAME@WIRE, separated by commas: names, or classes, and wires of the scenario `driving`, such as
    GhostAhead@picture, or hidden_leader@detections+picture; a name alone, such as phantom_queue: on its first wire in
    the preset full;
    defences: none, FaultOrLie and veto (own sensors), or classes or files of defences of the command centre;
    scenes: short names, separated by commas, such as intersection:6; trials: seeds of each scene; seed: the first one;
    frames: of each run; attack_start_s: when all attacks begin; driver: of the ego, None: FollowingDriver with the
    constants of PDM-Closed; metrics: of your own, separated by commas: classes or files.
    """
    chosen = with_preset(PRESETS, **locals())
    common = dict(
        driver=DRIVER if driver is None else driver,
        attack_start_s=attack_start_s,
        metrics=parse_choices(metrics or "", "metrics"),
    )
    runs = {}
    for name in words(defences):
        defended, defence = parameters_of(name), "" if name == "none" else name
        for attack, wire in [("", ""), *map(attack_and_wire, several(words(chosen["attacks"])))]:
            attacked = dict(attack=attack, wire=wire) if attack else {}
            title = f"{attack} on {wire}" if attack else "no attack"
            runs[f"{title}, {defence or 'no defence'}"] = dict(
                scenario="driving",
                parameters=common | defended | attacked,
                factors=dict(attack=attack, wire=wire, defence=defence, car="ego"),
            )
    return dict(
        name="driving",
        kind=DrivingMatrix,
        runs=runs,
        scenes=words(chosen["scenes"]),
        trials=chosen["trials"],
        frames=frames,
        seed=seed,
    )


def parameters_of(defence):
    """The parameters of the scenario `driving` for a defence."""
    known = {**DEFENCES, **registry.known_types(Integrity, defence)}
    if defence not in known and not defence.partition(":")[0].endswith(".py"):
        raise plugins.not_found(f"defences: no defence {defence!r}", defence, known)
    return DEFENCES.get(defence, dict(defence=defence))


def attack_and_wire(text):
    """The attack and the wire of NAME@WIRE, or of NAME, with the first wire in ATTACKS."""
    text = next((entry for entry in ATTACKS if entry.startswith(f"{text}@")), text)
    attack, at, wire = text.rpartition("@")
    if not at or not attack:
        raise ConfigurationError(f"attacks: found {text!r}, expected NAME@WIRE{nearest(text, ATTACKS)}")
    return attack, wire.replace("+", " ")
