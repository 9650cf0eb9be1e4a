"""Nodes of a wiring, with their ports written in short."""

from mast_zenoh.wiring.endpoints import NodeOptions


def node(role: str, inputs: str = "", outputs: str = "", **options: str) -> NodeOptions:
    """A node whose ports are given as `port:message` words."""

    def ports(words: str) -> dict[str, str]:
        return dict(word.split(":") for word in words.split())

    return NodeOptions(role, options, ports(inputs), ports(outputs))
