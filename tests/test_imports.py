"""Imports follow the layers without cycles; algorithms do no I/O."""

import ast
from pathlib import Path

import pytest

from mast_zenoh.layers import LAYERS

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "mast_zenoh"

RANK = {name: rank for rank, name in enumerate(LAYERS)}
FILES = sorted(PACKAGE.rglob("*.py"))


def imported(path: Path) -> set[str]:
    """Full names of all modules that a file imports."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_down_the_layers(path: Path) -> None:
    own = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    assert own in RANK, f"{own} is not in the list of layers"
    for name in imported(path):
        parts = name.split(".")
        if parts[0] == "mast_zenoh" and len(parts) > 1 and parts[1] in RANK:
            assert RANK[parts[1]] >= RANK[own], f"imports {name}, which is in a higher layer"


@pytest.mark.parametrize(
    "path",
    [*FILES[1:], *sorted((ROOT / "nodes").glob("*.py"))],
    ids=lambda path: path.relative_to(ROOT).as_posix(),
)
def test_no_module_imports_from_the_public_api(path: Path) -> None:
    """`import mast_zenoh` is for users: the API is the top layer."""
    assert FILES[0] == PACKAGE / "__init__.py"
    for name in imported(path):
        parts = name.split(".")
        if parts[0] == "mast_zenoh":
            assert len(parts) > 2 or name == "mast_zenoh" or parts[1] in RANK, f"imports {name} from the API"
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            assert "mast_zenoh" not in {alias.name for alias in node.names}, "imports the API"


def module_of(path: Path) -> str:
    """The name under which a file is imported."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported_modules(path: Path, modules: set[str]) -> set[str]:
    """All modules of the package that a file imports, also for type checking."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path}: a relative import"
            full = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= {name if name in modules else str(node.module) for name in full}
    return (names & modules) - {module_of(path)}


def cycles(graph: dict[str, set[str]]) -> list[set[str]]:
    """The strongly connected components with more than one module."""

    def reached(start: str) -> set[str]:
        modules, waiting = set[str](), [start]
        while waiting:
            new = graph[waiting.pop()] - modules
            modules |= new
            waiting += new
        return modules

    reach = {name: reached(name) for name in graph}
    circles = {frozenset(other for other in reach[name] if name in reach[other]) for name in graph}
    return [set(circle) for circle in circles if circle]


def test_no_import_cycles_between_files() -> None:
    modules = {module_of(path) for path in FILES}
    assert cycles({module_of(path): imported_modules(path, modules) for path in FILES}) == []


def test_a_cycle_is_found_wherever_it_begins() -> None:
    graph = {"a": {"b"}, "b": {"c"}, "c": {"b", "d"}, "d": set()}
    assert cycles(graph) == [{"b", "c"}]


MAX_LINES = 300
MAX_TOP_LEVEL = 8


@pytest.mark.parametrize(
    "path", [*FILES, *sorted(PACKAGE.rglob("*.pyx"))], ids=lambda path: str(path.relative_to(PACKAGE))
)
def test_files_have_at_most_300_lines(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= MAX_LINES


def test_the_top_level_of_the_package_has_few_modules() -> None:
    assert len([*PACKAGE.glob("*.py")]) <= MAX_TOP_LEVEL


ALGORITHMS = {"tracking", "fusion", "pipelines", "attacks", "effects", "evaluation", "metrics", "links", "faults"}
PURE = [path for path in FILES if path.relative_to(PACKAGE).parts[0] in ALGORITHMS]
#: Files that make Stone Soup's timestamps, which are datetimes, of the times of messages.
STONE_SOUP = ("stone_soup_objects.py", "stone_soup_default.py")
FORBIDDEN = {"zenoh", "socket", "time", "random", "os", "subprocess", "threading", "asyncio"}


@pytest.mark.parametrize("path", [*PURE, *sorted((ROOT / "nodes").glob("*.py"))], ids=lambda path: path.name)
def test_nodes_and_algorithms_use_no_socket_clock_or_global_generator(path: Path) -> None:
    text = path.read_text()
    assert not {name.split(".")[0] for name in imported(path)} & FORBIDDEN
    clock = (".now(", ".utcnow(", ".today(") if path.name in STONE_SOUP else ("datetime",)
    for word in ("np.random.rand", "np.random.seed", "np.random.normal", "open(", *clock):
        assert word not in text, word
