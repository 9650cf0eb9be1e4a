"""An attack while some agents are cut off; then one is killed and restarted."""

from uncoordinated import scenario as uncoordinated

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.scenario import agents_of


def scenario(
    n_adversaries=1,
    attack_start_s=2.0,
    partition_s=3.0,
    partition_until_s=6.0,
    kill_s=8.0,
    restart_after_s=1.5,
    scene="intersection",
    scene_index=None,
    n_infrastructure=None,
    n_mobile=None,
):
    """The first infrastructure agents are compromised, the last two are cut off.

    The last one is killed later.

    attack_start_s: when the attack begins; partition_s, partition_until_s: when the partition begins and is healed;

    kill_s: when the last agent is killed; restart_after_s: how long it stays down. All in scene time.
    """
    attacked = uncoordinated(
        n_adversaries=n_adversaries,
        attack_start_s=attack_start_s,
        scene=scene,
        scene_index=scene_index,
        n_infrastructure=n_infrastructure,
        n_mobile=n_mobile,
    )
    cut_off = agents_of(attacked["scene"])[1:][-2:]
    if not cut_off:
        raise ConfigurationError("the scene has no agent except the ego: expected another one, to be cut off")
    return attacked | dict(
        name="attack_during_partition",
        faults=[
            dict(type="Partition", at=partition_s, until=partition_until_s, nodes=list(cut_off)),
            dict(type="Kill", at=kill_s, node=cut_off[-1], restart_after=restart_after_s),
        ],
    )
