"""What standard messages cost a fusion: each of their limits alone, and all together, without an attack."""


def study(n_mobile=3, junction=8, scenes=4, trials=5, frames=150, seed=3000):
    """Peers that hear all tracks in every frame, against peers that hear less.

    tracks: all columns, in every frame; variances: without correlations; quantised: the bytes of CPMs, in every frame;
    rules: all columns, when the standard's rules say so; cpm: bytes and rules; radio: with the shared channel and its
    congestion control, too.

    n_mobile: cars with sensors, besides the ego and four poles; junction: the first of the generated junctions;
    scenes: their number; 0: each seed has a junction of its own; trials: seeds of each; seed: the first
    one; frames: of each run.
    """
    quantised, rules = dict(codec="cpm"), dict(rules="CpmGeneration")
    limits = dict(
        tracks={}, variances={"peers.*.correlations": False}, quantised=quantised, rules=rules, cpm=rules | quantised
    )
    runs = {name: dict(scenario="peers", parameters=dict(n_mobile=n_mobile) | limit) for name, limit in limits.items()}
    runs["radio"] = dict(scenario="congested", parameters=dict(n_mobile=n_mobile, background=0))
    return dict(
        name="messages",
        runs=runs,
        baseline="tracks",
        per_trial={} if scenes else dict(seed="scene_index"),
        scenes=[f"intersection:{junction + i}" for i in range(scenes)] or [{}],
        trials=trials,
        frames=frames,
        seed=seed,
    )
