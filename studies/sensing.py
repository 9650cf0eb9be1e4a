"""How far attacks on a lidar get: points landed, detected, tracked, fused, and the brake of a driven car.

The spoofer is on a car ahead of the ego, which keeps its distance. The detector finds clusters: curves of trained
networks are beside ours in docs/explanation-points.md.
"""

from itertools import product

from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.sensing import PointCheck
from mast_zenoh.study.choices import junctions, parse_choices, resolve_choice, short_name, with_preset, words
from mast_zenoh.study.defences.spoofed_sensing import SpoofedSensing

#: m, of what is inserted from the lidar.
DISTANCES_M = (8.0, 15.0)
#: By attack: its parameters, what a budget sets, three budgets with their unit, and the distances that it may have.
ATTACKS = dict(
    injection=(dict(type="InjectedPoints"), "points", (20, 60, 200), "points", DISTANCES_M),
    wall=(dict(type="GhostWall"), "points", (500, 1500, 4200), "points", DISTANCES_M),
    removal=(dict(type="HighFrequencyRemoval"), "sector_deg", (10.0, 20.0, 40.0), "deg", ()),
    early_echo=(dict(type="EarlyEcho"), "sector_deg", (10.0, 30.0, 60.0), "deg", ()),
)
_ALL, _CHECKS = ",".join(ATTACKS), "none,OcclusionCheck,ShadowCheck,TemporalCheck"
# On two cores: quick 3 minutes, hour one, full a night.
PRESETS = dict(
    quick=dict(
        attacks="injection", budgets=1, distances=1, checks="none,OcclusionCheck", scenes="intersection:6", trials=2
    ),
    hour=dict(attacks=_ALL, budgets=3, distances=1, checks="none,OcclusionCheck", scenes=junctions(6, 7), trials=5),
    full=dict(attacks=_ALL, budgets=3, distances=2, checks=_CHECKS, scenes=junctions(6, 10), trials=10),
)


def study(
    preset="hour",
    attacks=None,
    budgets=None,
    distances=None,
    checks="",
    scenes=None,
    trials=None,
    start_s=4.0,
    lidar="VLP-32C",
    frames=100,
    seed=0,
):
    """Attacks in pairs with their twins: the same junctions and seeds for all.

    preset: quick, hour or full; it sets all that is None or empty;
    attacks: injection, wall, removal, early_echo; budgets: how many of the values of each, the largest first;
    distances: how many of the two, the nearest first;
    checks: of detections: none, OcclusionCheck, ShadowCheck, TemporalCheck, or classes or files of yours;
    scenes: separated by commas; trials: seeds; start_s: s of scene time of the attack; lidar: a model;
    frames: of each run; seed: the first one.
    """
    chosen = with_preset(PRESETS, **locals() | dict(checks=checks or None))
    runs = {}
    for check in parse_choices(chosen["checks"], "checks"):
        refused = [] if check == "none" else [resolve_choice(check, PointCheck)]
        name = "" if check == "none" else short_name(check)
        common = {"lidar": lidar, "checks": refused, "points.recorded": False}  # effects are in tables
        factors = dict(check=name, start_s=start_s)
        runs[f"no attack, {name or 'none'}"] = dict(
            scenario="spoofed",
            parameters=common | dict(attack="none"),
            factors=factors | dict(attack="", budget="", distance=""),
        )
        for attack in words(chosen["attacks"]):
            if attack not in ATTACKS:
                raise ConfigurationError(f"attacks: found {attack!r}{nearest(attack, ATTACKS)}")
            spec, parameter, values, unit, distances = ATTACKS[attack]
            places = [(f"{each:g} m", dict(distance_m=each)) for each in distances[: chosen["distances"]]]
            for budget, (distance, place) in product(values[-chosen["budgets"] :], places or [("", {})]):
                of = dict(attack=attack, budget=f"{budget:g} {unit}", distance=distance)
                runs[", ".join(filter(None, (*of.values(), name or "none")))] = dict(
                    scenario="spoofed",
                    parameters=common | dict(attack=spec | {parameter: budget, "start_s": start_s} | place),
                    factors=factors | of,
                )
    return dict(
        name="sensing",
        kind=SpoofedSensing,
        runs=runs,
        scenes=words(chosen["scenes"]),
        trials=chosen["trials"],
        frames=frames,
        seed=seed,
    )
