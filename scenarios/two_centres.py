"""Two regional centres with a border through the junction, and a centre of centres; or one on board of the ego."""

from baseline import scenario as baseline


def scenario(
    border_m=0.0, on_board=False, scene="intersection", scene_index=None, n_infrastructure=None, n_mobile=None
):
    """As `baseline`, with a centre west of the border and one east of it.

    border_m: x of the border, m, world frame; on_board: one centre instead, which moves with the ego.
    """
    content = baseline(scene, scene_index, n_infrastructure, n_mobile)
    pipeline = content["command_center"]["pipeline"]
    if on_board:
        return content | dict(
            name="two_centres",
            broker=None,
            command_center=None,
            centers=dict(on_board=dict(pipeline=pipeline, region=dict(type="Around", radius_m=100.0))),
            keyexpr=dict(map="testbed.toml", rewrites=["center_on_board.toml"]),
        )
    return content | dict(
        name="two_centres",
        broker=dict(file="center_broker.py"),
        centers=dict(
            west=dict(pipeline=pipeline, region=dict(type="Rectangle", x_max_m=border_m)),
            east=dict(pipeline=pipeline, region=dict(type="Rectangle", x_min_m=border_m)),
        ),
        keyexpr=dict(map="testbed.toml", rewrites=["centers.toml"]),
    )
