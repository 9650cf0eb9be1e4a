"""How long a displaced object stays unnoticed, next to the least delay that is possible."""

from mast_zenoh.study.choices import junctions, sensors_of, several, with_preset, words
from mast_zenoh.study.defences.drift import Drift

# On two cores: quick 3 minutes, full 20.
PRESETS = dict(
    quick=dict(scenes=junctions(8, 9), trials=2),
    full=dict(scenes=junctions(8, 15), trials=4),
)
#: m/s of an offset that is there at once: more than the largest offset within a frame.
AT_ONCE_MPS = 1000.0


def study(
    preset="full",
    agents=(5, 3),
    offsets_m=(0.3, 0.5, 1.0),
    rates_mps=(0.05, 0.1, 0.2),
    limit_m=2.0,
    defence="FaultOrLie",
    scenes=None,
    trials=None,
    frames=260,
    attack_start_s=4.0,
    seed=0,
):
    """One liar among all agents moves one object at a time.

    preset: quick or full; it sets scenes and trials that are None;
    agents: numbers of agents, the ego included. With three, an object that everybody sees has two honest viewers;
    offsets_m: constant offsets, there at once; rates_mps: m/s of offsets that grow;
    limit_m: m, up to which they grow;
    defence: an integrity stage;
    scenes: short names, separated by commas: intersection:INDEX; trials: seeds of each scene; seed: the first one;
    frames: of each run, long enough to watch what nobody notices at first.
    """
    chosen = with_preset(PRESETS, **locals())
    lies = [(offset, None) for offset in several(offsets_m)] + [(limit_m, rate) for rate in several(rates_mps)]
    common = dict(
        defence=defence,
        n_adversaries=1,
        placement="random",
        # An attacker that hears of the trust in it would go back: here, what it does must not depend on the defence.
        knowledge="own",
        attack_start_s=attack_start_s,
    )
    runs = {}
    for count in several(agents):
        for offset_m, rate_mps in lies:
            lie = f"offset {offset_m:g} m" if rate_mps is None else f"drift {rate_mps:g} mps"
            # One lie per second: one object at a time.
            rate = AT_ONCE_MPS if rate_mps is None else rate_mps
            attack = dict(type="SlowDrift", rate_mps=rate, limit_m=offset_m, budget=1.0)
            runs[f"{count} agents {lie}"] = dict(
                scenario="defence_cell",
                parameters=common | sensors_of(count) | dict(attack=attack),
                factors=dict(offset_m=offset_m, rate_mps=rate_mps, agents=count),
            )
    return dict(
        name="drift",
        kind=Drift,
        runs=runs,
        per_trial=dict(seed="placement_seed", frames="placement_frames"),
        scenes=words(chosen["scenes"]),
        trials=chosen["trials"],
        frames=frames,
        seed=seed,
    )
