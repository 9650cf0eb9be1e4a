"""Peers on a shared radio channel, with the standard's generation rules and congestion control."""

from peers import scenario as peers


def scenario(
    rules="CpmGeneration",
    congestion="AdaptiveDcc",
    n_adversaries=0,
    on="sent",
    listener="ego",
    attack_start_s=4.0,
    defence=None,
    fusion="CovarianceIntersectionFusion",
    codec="cpm",
    awareness=False,
    scene="intersection",
    scene_index=None,
    n_infrastructure=None,
    n_mobile=15,
    background=150,
):
    """As `peers`, with a channel that fills up.

    rules: CpmGeneration (the standard's), or EveryFrame; congestion: ReactiveDcc, AdaptiveDcc, or NoCongestionControl;
    codec: of broadcasts: cpm, the standard's bytes, or columns;
    background: stations besides, around the scene, which only load the channel, under the same congestion control;
    awareness: whether vehicles say where they are, by Cooperative Awareness Messages;
    n_adversaries: agents compromised, with the attack of `uncoordinated`, from attack_start_s on;
    on: sent, pair, heard or awareness, as in `peers`; listener: an agent;
    defence: an integrity stage for every peer; fusion: of the tracks of an object, a class.
    """
    content = peers(
        n_adversaries=n_adversaries,
        on=on,
        listener=listener,
        attack_start_s=attack_start_s,
        defence=defence,
        fusion=fusion,
        codec=codec,
        rules=rules,
        awareness=awareness,
        scene=scene,
        scene_index=scene_index,
        n_infrastructure=n_infrastructure,
        n_mobile=n_mobile,
    )
    maps = content["keyexpr"]["rewrites"]
    channel = dict(radio=dict(type="RadioChannel"), timing=dict(type="OfdmTiming"))
    if background:
        others = dict(type="BackgroundStations", stations=background, congestion=dict(type=congestion))
        channel |= dict(background=others)
    return content | dict(
        name="congested",
        peers={agent: peer | dict(congestion=dict(type=congestion)) for agent, peer in content["peers"].items()},
        channel=channel,
        keyexpr=content["keyexpr"] | dict(rewrites=[*maps, "channel.toml"]),
    )
