"""Two regional centres with a border through the junction, and a centre of centres; or one on board of the ego."""

from uncoordinated import scenario as uncoordinated


def scenario(
    border_m=0.0,
    on_board=False,
    n_adversaries=0,
    attack_start_s=4.0,
    scene="intersection",
    scene_index=None,
    n_infrastructure=None,
    n_mobile=None,
):
    """As `baseline`, with a centre west of the border and one east of it.

    border_m: x of the border, m, world frame; on_board: one centre instead, which moves with the ego;
    n_adversaries: agents compromised, with the attack of `uncoordinated` on their tracks, from attack_start_s on.
    """
    content = uncoordinated(
        n_adversaries,
        attack_start_s=attack_start_s,
        scene=scene,
        scene_index=scene_index,
        n_infrastructure=n_infrastructure,
        n_mobile=n_mobile,
    )
    pipeline = content["command_center"]["pipeline"]
    lies = ["on_tracks.toml"] * bool(n_adversaries)
    if on_board:
        return content | dict(
            name="two_centres",
            broker=None,
            command_center=None,
            centers=dict(on_board=dict(pipeline=pipeline, region=dict(type="Around", radius_m=100.0))),
            keyexpr=dict(map="testbed.toml", rewrites=["center_on_board.toml", *lies]),
        )
    return content | dict(
        name="two_centres",
        broker=dict(file="center_broker.py"),
        centers=dict(
            west=dict(pipeline=pipeline, region=dict(type="Rectangle", x_max_m=border_m)),
            east=dict(pipeline=pipeline, region=dict(type="Rectangle", x_min_m=border_m)),
        ),
        keyexpr=dict(map="testbed.toml", rewrites=["centers.toml", *lies]),
    )
