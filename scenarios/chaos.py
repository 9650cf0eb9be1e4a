"""Random faults, drawn from a seed and all healed before the run ends."""

from baseline import scenario as baseline

from mast_zenoh.faults import random_schedule
from mast_zenoh.scenario import agents_of


def scenario(
    chaos_seed=0,
    duration_s=4.5,
    settle_s=2.5,
    most_faults=5,
    servers=("broker", "command_center"),
    scene="intersection",
    scene_index=None,
    n_infrastructure=None,
    n_mobile=None,
):
    """chaos_seed: seed of the faults; settle_s: time without faults at the end; most_faults: their greatest number;

    servers: nodes that faults can affect besides agents; n_infrastructure: None: two on a generated junction, else all.

    The scene and its random draws depend on the run's own seed: runs of two chaos seeds differ by their faults only.
    """
    if n_infrastructure is None and str(scene).startswith("intersection"):
        n_infrastructure = 2
    calm = baseline(scene, scene_index, n_infrastructure, n_mobile)
    agents = agents_of(calm["scene"])
    return calm | dict(
        name="chaos",
        faults=random_schedule(chaos_seed, duration_s, agents, servers=servers, settle_s=settle_s, most=most_faults),
        run=dict(mode="lockstep", seed=0, frames=round(duration_s * 10.0)),
    )
