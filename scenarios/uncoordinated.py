"""Adversaries without a common plan, each with false detections for one agent."""

from baseline import scenario as baseline

from mast_zenoh.scenario import victims_of


def scenario(
    n_adversaries=2,
    false_positives=5.0,
    exact_number=False,
    fraction_false_negatives=0.2,
    fraction_translations=0.0,
    region="in_view",
    propagation="TrajectoryPropagation",
    compromised=(),
    attack_start_s=4.0,
    reselect_every_s=20.0,
    scene="intersection",
    scene_index=None,
    n_infrastructure=None,
    n_mobile=None,
):
    """A baseline run with independent adversaries.

    n_adversaries: agents compromised; false_positives: mean number added by each (Poisson);
    exact_number: whether that number is not drawn, but is `false_positives`, rounded;
    fraction_…: fraction of the agent's objects that are hidden, or moved;
    region: where false objects are put: in_view, ego_path, victim_only, or paper (about the agent, never missed);
    propagation: class that moves false objects, such as StaticPropagation;
    compromised: agents to compromise first, such as ["infra_4", "infra_1"]; the others follow, poles first;
    attack_start_s: start of the attack, in scene time; reselect_every_s: interval at which each chooses new targets.
    """
    attack = dict(
        type="UncoordinatedAttack",
        start_s=attack_start_s,
        reselect_every_s=reselect_every_s,
        imitation=dict(type="Exact" if region == "paper" else "VictimLike"),
        selection=dict(
            type="UncoordinatedSelection",
            n_false_positives=false_positives,
            exact_number=exact_number,
            region=region,
            fraction_false_negatives=fraction_false_negatives,
            fraction_translations=fraction_translations,
        ),
        propagation=dict(type=propagation),
    )
    unattacked = baseline(scene, scene_index, n_infrastructure, n_mobile)
    return unattacked | dict(
        name="uncoordinated",
        adversaries={
            f"adversary_{i}": dict(type="Adversary", agent=agent, attack=attack)
            for i, agent in enumerate(victims_of(unattacked["scene"], n_adversaries, compromised), 1)
        },
        keyexpr=dict(map="testbed.toml", rewrites=["on_detections.toml"]),
    )
