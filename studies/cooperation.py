"""Fusion in one centre, in two regional ones, and on board of every agent, under equal attacks."""

from mast_zenoh.study.defences import several

# Cars with sensors besides the ego and four poles: 5, 10, 20 and 50 agents. On two cores, quick takes a minute.
PRESETS = dict(quick=dict(n_mobile=(0, 5), trials=2, scenes=2), full=dict(n_mobile=(0, 5, 15, 45), trials=5, scenes=4))


def study(
    preset="quick", n_mobile=None, n_adversaries=1, junction=8, trials=None, frames=100, attack_start_s=3.0, seed=3000
):
    """Paired runs without and with lies of one or more poles, on what they send.

    preset: quick or full; it sets all that is None;
    n_mobile: numbers of cars with sensors, besides the ego and four poles; n_adversaries: poles that lie;
    junction: the first of the generated junctions; trials: seeds of each; seed: the first one;
    frames: of each run; attack_start_s: when the lies begin.
    """
    chosen = PRESETS[preset]
    cars = several(chosen["n_mobile"] if n_mobile is None else n_mobile)
    lies = dict(n_adversaries=n_adversaries, attack_start_s=attack_start_s)
    on_tracks = {"keyexpr.rewrites": ["on_tracks.toml"]}
    places = dict(
        centre=("baseline", {}, "uncoordinated", on_tracks),
        regions=("two_centres", {}, "two_centres", {}),
        peers=("peers", {}, "peers", {}),
        radio=("congested", {}, "congested", {}),
    )
    runs = {}
    for name, (honest, parameters, attacked, more) in places.items():
        runs[name] = dict(scenario=honest, parameters=parameters, grid=dict(n_mobile=cars))
        runs[f"{name}_lied_to"] = dict(scenario=attacked, parameters=lies | more, grid=dict(n_mobile=cars))
    return dict(
        name="cooperation",
        runs=runs,
        scenes=[f"intersection:{junction + i}" for i in range(chosen["scenes"])],
        trials=chosen["trials"] if trials is None else trials,
        frames=frames,
        runtime="inproc",
        seed=seed,
    )
