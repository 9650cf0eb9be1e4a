"""Agents on two hosts: one host is cut off for five seconds and reconnects.

Everything else is at the centre.
The hosts are network namespaces of this machine (docs/how-to-hosts.md#real-networks-on-one-machine): this needs root,
iproute2 and nftables. Slow links: `--set hosts.west.delay_ms=20`.
"""

from baseline import scenario as baseline


def scenario(scene="intersection", scene_index=None, cut_s=3.0, partition_s=5.0):
    """A baseline run with a partition.

    cut_s: time at which west is cut off; partition_s: duration, 0 for no partition.
    """
    partition = dict(type="HostPartition", at=cut_s, until=cut_s + partition_s, hosts=["west"])
    return baseline(scene, scene_index, n_infrastructure=4) | dict(
        name="two_hosts",
        hosts=dict(west=dict(nodes=["infra_1", "infra_2"]), east=dict(nodes=["infra_3", "infra_4", "ego"])),
        faults=[partition] if partition_s else [],
        run=dict(mode="realtime", seed=0),
    )
