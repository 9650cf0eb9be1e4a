"""An interposer on every agent's wires that changes nothing: what it costs, and the proof that it leaves no trace."""

from baseline import scenario as baseline


def scenario(scene="intersection", scene_index=0, n_infrastructure=4, n_mobile=0):
    """As `baseline`, with one pass-through adversary on each infrastructure agent and on the ego."""
    agents = ["ego", *(f"infra_{i}" for i in range(1, n_infrastructure + 1))]
    return baseline(scene, scene_index, n_infrastructure, n_mobile) | dict(
        name="passthrough",
        adversaries={
            f"adversary_{i}": dict(type="Adversary", agent=agent, attack=dict(type="PassThrough"))
            for i, agent in enumerate(agents)
        },
        keyexpr=dict(map="testbed.toml", rewrites=["on_detections.toml", "on_tracks.toml"]),
    )
