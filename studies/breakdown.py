"""With how many liars a defence breaks, next to the share at which honest viewers lose their majority."""

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.study.choices import junctions, parse_choices, sensors_of, several, short_name, with_preset, words
from mast_zenoh.study.defences.breakdown import Breakdown

# On two cores: quick 2 minutes, full 25.
PRESETS = dict(
    quick=dict(
        agents=(5, 13),
        shares=(0.0, 0.2, 0.4, 0.6),
        scenes=junctions(8, 9),
        trials=1,
        frames=100,
    ),
    full=dict(
        agents=(5, 13, 21),
        # Close together around one half, where a majority is lost.
        shares=(0.0, 0.1, 0.25, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.8),
        scenes=junctions(8, 12),
        trials=2,
        frames=130,
    ),
)


def study(
    preset="full",
    agents=None,
    shares=None,
    adversaries="coordinated,Collusion",
    budget=2.0,
    defence="FaultOrLie",
    scenes=None,
    trials=None,
    frames=None,
    attack_start_s=4.0,
    seed=0,
):
    """Random placements of 0 to n - 1 liars among n agents, never the ego.

    preset: quick or full; it sets all that is None;
    agents: numbers of agents, the ego included: poles, and above five agents cars, too;
    shares: of liars among all agents, rounded to whole agents;
    adversaries: attacks or coordinations, separated by commas;
    budget: lies per second of each liar, for attacks that have one;
    defence: an integrity stage;
    scenes: short names, separated by commas: intersection:INDEX; trials: seeds of each scene; seed: the first one;
    frames: of each run.
    """
    chosen = with_preset(PRESETS, **locals())
    common = dict(defence=defence, placement="random", attack_start_s=attack_start_s)
    runs = {}
    for count in several(chosen["agents"]):
        sensors = common | sensors_of(count)
        for attack in [None, *parse_choices(adversaries, "adversaries")]:
            for liars in numbers(chosen["shares"], count):
                if (attack is None) == (liars == 0):
                    name = "" if attack is None else short_name(attack)
                    lying = {} if attack is None else dict(attack=attack, budget=budget)
                    runs[f"{count} agents {f'{name} {liars}' if liars else 'without liars'}"] = dict(
                        scenario="defence_cell",
                        parameters=sensors | lying | dict(n_adversaries=liars),
                        factors=dict(attack=name, agents=count, liars=liars, attack_start_s=attack_start_s),
                    )
    return dict(
        name="breakdown",
        kind=Breakdown,
        runs=runs,
        per_trial=dict(seed="placement_seed", frames="placement_frames"),
        scenes=words(chosen["scenes"]),
        trials=chosen["trials"],
        frames=chosen["frames"],
        seed=seed,
    )


def numbers(shares, agents):
    """Numbers of liars from shares of all agents, each once, always with 0."""
    for share in several(shares):
        if not 0.0 <= share <= 1.0:
            raise ConfigurationError(f"shares: found {share!r}, expected 0 to 1")
    return sorted({0, *(min(agents - 1, int(share * agents + 0.5)) for share in several(shares))})
