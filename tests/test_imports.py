"""Imports run one way, down the list of layers, and in no circle; nodes and algorithms stay free of I/O."""

import ast
from pathlib import Path

import pytest

from mast_zenoh.layers import LAYERS

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "mast_zenoh"

RANK = {name: rank for rank, name in enumerate(LAYERS)}
FILES = sorted(PACKAGE.rglob("*.py"))


def imported(path: Path) -> set[str]:
    """Full names of the modules that a file imports anywhere."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_run_down(path: Path) -> None:
    own = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    assert own in RANK, f"{own} has no place in the list"
    for name in imported(path):
        parts = name.split(".")
        if parts[0] == "mast_zenoh" and len(parts) > 1 and parts[1] in RANK:
            assert RANK[parts[1]] >= RANK[own], f"imports {name}, which stands above it"


@pytest.mark.parametrize(
    "path",
    [*FILES[1:], *sorted((ROOT / "nodes").glob("*.py"))],
    ids=lambda path: path.relative_to(ROOT).as_posix(),
)
def test_no_module_imports_from_the_public_api(path: Path) -> None:
    """`import mast_zenoh` and `from mast_zenoh import run` are for users: the API is the top layer."""
    assert FILES[0] == PACKAGE / "__init__.py"
    for name in imported(path):
        parts = name.split(".")
        if parts[0] == "mast_zenoh":
            assert len(parts) > 2 or name == "mast_zenoh" or parts[1] in RANK, f"imports {name} from the API"
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            assert "mast_zenoh" not in {alias.name for alias in node.names}, "imports the API"


ALGORITHMS = {"tracking", "fusion", "pipelines", "attacks", "effects", "evaluation", "metrics", "links", "faults"}
PURE = [path for path in FILES if path.relative_to(PACKAGE).parts[0] in ALGORITHMS]
FORBIDDEN = {"zenoh", "socket", "time", "random", "os", "subprocess", "threading", "asyncio"}


@pytest.mark.parametrize("path", [*PURE, *sorted((ROOT / "nodes").glob("*.py"))], ids=lambda path: path.name)
def test_nodes_and_algorithms_never_see_a_socket_a_clock_or_a_global_generator(path: Path) -> None:
    text = path.read_text()
    assert not {name.split(".")[0] for name in imported(path)} & FORBIDDEN
    for word in ("np.random.rand", "np.random.seed", "np.random.normal", "open(", "datetime"):
        assert word not in text, word
