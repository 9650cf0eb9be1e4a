"""The page on architecture follows a detection and a metric through the files that the code has, and few of them."""

from __future__ import annotations

import ast
import re
from itertools import pairwise
from pathlib import Path

import pytest

from mast_zenoh.layers import LAYERS

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "explanation-architecture.md").read_text()
PATHS = {
    "One detection, from the simulator to the picture": 12,
    "One metric, from the evaluator to the page": 6,
}
#: Between two functions: a message crosses the mesh, waits in a queue, is written to the run folder, or is asked for by
#: the next function.
CROSSINGS = ("mesh", "inbox", "disk", "asked")


def steps(title: str) -> list[tuple[str, list[str]]]:
    """(file, names and crossings on the way) of each item of the numbered list below a heading."""
    section = PAGE.partition(f"## {title}\n")[2].partition("\n## ")[0]
    items = re.split(r"^\d+\. ", section, flags=re.MULTILINE)[1:]
    assert items, f"no list below {title!r}"
    found = []
    for item in items:
        way = item.partition(":")
        file = way[0].strip("`")
        path = file if file.startswith("nodes/") else f"mast_zenoh/{file}"
        found.append((path, re.findall(r"`([\w.]+)`|\*(\w+)\*", way[2].partition(".\n")[0])))
    return [(path, [code or crossing for code, crossing in names]) for path, names in found]


def definition(path: str, name: str) -> ast.AST:
    """The function, class or method of a name in a file, such as `Host.publish`."""
    scope: ast.AST = ast.parse((ROOT / path).read_text())
    for part in name.split("."):
        defined = [node for node in ast.walk(scope) if getattr(node, "name", None) == part]
        assert defined, f"{path} defines no {name}"
        scope = defined[0]
    return scope


def names_in(scope: ast.AST) -> set[str]:
    """All names, attributes, arguments and texts in a piece of code."""
    parts = (("id", ast.Name), ("attr", ast.Attribute), ("value", ast.Constant), ("name", ast.alias))
    return {str(getattr(node, field)) for node in ast.walk(scope) for field, kind in parts if isinstance(node, kind)}


def port_of(name: str) -> str:
    """The port of a handler such as `Agent.on_detections`, which the host calls; "" for another name."""
    last = name.rpartition(".")[2]
    return last.removeprefix("on_") if last.startswith("on_") else ""


@pytest.mark.parametrize("title", PATHS)
def test_a_path_through_the_code_has_few_files_and_every_name_leads_to_the_next(title: str) -> None:
    path_steps = steps(title)
    files = {path for path, _ in path_steps}
    assert len(files) <= PATHS[title]
    way = [(path, name) for path, names in path_steps for name in names]
    published: set[str] = set()  # ports on which the nodes so far publish
    for (_, answer), (_, crossing), (path, name) in zip(way, way[1:], way[2:], strict=False):
        if crossing == "asked":
            assert answer.rpartition(".")[2] in names_in(definition(path, name)), (
                f"{path}: {name} asks not for {answer}"
            )
    for (path, name), (next_path, next_name) in pairwise(way):
        if name in CROSSINGS:
            continue
        code = names_in(definition(path, name))
        published |= code if path.startswith(("nodes/", "mast_zenoh/fusion/pipelines/")) else set()
        if next_name in CROSSINGS:
            continue
        last = next_name.rpartition(".")[2]
        called = port_of(next_name) in published if port_of(next_name) else last in code
        assert called, f"{path}: {name} does not lead to {next_name} of {next_path}"
    assert way[-1][1] not in CROSSINGS
    definition(*way[-1])


def test_the_plan_of_the_house_has_every_room_in_the_order_of_imports() -> None:
    plan = (ROOT / "CONTRIBUTING.md").read_text().partition("```mermaid\n")[2].partition("```")[0]
    floors = re.findall(r"direction TB\n +(.*)\n +end", plan)
    rooms = [room for room in LAYERS if not room.startswith("_")]
    assert [room for floor in floors for room in floor.split("; ")] == rooms
