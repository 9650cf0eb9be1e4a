"""One road user disappears: all agents' adversaries hide the most relevant object.

It is the object that will come nearest to the ego among those that are not in the ego's own tracks: a car behind a
corner, a cyclist behind a truck. If the ego sees every object, it is the nearest one. All agents' tracks of it are
removed, so no agent reports it, and the ego drives on without it until it sees the object itself.
"""

from baseline import scenario as baseline

from mast_zenoh.scenario import agents_of


def scenario(
    attack_start_s=4.0,
    n_objects=1,
    horizon_s=6.0,
    unseen_by_ego=True,
    near=None,
    scene="intersection",
    scene_index=None,
    n_infrastructure=None,
    n_mobile=None,
):
    """Adversaries on all agents that hide objects.

    n_objects: number of objects to hide; horizon_s: s, how far ahead the attacker looks;
    near: hide objects within 20 m of (x, y) m instead; unseen_by_ego: prefer objects not in the ego's own tracks.
    """
    unattacked = baseline(scene, scene_index, n_infrastructure, n_mobile)
    return unattacked | dict(
        name="hide_object",
        adversaries={
            f"adversary_{i}": dict(
                type="Adversary", agent=agent, attack=dict(type="CoordinatedAttack", start_s=attack_start_s)
            )
            for i, agent in enumerate(agents_of(unattacked["scene"]))
        },
        coordinator=dict(
            coordination=dict(
                type="Coordinator",
                start_s=attack_start_s,
                reselect_every_s=None,
                selection=dict(
                    type="ConflictSelection",
                    n_objects=n_objects,
                    horizon_s=horizon_s,
                    unseen_by_ego=unseen_by_ego,
                    near=near,
                ),
            )
        ),
        keyexpr=dict(map="testbed.toml", rewrites=["on_tracks.toml", "coordination.toml"]),
    )
