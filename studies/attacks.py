"""What each shipped attack adds to the errors of an undefended picture, each trial at a junction of its own."""

from mast_zenoh.study.choices import adversary_base, resolve_choice, short_name, words

#: Attacks on tracks, views, poses and detections, as the scenario `defended` has them.
ATTACKS = (
    "BlindSpot,OpenDispute,BlindAreaConfusion,PairedDenial,Collusion,GhostAhead,PhantomQueue,CutIn,LaneIntrusion,"
    "HideAhead,Mimic,Replay,Flood,Framing,TrustFlip,SlowDrift,PosePert,PoseDrift,StatePerturbation,Overconfidence,"
    "Sleeper,PretendBenign"
)
#: Those of the original testbed by what differs in their false objects, or in what they do besides.
SHAPES = {
    "ego_path": dict(region="ego_path"),
    "victim_only": dict(region="victim_only"),
    "outnumbered": dict(region="outnumbered"),
    "few_witnesses": dict(region="few_witnesses"),
    "many_witnesses": dict(region="many_witnesses"),
    "unseen_by_ego": dict(region="unseen_by_ego"),
    "standing": dict(propagation="StaticPropagation"),
    "wandering": dict(propagation="MarkovPropagation"),
    "only_false": dict(fraction_false_negatives=0.0),
    "only_hidden": dict(false_positives=0.0, fraction_false_negatives=0.5),
    "only_moved": dict(false_positives=0.0, fraction_false_negatives=0.0, fraction_translations=0.5),
}
#: Of both attacks as in the paper, and of the coordinated one alone.
PAPER = dict(region="paper", propagation="StaticPropagation")
PAPER_OF = dict(uncoordinated=PAPER, coordinated=PAPER | dict(fraction_false_negatives=0.0))


def study(attacks=None, shapes=None, paper=(1, 2, 3), adversaries=2, trials=30, frames=80, attack_start_s=2.0, seed=40):
    """Paired runs: the same junctions and seeds for every attack.

    attacks: classes, separated by commas; shapes: of uncoordinated attacks, names in this file; None: all of them;
    paper: numbers of adversaries of attacks as in the paper; adversaries: the number of all others, of poles first;
    trials: junctions, each with a seed of its own; seed: the first, number of the junction, too;
    frames: of each run; attack_start_s: when all attacks begin, also those with a start of their own
    """
    common = dict(attack_start_s=attack_start_s)
    both = common | dict(n_adversaries=adversaries)
    runs = dict(baseline=dict(scenario="baseline"))
    for scenario in ("uncoordinated", "coordinated"):
        runs[scenario] = dict(scenario=scenario, parameters=both)
        for count in paper:
            of_paper = common | dict(n_adversaries=count) | PAPER_OF[scenario]
            runs[f"{scenario} as in the paper, {count}"] = dict(scenario=scenario, parameters=of_paper)
    for scenario in ("hide_object", "downlink"):
        runs[scenario] = dict(scenario=scenario, parameters=common)
    for name in SHAPES if shapes is None else words(shapes):
        runs[f"uncoordinated {name}"] = dict(scenario="uncoordinated", parameters=both | SHAPES[name])
    for name in words(ATTACKS if attacks is None else attacks):
        attack = resolve_choice(name, adversary_base(name))
        parameters = both | dict(attack=attack, knowledge="trust")
        runs[short_name(name)] = dict(scenario="defended", parameters=parameters)
    return dict(
        name="attacks",
        runs=runs,
        per_trial=dict(seed="scene_index"),
        trials=trials,
        frames=frames,
        seed=seed,
    )
