"""The table of message types is complete and covers all ports of shipped nodes."""

from pathlib import Path

import pytest

from mast_zenoh import links
from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.attacks import ACTIONS
from mast_zenoh.config import bundle, loading
from mast_zenoh.integrity import STATES
from mast_zenoh.messages.schemas import SCHEMAS
from mast_zenoh.node import Node
from mast_zenoh.wiring.model import ANY

SHIPPED_NODES = [loading.node_class(bundle.ROOT / "nodes" / name) for name in bundle.names("nodes")]


@pytest.mark.parametrize("name", SCHEMAS)
def test_every_message_type_describes_its_columns(name: str) -> None:
    schema = SCHEMAS[name]
    assert schema.name == name
    assert schema.version >= 1
    assert schema.meaning
    assert len({column.name for column in schema.columns}) == len(schema.columns)
    for column in schema.columns:
        assert column.dtype in ("float64", "float32", "int64", "int32", "uint8", "str")
        assert all(size in ("n", "a", "m", "k") or (isinstance(size, int) and size > 0) for size in column.shape)
        if column.dtype in ("float64", "float32") and column.name.rpartition("_")[2] in (
            "position",
            "velocity",
            "size",
            "yaw",
        ):
            assert column.unit in ("m", "m/s", "rad")
        if column.dtype == "str":
            assert len(column.shape) == 1


def test_indices_are_limited_to_what_they_index() -> None:
    limits = {"class_id": CLASSES, "action": ACTIONS, "port": (*links.WIRES, "another type"), "fate": links.FATES}
    limits |= {"state": STATES, "withheld": (False, True), "origin": (False, True)}
    for column in (column for schema in SCHEMAS.values() for column in schema.columns if column.dtype == "uint8"):
        known = next((known for name, known in limits.items() if column.name.endswith(name)), range(256))
        assert column.below == len(known), column.name


def test_every_quaternion_must_have_a_non_zero_norm() -> None:
    for column in (column for schema in SCHEMAS.values() for column in schema.columns):
        assert (column.least_length > 0.0) == column.name.endswith("rotation"), column.name


@pytest.mark.parametrize("node", SHIPPED_NODES, ids=lambda node: node.__name__)
def test_ports_of_shipped_nodes_have_known_message_types(node: type[Node]) -> None:
    assert node.role
    assert node.__doc__
    assert {*node.inputs.values(), *node.outputs.values()} <= SCHEMAS.keys() | {ANY}
    for port, schema in node.inputs.items():
        assert callable(getattr(node, f"on_{port}")), schema


def test_each_role_has_shipped_nodes_named_after_it() -> None:
    """Centres have a broker of their own, a world is a simulator too, and some roles have a node of ROS 2."""
    roles = {"center_broker": "broker", "world": "simulator"}
    files = [Path(name).stem.removeprefix("ros2_") for name in bundle.names("nodes")]
    assert sorted(node.role for node in SHIPPED_NODES) == sorted(roles.get(file, file) for file in files)


def test_every_message_type_is_used() -> None:
    used = {schema for node in SHIPPED_NODES for ports in (node.inputs, node.outputs) for schema in ports.values()}
    assert used == SCHEMAS.keys() | {ANY}
