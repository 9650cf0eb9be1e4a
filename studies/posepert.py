"""A shared vehicle is perceived up to a metre aside: the closed loop of PosePert beside ours, and three defences.

Theirs is CARLA with trained networks, whose features are perturbed and amplified (beta 2); ours has tracks, whose
positions are changed, with a quarter of their covariance for the beta. Theirs forecasts 2 s by a network, and a vehicle
is in the lane if its centre is within 1.7 m; ours meets the cut-in with ProposalDriver (4 s at constant velocity), and
the leader with FollowingDriver without a margin (outlines that overlap its own: centres within 1.85 m).
"""

from mast_zenoh.integrity import Integrity
from mast_zenoh.study.choices import resolve_choice, with_preset, words
from mast_zenoh.study.defences.pose_perturbation import PosePerturbation

#: s of scene time at which the attack begins; frames for which it lasts, and m by which the shift grows in each. In a
#: cut-in, it begins after 0.8 s; behind a leader, 35 m before it (here 30 to 40 m), and 400 frames are to the end of
#: the run. Theirs chooses 0 to 0.5 m in each frame.
CASES = dict(
    cut_in=(2.8, ((5, 0.5), (5, 0.2), (40, 0.5))),
    leader=(2.75, ((40, 0.5), (400, 0.5))),
)
DRIVERS = dict(
    cut_in=dict(type="ProposalDriver"),
    leader=dict(type="FollowingDriver", margin_m=0.0, horizon_m=30.0),
)
#: Up to 1 m, of the one vehicle that the collaborator shares with the ego.
ATTACK = dict(type="PosePert", offset_m=1.0, budget=1.0)
#: Thresholds at which 5 % of 1,460 frames without an attack have an alarm about the vehicle, with seeds 101 to 110.
DEFENCES = dict(
    none=None,
    Cad=dict(type="Cad", threshold_m2=1.63),
    Made=dict(type="Made", alpha=0.088),
    PoseGuard=dict(type="PoseGuard", agree_m=0.45),
)
# On two cores: quick 1 minute, full half an hour at most.
PRESETS = dict(
    quick=dict(trials=2, defences="none,PoseGuard"),
    full=dict(trials=12, defences=",".join(DEFENCES)),
)


def study(preset="full", cases="cut_in,leader", defences="", covariance_factor=0.25, trials=None, frames=100, seed=0):
    """Attacks in pairs with their twins: the same roads and seeds for all.

    preset: quick or full; it sets all that is None or empty;
    cases: cut_in, leader; defences: none, Cad, Made, PoseGuard, each at 5 % false alarms, or classes or files;
    covariance_factor: by which the attacker multiplies the covariances of what it shifts;
    trials: number of roads, a seed each; seed: the first one; frames: of each run.
    """
    chosen = with_preset(PRESETS, **locals() | dict(defences=defences or None))
    runs = {}
    for case in words(cases):
        start_s, attacks = CASES[case]
        for name in words(chosen["defences"]):
            defence = DEFENCES[name] if name in DEFENCES else resolve_choice(name, Integrity)
            common = {"scene": f"road:{case}", "driver": DRIVERS[case]} | ({"defence": defence} if defence else {})
            common["agents.*.pipeline.mission"] = dict(type="PictureFirst")
            for length, step_m in ((0, 0.0), *attacks):
                attack = ATTACK | dict(
                    rise_s=0.1 / step_m if step_m else None,
                    covariance_factor=covariance_factor,
                    direction="toward" if case == "cut_in" else "away",
                    start_s=start_s,
                    end_s=start_s + 0.1 * length,
                )
                attacked = dict(attack=attack, wire="tracks", compromised=["mobile_1"])
                lasts = "to the end" if length == 400 else f"{length} frames"
                runs[f"{case}, {f'{lasts} {step_m:g} m' if length else 'no attack'}, {name}"] = dict(
                    scenario="driving",
                    parameters=common | (attacked if length else {}),
                    factors=dict(
                        case=case, frames=length, step_m=step_m, start_s=start_s, defence="" if name == "none" else name
                    ),
                )
    trials = chosen["trials"]
    return dict(name="posepert", kind=PosePerturbation, runs=runs, trials=trials, frames=frames, seed=seed)
