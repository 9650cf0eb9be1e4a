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
#: Integrity stages that can take one agent's word, each with the part of its settings that says whose.
_OWN_WORD = {
    "SequentialConsistency": lambda agent: dict(anchors=[agent]),
    "TruthDiscovery": lambda agent: dict(anchors=[agent]),
    "FaultOrLie": lambda agent: dict(stage=dict(type="SequentialConsistency", anchors=[agent])),
    **dict.fromkeys(("Robosac", "Pasac", "Made", "PoseGuard"), lambda agent: dict(ego=agent)),
}


def _first(agents, count, name):
    """So many of some agents; raises ValueError, which names the parameter, for more than there are."""
    if not 0 <= count <= len(agents):
        raise ValueError(f"{name}: found {count}, expected 0 to {len(agents)}: {', '.join(agents)}")
    return agents[:count]


def scenario(
    n_adversaries=0,
    on="sent",
    listener="ego",
    attack_start_s=4.0,
    defence=None,
    fusion="CovarianceIntersectionFusion",
    relays=False,
    anchored=True,
    gossip=False,
    n_slanderers=0,
    codec="columns",
    rules="EveryFrame",
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
    anchored: whether a peer's defence takes the word of its own agent's sensors, if it can take an agent's word;
    gossip: whether peers tell each other whom they trust, and use it beside their defence (default: FaultOrLie);
    n_slanderers: agents besides, whose gossip says no trust in the listener and full trust in the compromised agents;
    codec: of broadcasts: columns, or cpm: Collective Perception Messages;
    rules: when a peer broadcasts what: EveryFrame, or CpmGeneration (the standard's);
    awareness: whether vehicles say where they are, by Cooperative Awareness Messages.
    """
    content = baseline(scene, scene_index, n_infrastructure, n_mobile)
    if on not in MAPS:
        raise ValueError(f"on: found {on!r}, expected one of {', '.join(MAPS)}")
    if listener not in agents_of(content["scene"]):
        raise ValueError(f"listener: no agent {listener!r} in this scene")
    pipeline = content["command_center"]["pipeline"]
    if relays or fusion != pipeline["group_tracking"]["fusion"]["type"]:
        # What is relayed comes back: nothing is independent.
        pipeline["group_tracking"]["fusion"] = dict(type=fusion)
    # The rules leave objects out for up to a second.
    radio = {} if rules == "EveryFrame" else dict(rules=dict(type=rules), memory_s=1.05, max_age_s=1.2)
    radio |= dict(awareness=dict(type="CamGeneration")) if awareness else {}
    if gossip:
        defence = defence or "FaultOrLie"
    elif n_slanderers:
        raise ValueError("n_slanderers: found more than 0, expected gossip=true with it")
    if on == "awareness" and n_adversaries and not awareness:
        raise ValueError("on: found 'awareness', expected awareness=true with it, so that vehicles say where they are")
    anchored = anchored and defence in _OWN_WORD

    def peer(agent=None):
        if not defence:
            return dict(pipeline=pipeline) | radio
        stage = dict(type=defence) | (_OWN_WORD[defence](agent) if agent else {})
        return dict(pipeline=pipeline | dict(integrity=dict(type="Hearsay", stage=stage) if gossip else stage)) | radio

    if codec not in ("columns", "cpm"):
        raise ValueError(f"codec: found {codec!r}, expected 'columns' or 'cpm'")
    others = [agent for agent in agents_of(content["scene"]) if agent != listener]
    liars = victims_of(content["scene"], n_adversaries)
    victims = [others] if on == "heard" and liars else liars
    lies = uncoordinated(1, attack_start_s=attack_start_s)["adversaries"]["adversary_1"]["attack"]
    if on == "awareness":
        victims = _first([agent for agent in others if not agent.startswith("infra")], n_adversaries, "n_adversaries")
        lies["selection"] |= dict(n_false_positives=0.0, fraction_false_negatives=0.0, fraction_translations=1.0)
    before = dict(peer=f"peer_{listener}") if on in ("pair", "heard") else {}
    slanderers = _first([agent for agent in others if agent not in liars], n_slanderers, "n_slanderers")
    slander = dict(type="Slander", slandered=[listener], praised=liars, start_s=attack_start_s)
    more = (
        ["cpm_broadcasts.toml"] * (codec == "cpm")
        + ["awareness.toml"] * awareness
        + ["views.toml"] * bool(defence)
        + ["relays.toml"] * relays
        + ["gossip.toml"] * gossip
        + ["on_gossip.toml"] * bool(slanderers)
        + [MAPS[on]] * bool(victims)
    )
    if codec == "cpm":
        content["agents"] = {"*": content["agents"]["*"] | dict(tracks_from="agent")}
    return content | dict(
        name="peers",
        broker=None,
        command_center=None,
        peers={agent: peer(agent) for agent in (listener, *others)} if anchored else {"*": peer()},
        adversaries={
            name: dict(type="Adversary", agent=agent, attack=attack, **before)
            for kind, agents, attack in (("adversary", victims, lies), ("slanderer", slanderers, slander))
            for name, agent in ((f"{kind}_{i}", agent) for i, agent in enumerate(agents, 1))
        },
        keyexpr=dict(map="testbed.toml", rewrites=["peers.toml", *more]),
    )
