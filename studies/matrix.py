"""Published and own defences against published and own attacks, by kind of scene."""

from mast_zenoh.study.choices import junctions, matrix_study, parse_choices, scenes_of_kinds, with_preset
from mast_zenoh.study.defences.field_matrix import FieldMatrix

# Stages of the command centre; those after published defences last.
DEFENCES = "KOfN,Plausibility,Mate,FreeSpace,SequentialConsistency,FaultOrLie,Robosac,Pasac,Made,Prbi,PoseGuard,Cad"
# Attacks of the original testbed, some that know how they are judged, and those after published attacks.
ADVERSARIES = (
    "coordinated,uncoordinated,BlindSpot,Mimic,SlowDrift,Sleeper,Collusion,Framing,GhostAhead,"
    "OpenDispute,PairedDenial,TrustFlip,PosePert,BlindAreaConfusion,PretendBenign,Flood"
)
# Those that hide or add objects all the time; others displace them, strike late or briefly, or lie as BlindSpot does.
COUNTED = (
    "coordinated,uncoordinated,BlindSpot,Mimic,Collusion,Framing,GhostAhead,OpenDispute,PairedDenial,TrustFlip,Flood"
)
# On two cores, quick takes a minute.
PRESETS = dict(
    quick=dict(
        defences="FaultOrLie,Cad", adversaries="coordinated,OpenDispute", kinds="poles,cars", counts=(2,), trials=2
    ),
    scoreboard=dict(defences=DEFENCES, adversaries=COUNTED, kinds="poles,cars", counts=(2,), trials=10),
    full=dict(defences=DEFENCES, adversaries=ADVERSARIES, kinds="poles,cars,many", counts=(2,), trials=30),
)


def study(
    preset="quick",
    defences=None,
    adversaries=None,
    kinds=None,
    junction=8,
    counts=None,
    placements="random",
    trials=None,
    frames=100,
    attack_start_s=3.0,
    seed=1000,
    metrics=None,
):
    """Paired runs: the same scenes and seeds for every cell.

    preset: quick (FaultOrLie and Cad; coordinated and OpenDispute; poles, cars), scoreboard (10 seeds) or full (all
    attacks, many agents, 30 seeds); it sets all that is None;
    defences, adversaries: names or files, separated by commas, as in the study defences;
    kinds: of the scene, separated by commas: poles, cars, many;
    junction: generated junction of all scenes; counts: numbers of adversaries, 2 or [1,2,3]; placements: random,
    worst, poles;
    trials: seeds of each scene; frames: of each run; seed: the first one;
    attack_start_s: when all attacks begin, also those with a start_s of their own;
    metrics: of your own, named as defences are.
    """
    chosen = with_preset(PRESETS, **locals())
    return dict(
        name="matrix",
        kind=FieldMatrix,
        **matrix_study(
            **{name: chosen[name] for name in ("defences", "adversaries", "counts", "placements")},
            budgets=[None],
            parameters=dict(
                knowledge="trust", attack_start_s=attack_start_s, metrics=parse_choices(metrics or "", "metrics")
            ),
        ),
        per_trial=dict(seed="placement_seed", frames="placement_frames"),
        scenes=scenes_of_kinds(chosen["kinds"], junctions(junction, junction)),
        trials=chosen["trials"],
        frames=frames,
        seed=seed,
    )
