"""Adversaries between agents and the command centre, directed by a coordinator."""

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
    """Parameters as in `uncoordinated`, and:

    reselect_every_s: s, interval at which the coordinator selects new targets
    """
    attack = dict(
        type="CoordinatedAttack",
        start_s=attack_start_s,
        imitation=dict(type="Exact" if region == "paper" else "VictimLike"),
    )
    unattacked = baseline(scene, scene_index, n_infrastructure, n_mobile)
    return unattacked | dict(
        name="coordinated",
        adversaries={
            f"adversary_{i}": dict(type="Adversary", agent=agent, attack=attack)
            for i, agent in enumerate(victims_of(unattacked["scene"], n_adversaries, compromised), 1)
        },
        coordinator=dict(
            coordination=dict(
                type="Coordinator",
                start_s=attack_start_s,
                reselect_every_s=reselect_every_s,
                selection=dict(
                    type="CoordinatedSelection",
                    n_false_positives=false_positives,
                    exact_number=exact_number,
                    region=region,
                    fraction_false_negatives=fraction_false_negatives,
                    fraction_translations=fraction_translations,
                ),
                propagation=dict(type=propagation),
            )
        ),
        keyexpr=dict(map="testbed.toml", rewrites=["on_tracks.toml", "coordination.toml"]),
    )
