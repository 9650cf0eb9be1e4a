"""Every defence against every adversary, with 0 to n - 1 adversaries."""

from mast_zenoh.study.choices import junctions, matrix_study, parse_choices, with_preset, words
from mast_zenoh.study.defences.matrix import DefenceMatrix

# Adversaries that know the defence.
ADAPTIVE = "BlindSpot,Mimic,SlowDrift,Sleeper,Collusion,Framing,Replay,GhostAhead,StatePerturbation,PoseDrift"

# docs/explanation-defences.md#run-the-studies says what each one is for, and how long it takes.
# What the presets after full have, unless they say otherwise.
ONE = dict(
    defences="FaultOrLie",
    counts=(1, 2),
    placements="random,worst",
    budgets=(1.0, 4.0),
    scenes=junctions(8, 15),
    trials=3,
    frames=150,
)
FAULTS = "fault:pose,fault:delay,fault:skew,fault:loss,fault:blind,fault:ghosts"
PRESETS = dict(
    quick=dict(
        defences="NoIntegrity,KOfN,Mate,FaultOrLie",
        adversaries="coordinated,BlindSpot,Collusion,fault:pose",
        counts=(1, 2),
        placements="worst",
        budgets=(2.0,),
        scenes=junctions(4, 4),
        trials=2,
        frames=100,
    ),
    full=dict(
        defences="NoIntegrity,KOfN,Plausibility,Mate,FreeSpace,RobustFusion,SequentialConsistency,TruthDiscovery,FaultOrLie,"
        "Robosac,Pasac,Made,Prbi,PoseGuard,Cad",
        adversaries=f"coordinated,{ADAPTIVE},{FAULTS}",
        counts=(1, 2, 3, 4),
        placements="random,worst",
        budgets=(1.0, 4.0),
        scenes=junctions(4, 8),
        trials=5,
        frames=150,
    ),
    today=ONE | dict(adversaries="coordinated,uncoordinated", placements="poles,random"),
    alarms=ONE | dict(adversaries="", placements="random", scenes=junctions(8, 27), trials=9, frames=600),
    faults=ONE | dict(adversaries=FAULTS, counts=(1,), placements="random", trials=9, frames=300),
    framing=ONE | dict(adversaries="Framing", budgets=(4.0,), trials=9),
    adaptive=ONE | dict(adversaries=ADAPTIVE),
)


def study(
    preset="quick",
    defences=None,
    adversaries=None,
    counts=None,
    placements=None,
    budgets=None,
    scenes=None,
    trials=None,
    frames=None,
    knowledge="trust",
    fault=None,
    n_infrastructure=None,
    n_mobile=None,
    attack_start_s=4.0,
    seed=0,
    metrics=None,
):
    """Paired runs: the same scenes and seeds for every cell.

    preset: quick, full, today, alarms, faults, framing or adaptive; it sets all that is None;
    defences, adversaries: names or files (my_defence.py, my_attack.py:MyAttack), separated by commas, or a list of
    these and of dicts with parameters; counts: numbers of adversaries; placements: random, worst, poles;
    budgets: lies per second of each adversary: a cell counts with the one that does the most damage;
    scenes: short names, separated by commas: intersection:INDEX, av2:PATH, …;
    trials: seeds of each scene; frames: of each run; seed: the first one;
    knowledge: of the adversaries (own, picture, trust);
    attack_start_s: when all attacks begin, also those with a start_s of their own;
    fault: of one agent without an adversary, in all runs (pose, delay, skew, loss, blind, ghosts). In the list of
    adversaries, fault:pose stands for as many faulty agents and no liars;
    metrics: of your own, named as defences are.
    """
    chosen = with_preset(PRESETS, **locals())
    return dict(
        name="defences",
        kind=DefenceMatrix,
        **matrix_study(
            **{name: chosen[name] for name in ("defences", "adversaries", "counts", "placements", "budgets")},
            parameters=dict(
                knowledge=knowledge,
                fault=fault,
                n_infrastructure=n_infrastructure,
                n_mobile=n_mobile,
                attack_start_s=attack_start_s,
                metrics=parse_choices(metrics or "", "metrics"),
            ),
        ),
        per_trial=dict(seed="placement_seed", frames="placement_frames"),
        scenes=words(chosen["scenes"]),
        trials=chosen["trials"],
        frames=chosen["frames"],
        seed=seed,
    )
