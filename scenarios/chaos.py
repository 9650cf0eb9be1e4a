"""Whatever can go wrong, at random: a list of faults drawn from a seed, all of them healed before the run ends."""

from baseline import scenario as baseline

from mast_zenoh.faults import random_schedule


def scenario(
    chaos_seed=0,
    duration_s=4.5,
    settle_s=2.5,
    most_faults=5,
    servers=("broker", "command_center"),
    scene="intersection",
    scene_index=0,
    n_infrastructure=2,
    n_mobile=0,
):
    """chaos_seed: of the faults; settle_s: at the end, without any; most_faults: at most; servers: hit like agents.

    The scene, and all draws in it, are those of the run's own seed: runs of two chaos seeds differ by their faults.
    """
    agents = [
        "ego",
        *(f"mobile_{i}" for i in range(1, n_mobile + 1)),
        *(f"infra_{i + 1}" for i in range(n_infrastructure)),
    ]
    return baseline(scene, scene_index, n_infrastructure, n_mobile) | dict(
        name="chaos",
        faults=random_schedule(chaos_seed, duration_s, agents, servers=servers, settle_s=settle_s, most=most_faults),
        run=dict(mode="lockstep", seed=0, frames=round(duration_s * 10.0)),
    )
