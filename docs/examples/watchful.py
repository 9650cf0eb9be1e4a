from agent import Agent

from mast_zenoh.scenario import load


class WatchfulAgent(Agent):
    """Also tells others which objects it will watch."""

    outputs = {**Agent.outputs, "watch": "tracks"}

    def publish_tracks(self, perceived, tracks, context):
        super().publish_tracks(perceived, tracks, context)
        origin, rotation = self.pipeline.reference(perceived.pose)
        watched = tracks.select(slice(0, 5)).columns() | {"origin": origin, "rotation": rotation}
        context.publish("watch", watched, frame=perceived.frame, time_ns=perceived.time_ns)


def scenario():
    _, base = load("peers")
    invented = dict(type="UncoordinatedSelection", n_false_positives=5.0, exact_number=True)
    lie = dict(type="UncoordinatedAttack", start_s=1.0, selection=invented)
    return base | dict(
        name="watchful",
        agents={"*": base["agents"]["*"] | dict(file="watchful.py", type="WatchfulAgent")},
        adversaries=dict(liar=dict(type="Adversary", agent="infra_1", attack=lie)),
        links={"infra_2": dict(up=[dict(type="Loss", probability=0.3)])},
        keyexpr=dict(map="testbed.toml", rewrites=["peers.toml", "watch.toml"]),
    )
