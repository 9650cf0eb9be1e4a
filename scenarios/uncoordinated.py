"""Adversaries without a common plan: each feeds the perception of one infrastructure agent with false detections."""

from baseline import scenario as baseline


def scenario(
    n_adversaries=2,
    false_positives=5.0,
    fraction_false_negatives=0.2,
    fraction_translations=0.0,
    attack_start_s=4.0,
    scene="intersection",
    scene_index=None,
    n_infrastructure=None,
    n_mobile=None,
):
    """n_adversaries: agents compromised; false_positives: mean number added by each (Poisson);

    fraction_…: of the agent's objects that vanish, or are moved; attack_start_s: when it begins, in scene time.
    """
    attack = dict(
        type="UncoordinatedAttack",
        start_s=attack_start_s,
        selection=dict(
            type="UncoordinatedSelection",
            n_false_positives=false_positives,
            fraction_false_negatives=fraction_false_negatives,
            fraction_translations=fraction_translations,
        ),
        propagation=dict(type="TrajectoryPropagation"),
    )
    return baseline(scene, scene_index, n_infrastructure, n_mobile) | dict(
        name="uncoordinated",
        adversaries={
            f"adversary_{i}": dict(type="Adversary", agent=f"infra_{i}", attack=attack)
            for i in range(1, n_adversaries + 1)
        },
        keyexpr=dict(map="testbed.toml", rewrites=["on_detections.toml"]),
    )
