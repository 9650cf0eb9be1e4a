"""Interposers on every agent's wires that change nothing, to measure their cost."""

from baseline import scenario as baseline

from mast_zenoh.scenario import agents_of


def scenario(scene="intersection", scene_index=None, n_infrastructure=None, n_mobile=None):
    """As `baseline`, with one pass-through adversary on every agent."""
    unattacked = baseline(scene, scene_index, n_infrastructure, n_mobile)
    return unattacked | dict(
        name="passthrough",
        adversaries={
            f"adversary_{i}": dict(type="Adversary", agent=agent, attack=dict(type="PassThrough"))
            for i, agent in enumerate(agents_of(unattacked["scene"]))
        },
        keyexpr=dict(map="testbed.toml", rewrites=["on_detections.toml", "on_tracks.toml"]),
    )
