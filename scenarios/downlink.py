"""An adversary between command centre and ego: only the ego gets a false picture.

False objects stand or drive in the ego's lane, ahead of it. The command centre and all other agents see none of them.
"""

from baseline import scenario as baseline


def scenario(
    false_positives=2.0,
    fraction_false_negatives=0.2,
    fraction_translations=0.0,
    region="ego_path",
    attack_start_s=4.0,
    reselect_every_s=5.0,
    scene="intersection",
    scene_index=None,
    n_infrastructure=None,
    n_mobile=None,
):
    """As `uncoordinated`, on the ego's picture.

    An object that the ego sees itself stays in its mission estimate.
    """
    return baseline(scene, scene_index, n_infrastructure, n_mobile) | dict(
        name="downlink",
        adversaries=dict(
            adversary_1=dict(
                type="Adversary",
                agent="ego",
                attack=dict(
                    type="UncoordinatedAttack",
                    start_s=attack_start_s,
                    reselect_every_s=reselect_every_s,
                    selection=dict(
                        type="UncoordinatedSelection",
                        n_false_positives=false_positives,
                        fraction_false_negatives=fraction_false_negatives,
                        fraction_translations=fraction_translations,
                        region=region,
                    ),
                    propagation=dict(type="TrajectoryPropagation", duration_s=reselect_every_s or 10.0),
                ),
            )
        ),
        keyexpr=dict(map="testbed.toml", rewrites=["on_picture.toml"]),
    )
