"""The paper's Monte Carlo study: 1 to 3 adversaries, both attacks, many seeds."""

from mast_zenoh.study.choices import words

#: Launch-time parameters of both attacks, and of the coordinated one alone, in each reading of the paper.
READINGS = {
    "testbed": ({}, {}),
    "paper": ({"region": "paper", "propagation": "StaticPropagation"}, {"fraction_false_negatives": 0.0}),
}


def study(
    scenes="intersection:0,intersection:1,intersection:2",
    n_infrastructure=None,
    adversaries=(1, 2, 3),
    false_positives=5.0,
    exact_number=False,
    fraction_false_negatives=0.2,
    attack_start_s=4.0,
    reading="testbed",
    compromised=(),
    settings=None,
):
    """Runs for each number of adversaries.

    scenes: short names, separated by commas: intersection:INDEX, av2:PATH, …;
    adversaries: numbers of adversaries to compare;
    reading: "testbed", or "paper" for the attacks as in the paper: false objects stand still, without noise or misses;
    those of a coordinated attack are near any agent, and each adversary reports those within 70 m of its agent,
    and hides nothing;
    compromised: agents to compromise first, in this order;
    settings: dotted paths into the scenario and their values, for all runs: {"evaluator.scorer.range_m": 70}.
    """
    if reading not in READINGS:
        raise ValueError(f"reading: found {reading!r}, expected one of {', '.join(READINGS)}")
    attack = dict(
        n_infrastructure=n_infrastructure,
        false_positives=false_positives,
        exact_number=exact_number,
        fraction_false_negatives=fraction_false_negatives,
        attack_start_s=attack_start_s,
        compromised=compromised,
    )
    both, coordinated = READINGS[reading]
    settings = settings or {}
    attack |= both | settings
    grid = dict(n_adversaries=adversaries)
    return dict(
        name="monte_carlo",
        runs=dict(
            baseline=dict(scenario="baseline", parameters=dict(n_infrastructure=n_infrastructure) | settings),
            uncoordinated=dict(scenario="uncoordinated", parameters=attack, grid=grid),
            coordinated=dict(scenario="coordinated", parameters=attack | coordinated, grid=grid),
        ),
        baseline="baseline",
        scenes=words(scenes),
        trials=20,
        seed=0,
    )
