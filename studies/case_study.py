"""The paper's case study: no, uncoordinated and coordinated attack on one scene."""

#: The generated junction that is played if none is named: its ego drives on if nothing is in its way.
JUNCTION = 4


def study(
    scene="intersection",
    scene_index=None,
    n_infrastructure=None,
    n_adversaries=2,
    false_positives=5.0,
    fraction_false_negatives=0.2,
):
    """Two of four infrastructure agents are compromised.

    They add five false objects on average, and hide a fifth of the real ones. Then one more run, in which a driver
    steers the ego and somebody puts ghosts into the picture that it receives: what an attack does to a car.
    """
    if scene == "intersection" and scene_index is None:
        scene_index = JUNCTION
    place = dict(scene=scene, scene_index=scene_index, n_infrastructure=n_infrastructure)
    attack = dict(
        n_adversaries=n_adversaries,
        false_positives=false_positives,
        fraction_false_negatives=fraction_false_negatives,
    )
    steps = str(scene).partition(":")[0] == "intersection"  # of other scenes, cars are recorded
    return dict(
        name="case_study",
        runs=dict(
            baseline=dict(scenario="baseline", parameters=place),
            uncoordinated=dict(scenario="uncoordinated", parameters=place | attack),
            coordinated=dict(scenario="coordinated", parameters=place | attack),
        ),
        driven=dict(scenario="driving", parameters=place | dict(attack="GhostAhead"), frames=100) if steps else None,
        runtime="mesh",
        seed=0,
    )
