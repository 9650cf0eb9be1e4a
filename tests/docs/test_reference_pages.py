"""The pages of reference name everything, and say what each thing means."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from reference import scenario
from reference.classes import KINDS, shipped

from mast_zenoh.api.catalogue import Entry

DOCS = Path(__file__).parents[2] / "docs"


def entries(kind: str) -> Iterator[Entry]:
    for _, of_group in shipped(kind):
        yield from of_group


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "messages"])
def test_every_class_is_listed_and_each_of_its_parameters_has_a_meaning(kind: str) -> None:
    page = (DOCS / "ref-classes.md").read_text("utf-8")
    for entry in entries(kind):
        assert f"#### {entry.name}\n" in page or f"| `{entry.name}` |" in page, entry.name
        assert entry.description, entry.name
        assert not [each.name for each in entry.parameters if not each.words], (
            f"{entry.name}: describe them as `name: …`"
        )


def test_every_parameter_of_a_node_and_of_its_parts_has_a_meaning() -> None:
    parts = list(scenario.parts())
    assert not [f"{part.heading}: {each.name}" for part in parts for each in part.parameters if not each.words]
    roles = {cls.role for cls in scenario.node_classes()}
    assert roles >= {"agent", "broker", "command_center", "peer", "driver", "adversary", "evaluator", "link"}
