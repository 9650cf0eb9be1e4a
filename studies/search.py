"""Attack parameters that harm most: searched on some seeds, measured on others."""

from mast_zenoh.study.choices import COORDINATED, UNCOORDINATED, words

# Of the scenario defence_cell: what is not chosen otherwise.
CELL = dict(attack="Collusion", defence="FaultOrLie", knowledge="trust", budget=2.0, placement="worst")

# What is searched of Collusion.
RANGES = "attack.speed_mps=0.0..15.0; attack.tolerance=0.01..0.3 log; attack.reselect_every_s=1.0..20.0 log"


def study(
    scenario="defence_cell",
    attack=None,
    defence=None,
    knowledge=None,
    budget=None,
    placement=None,
    n_adversaries=2,
    parameters=None,
    ranges=None,
    objective="fn + fp",
    direction="maximise",
    candidates=40,
    batch=8,
    seeds=3,
    sampler="TPE",
    scenes="intersection:8,intersection:9",
    trials=20,
    frames=130,
    seed=0,
):
    """No attack, an attack with its own parameters, and with those that a search finds.

    scenario: defence_cell, or another one that has n_adversaries; the next five are parameters of defence_cell;
    attack: a class, or a dict with parameters; None: Collusion; defence: its class, or a dict; None: FaultOrLie;
    knowledge: what adversaries hear; None: trust (white box); budget: lies per second of each; None: 2;
    placement: which agents are compromised; None: worst, those that cover the most objects;
    n_adversaries: agents compromised; parameters: others of the scenario, as a dict;
    ranges: NAME=LOW..HIGH, NAME=LOW..HIGH log or NAME=A|B, separated by semicolons; attack.NAME is one of the attack's;
    None: speed, tolerance and pauses of Collusion;
    objective: METRIC, ESTIMATOR/METRIC, WHO/ESTIMATOR/METRIC, or a sum; direction: maximise or minimise;
    candidates: how many are tried; batch: how many at once; sampler: TPE or random;
    seeds: of the search, in each scene; trials: seeds held out; seed: the first one of the search;
    scenes: short names, separated by commas; frames: of each run.
    """
    is_cell = scenario == "defence_cell"
    chosen = dict(attack=attack, defence=defence, knowledge=knowledge, budget=budget, placement=placement)
    common = (CELL if is_cell else {}) | {key: value for key, value in chosen.items() if value is not None}
    common |= parameters or {}
    if isinstance(common.get("attack"), str) and common["attack"] not in (COORDINATED, UNCOORDINATED):
        common["attack"] = dict(type=common["attack"])
    return dict(
        name="search",
        runs=dict(
            unattacked=dict(scenario=scenario, parameters=common | dict(n_adversaries=0)),
            attacked=dict(scenario=scenario, parameters=common | dict(n_adversaries=n_adversaries)),
        ),
        baseline="unattacked",
        search=dict(
            run="attacked",
            parameters=RANGES if ranges is None else ranges,
            objective=objective,
            direction=direction,
            candidates=candidates,
            batch=batch,
            seeds=seeds,
            sampler=sampler,
        ),
        per_trial=dict(seed="placement_seed", frames="placement_frames") if is_cell else {},
        scenes=words(scenes),
        trials=trials,
        frames=frames,
        seed=seed,
    )
