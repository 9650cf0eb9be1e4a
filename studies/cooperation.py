"""Fusion in one centre, in two regional ones, and on board of every agent, under equal attacks."""

from mast_zenoh.study.choices import junctions, several, with_preset, words
from mast_zenoh.study.defences.cooperation import Cooperation

# On two cores: quick 3 minutes, full 45.
PRESETS = dict(
    quick=dict(agents=(5, 10), scenes=junctions(8, 9), trials=1),
    full=dict(agents=(5, 10, 20, 50), scenes=junctions(8, 9), trials=3),
)
#: Besides cars: the ego and four poles.
_OTHERS = 5
_SENT = {"keyexpr.rewrites": ["on_tracks.toml"]}
#: The scenario without lies, and the one with lies: names and parameters.
_ARCHITECTURES = dict(
    centre=(("baseline", {}), ("uncoordinated", _SENT)),
    regions=(("two_centres", {}), ("two_centres", {})),
    peers=(("peers", {}), ("peers", {})),
    radio=(("congested", {"background": 0}), ("congested", {"background": 0})),
)


def study(
    preset="full",
    agents=None,
    architectures="centre,regions,peers,radio",
    n_adversaries=1,
    scenes=None,
    trials=None,
    frames=100,
    attack_start_s=3.0,
    seed=3000,
):
    """Paired runs without and with lies of one or more poles, on what they send to all.

    preset: quick or full; it sets what is None;
    agents: numbers of agents: the ego, four poles, and cars with sensors;
    architectures: of the fusion: centre (one), regions (two, and a centre of centres), peers (every agent fuses all
    tracks in every frame), radio (peers with the standard's messages, rules and channel); the others are compared with
    the first;
    n_adversaries: poles that lie; scenes: short names, separated by commas: intersection:INDEX;
    trials: seeds of each scene; seed: the first one; frames: of each run; attack_start_s: when the lies begin.
    """
    chosen = with_preset(PRESETS, **locals())
    lies = dict(n_adversaries=n_adversaries, attack_start_s=attack_start_s)
    runs = {}
    for count in several(chosen["agents"]):
        for architecture in words(architectures):
            for attacked, (scenario, parameters) in enumerate(_ARCHITECTURES[architecture]):
                runs[f"{architecture} {count} agents{' attacked' if attacked else ''}"] = dict(
                    scenario=scenario,
                    parameters=dict(n_mobile=count - _OTHERS) | parameters | (lies if attacked else {}),
                    factors=dict(
                        architecture=architecture, agents=count, attacked=bool(attacked), attack_start_s=attack_start_s
                    ),
                )
    return dict(
        name="cooperation",
        kind=Cooperation,
        runs=runs,
        scenes=words(chosen["scenes"]),
        trials=chosen["trials"],
        frames=frames,
        seed=seed,
    )
