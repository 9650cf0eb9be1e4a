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
    """A baseline run with random faults.

    chaos_seed: seed of the faults; duration_s: length of the run; settle_s: fault-free time at its end;
    most_faults: maximum number of faults; servers: other nodes that may be targets;
    n_infrastructure: None: two on a generated junction, else all of the scene.

    The scene, and all draws in it, use the run's own seed, so runs with different chaos seeds differ only in faults.
    On a generated junction, errors of detections are new in each frame, so that what faults did is soon forgotten.
    """
    generated = str(scene).startswith("intersection")
    if n_infrastructure is None and generated:
        n_infrastructure = 2
    calm = baseline(scene, scene_index, n_infrastructure, n_mobile)
    if generated:
        calm["scene"] |= dict(detector=dict(type="DetectionModel", white=True))
    agents = agents_of(calm["scene"])
    return calm | dict(
        name="chaos",
        faults=random_schedule(
            chaos_seed, duration_s, agents, servers=servers, settle_s=settle_s, max_faults=most_faults
        ),
        run=dict(mode="lockstep", seed=0, frames=round(duration_s * 10.0)),
    )
