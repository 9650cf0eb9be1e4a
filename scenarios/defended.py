"""Adversaries against a command centre that judges agents and objects."""

from coordinated import scenario as coordinated


def scenario(
    defence="NoIntegrity",
    n_adversaries=2,
    scene="intersection",
    scene_index=None,
    n_infrastructure=None,
    n_mobile=None,
):
    """As `coordinated`, with an integrity stage.

    defence: its class, such as "NoIntegrity", or a dict with its class and parameters
    """
    attacked = coordinated(
        n_adversaries=n_adversaries,
        scene=scene,
        scene_index=scene_index,
        n_infrastructure=n_infrastructure,
        n_mobile=n_mobile,
    )
    center = attacked["command_center"]
    stage = dict(type=defence) if isinstance(defence, str) else defence
    return attacked | dict(
        name="defended",
        command_center=center | dict(pipeline=center["pipeline"] | dict(integrity=stage)),
        keyexpr=dict(map="testbed.toml", rewrites=[*attacked["keyexpr"]["rewrites"], "views.toml"]),
    )
