"""Wirings of the shipped nodes under shipped maps, without a scenario."""

from collections.abc import Sequence

from mast_zenoh.config import bundle, loading
from mast_zenoh.scenario.resolution import _shipped_ports as shipped_ports
from mast_zenoh.wiring import maps
from mast_zenoh.wiring.endpoints import NodeOptions
from mast_zenoh.wiring.model import Wiring, peer_of


def options(file: str, **bindings: str) -> NodeOptions:
    """The properties of a shipped node that a wiring depends on."""
    cls = loading.node_class(bundle.ROOT / "nodes" / f"{file}.py")
    return NodeOptions(
        cls.role, bindings, cls.inputs, cls.outputs, cls.takes, cls.forwards, cls.affects, tuple(cls.fuses)
    )


def wiring_of(agents: Sequence[str], *more_maps: str, peers: bool = False) -> Wiring:
    """The wiring of agents with a command centre, or with peers."""
    nodes = {"simulator": options("simulator"), **{name: options("agent") for name in agents}}
    if peers:
        nodes |= {peer_of(name): options("peer", agent=name) for name in agents}
    else:
        nodes |= {"broker": options("broker"), "command_center": options("command_center")}
    names = ("testbed.toml", *(("peers.toml",) if peers else ()), *more_maps)
    return maps.resolve(
        [(name, maps.load(bundle.ROOT / "keyexpr_maps" / name)) for name in names], nodes, shipped_ports()
    )
