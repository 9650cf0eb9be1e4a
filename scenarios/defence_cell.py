"""One cell of the study `defences`: a defence, an adversary, and where it sits."""

from defended import scenario as defended
from uncoordinated import scenario as uncoordinated

from mast_zenoh.attacks import Coordination
from mast_zenoh.scenario import agents_of
from mast_zenoh.study.choices import (
    COORDINATED,
    UNCOORDINATED,
    adversary_base,
    faults_of,
    has_budget,
    measured_by,
    place,
    resolve_choice,
)


def scenario(
    defence="NoIntegrity",
    attack=COORDINATED,
    knowledge="trust",
    wires=None,
    n_adversaries=2,
    placement="worst",
    budget=None,
    placement_seed=0,
    placement_frames=None,
    fault=None,
    n_faulty=1,
    metrics=(),
    attack_start_s=None,
    scene="intersection",
    scene_index=None,
    n_infrastructure=None,
    n_mobile=None,
):
    """As `defended`, and:

    defence, attack: class, FILE.py or FILE.py:CLASS, or a dict with one of these as `type`, and parameters; an attack
    may also be coordinated or uncoordinated, for the adversaries of these scenarios;
    knowledge: of the adversaries: own, picture or trust;
    wires: those of the adversaries; None: tracks and view, or what the attack needs;
    placement: of the adversaries: poles, random, or worst (the agents that cover the most objects);
    budget: lies per second of each adversary, for attacks that have one; None: the attack's own;
    placement_seed, placement_frames: the seed and the frames of the run, for the placement;
    fault: pose, delay, skew, loss, blind or ghosts, from attack_start_s on;
    n_faulty: number of agents with that fault, none of them with an adversary;
    metrics: of your own, each as an attack.
    """
    adversary = None
    start_s = 4.0 if attack_start_s is None else attack_start_s
    attack = attack if n_adversaries else UNCOORDINATED  # a coordinator would have nobody to direct
    if attack in (COORDINATED, UNCOORDINATED):
        knowledge, wires = "own", "tracks"
        if attack == UNCOORDINATED:
            adversary = uncoordinated(1, attack_start_s=start_s)["adversaries"]["adversary_1"]["attack"]
    else:
        base = adversary_base(attack)
        adversary = resolve_choice(attack, base)
        if budget is not None and has_budget(attack):
            # A coordination has one budget for all of its adversaries.
            adversary["budget"] = budget * (max(1, n_adversaries) if base is Coordination else 1)
    content = defended(
        defence=defence,
        attack=adversary,
        knowledge=knowledge,
        wires=wires if adversary else None,
        attack_start_s=attack_start_s,
        n_adversaries=n_adversaries,
        scene=scene,
        scene_index=scene_index,
        n_infrastructure=n_infrastructure,
        n_mobile=n_mobile,
    )
    where = (placement, placement_seed, placement_frames)
    victims = place(content["scene"], n_adversaries, *where)
    most = len(agents_of(content["scene"])) - 1
    compromised_or_faulty = min(most, n_adversaries + n_faulty) if fault else n_adversaries
    faulty = place(content["scene"], compromised_or_faulty, *where)[n_adversaries:]
    configs = content["adversaries"].items()
    return content | dict(
        name="defence_cell",
        adversaries={
            name: config | dict(agent=victim) for (name, config), victim in zip(configs, victims, strict=True)
        },
        faults=faults_of(fault, faulty, start_s),
        **measured_by(metrics, content),
    )
