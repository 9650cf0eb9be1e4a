"""The paper's Monte Carlo study: 1 to 3 adversaries, both attacks, many seeds."""


def study(
    scenes="intersection:0,intersection:1,intersection:2",
    n_infrastructure=None,
    adversaries=(1, 2, 3),
    false_positives=5.0,
    fraction_false_negatives=0.2,
    attack_start_s=4.0,
):
    """Runs for each number of adversaries.

    scenes: short names, separated by commas: intersection:INDEX, av2:PATH, …;
    adversaries: numbers of adversaries to compare.
    """
    attack = dict(
        n_infrastructure=n_infrastructure,
        false_positives=false_positives,
        fraction_false_negatives=fraction_false_negatives,
        attack_start_s=attack_start_s,
    )
    grid = dict(n_adversaries=adversaries)
    return dict(
        name="monte_carlo",
        runs=dict(
            baseline=dict(scenario="baseline", parameters=dict(n_infrastructure=n_infrastructure)),
            uncoordinated=dict(scenario="uncoordinated", parameters=attack, grid=grid),
            coordinated=dict(scenario="coordinated", parameters=attack, grid=grid),
        ),
        baseline="baseline",
        scenes=[scene.strip() for scene in scenes.split(",")],
        trials=20,
        seed=0,
    )
