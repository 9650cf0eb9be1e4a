"""Cooperation without a centre: each agent fuses on board what it sees and what it hears."""

from baseline import scenario as baseline
from uncoordinated import scenario as uncoordinated

from mast_zenoh.scenario import agents_of, victims_of

#: Where adversaries sit: on what an agent sends to all, on that to one listener, on all that one listener hears, or on
#: what a vehicle says of itself.
MAPS = {
    "sent": "on_broadcast.toml",
    "pair": "on_pair.toml",
    "heard": "on_pair.toml",
    "awareness": "on_awareness.toml",
}


def scenario(
    n_adversaries=0,
    on="sent",
    listener="ego",
    attack_start_s=4.0,
    defence=None,
    fusion="CovarianceIntersectionFusion",
    relays=False,
    codec="columns",
    awareness=False,
    scene="intersection",
    scene_index=None,
    n_infrastructure=None,
    n_mobile=2,
):
    """As `baseline`, without a command centre: every agent has a peer, which runs the same pipeline.

    n_adversaries: agents compromised, with the attack of `uncoordinated`, from attack_start_s on;
    on: where: sent (what the agent sends to all), pair (what it sends to the listener), heard (one adversary, on all
    that the listener hears), or awareness (what a vehicle says of itself, which is moved); listener: an agent;
    defence: an integrity stage for every peer; fusion: of the tracks of an object, a class;
    relays: whether peers relay their pictures, too, so that rumours spread;
    codec: of broadcasts: columns, or cpm: Collective Perception Messages;
    awareness: whether vehicles say where they are, by Cooperative Awareness Messages.
    """
    content = baseline(scene, scene_index, n_infrastructure, n_mobile)
    pipeline = content["command_center"]["pipeline"]
    pipeline["group_tracking"]["fusion"] = dict(type=fusion)
    if defence:
        pipeline["integrity"] = dict(type=defence)
    if codec not in ("columns", "cpm"):
        raise ValueError(f"codec: found {codec!r}, expected 'columns' or 'cpm'")
    others = [agent for agent in agents_of(content["scene"]) if agent != listener]
    victims = victims_of(content["scene"], n_adversaries)
    if on == "heard":
        victims = [others] if n_adversaries else []
    lies = uncoordinated(1, attack_start_s=attack_start_s)["adversaries"]["adversary_1"]["attack"]
    if on == "awareness":
        victims = [agent for agent in others if not agent.startswith("infra")][:n_adversaries]
        lies["selection"] |= dict(n_false_positives=0.0, fraction_false_negatives=0.0, fraction_translations=1.0)
    before = dict(peer=f"peer_{listener}") if on in ("pair", "heard") else {}
    more = (
        ["cpm_broadcasts.toml"] * (codec == "cpm")
        + ["awareness.toml"] * awareness
        + ["views.toml"] * bool(defence)
        + ["relays.toml"] * relays
        + [MAPS[on]] * bool(victims)
    )
    if codec == "cpm":
        content["agents"] = {"*": content["agents"]["*"] | dict(tracks_from="agent")}
    aware = dict(awareness=dict(type="CamGeneration")) if awareness else {}
    return content | dict(
        name="peers",
        broker=None,
        command_center=None,
        peers={"*": dict(pipeline=pipeline) | aware},
        adversaries={
            f"adversary_{i}": dict(type="Adversary", agent=victim, attack=lies, **before)
            for i, victim in enumerate(victims, 1)
        },
        keyexpr=dict(map="testbed.toml", rewrites=["peers.toml", *more]),
    )
