"""Wires know, nodes don't: no code but nodes and the wiring itself spells the key or the port of a wire."""

import ast
import re
from pathlib import Path

from mast_zenoh.config import bundle
from mast_zenoh.wiring import maps

PACKAGE = Path(__file__).parents[2] / "mast_zenoh"
ENTRIES = [
    entry
    for path in (bundle.ROOT / "keyexpr_maps").glob("*.toml")
    for entry in maps.load(path).get("wire", ())
    if entry["message"] not in ("clock", "truth")  # the mesh's own
]
KEYS = re.compile("|".join(re.sub(r"\\\{\w+\\\}", "[^/]+", re.escape(entry["key"])) for entry in ENTRIES))
#: Ports that are not called as their message type; types may be named anywhere.
PORTS = {
    end.partition(".")[2]
    for entry in ENTRIES
    for end in (entry["from"], *entry["to"])
    if end.partition(".")[2] not in {each["message"] for each in ENTRIES}
}
#: What a module that spells a wire or compares a port has in it: others need not be parsed.
SUSPECT = re.compile("|".join(sorted({re.escape(entry["key"].partition("{")[0]) for entry in ENTRIES})) + r"|\.port\b")
#: Names in files of other tools that look like keys.
OTHERS = {"mast_zenoh/show/export/rrd.py"}


def spelled(tree: ast.Module) -> list[str]:
    """Texts of a module that are a key, and ports that it compares with."""
    nodes = [*ast.walk(tree)]
    texts = [
        "".join(part.value if isinstance(part, ast.Constant) else "x" for part in node.values)
        if isinstance(node, ast.JoinedStr)
        else node.value
        for node in nodes
        if isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))
    ]
    compared = [
        part.value
        for node in nodes
        if isinstance(node, ast.Compare) and any(getattr(side, "attr", "") == "port" for side in ast.walk(node))
        for part in ast.walk(node)
        if isinstance(part, ast.Constant)
    ]
    return [text for text in texts if KEYS.fullmatch(text.replace("*", "x"))] + [p for p in compared if p in PORTS]


def test_no_code_outside_nodes_and_wiring_spells_a_wire_or_a_port() -> None:
    found = {
        name: offenders
        for path in PACKAGE.rglob("*.py")
        if (name := str(path.relative_to(PACKAGE.parent))) not in OTHERS and not name.startswith("mast_zenoh/wiring/")
        if SUSPECT.search(text := path.read_text()) and (offenders := spelled(ast.parse(text)))
    }
    assert not found


def test_a_spelled_wire_is_found() -> None:
    assert spelled(ast.parse("key = f'agent/{name}/tracks'\nif passage.port in ('broadcast',): pass")) == [
        "agent/x/tracks",
        "broadcast",
    ]
