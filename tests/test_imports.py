"""Imports follow the layers without cycles; algorithms do no I/O."""

import ast
import re
from functools import cache
from pathlib import Path

from mast_zenoh.layers import LAYERS

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "mast_zenoh"

RANK = {name: rank for rank, name in enumerate(LAYERS)}
FILES = sorted(PACKAGE.rglob("*.py"))
NODES = sorted((ROOT / "nodes").glob("*.py"))


@cache
def statements(path: Path) -> list[ast.Import | ast.ImportFrom]:
    """All statements of a file that import."""
    return [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Import | ast.ImportFrom)]


def imported(path: Path) -> set[str]:
    """Full names of all modules that a file imports."""
    names: set[str] = set()
    for node in statements(path):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def test_every_module_is_in_a_layer() -> None:
    assert {path.relative_to(PACKAGE).parts[0].removesuffix(".py") for path in FILES} <= RANK.keys()


def test_imports_point_down_the_layers() -> None:
    upward = []
    for path in FILES:
        own = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        for name in imported(path):
            parts = name.split(".")
            if parts[0] == "mast_zenoh" and len(parts) > 1 and parts[1] in RANK and RANK[parts[1]] < RANK[own]:
                upward.append(f"{path.relative_to(ROOT)} imports {name}, which is in a higher layer")
    assert not upward


def test_no_module_imports_from_the_public_api() -> None:
    """`import mast_zenoh` is for users: the API is the top layer."""
    assert FILES[0] == PACKAGE / "__init__.py"
    of_the_api = []
    for path in (*FILES[1:], *NODES):
        for name in imported(path):
            first, *inner = name.split(".")
            if first == "mast_zenoh" and len(inner) == 1 and inner[0] not in RANK:
                of_the_api.append(f"{path.relative_to(ROOT)} imports {name}")
        for node in statements(path):
            if isinstance(node, ast.Import) and "mast_zenoh" in {alias.name for alias in node.names}:
                of_the_api.append(f"{path.relative_to(ROOT)} imports mast_zenoh")
    assert not of_the_api


def module_of(path: Path) -> str:
    """The name under which a file is imported."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported_modules(path: Path, modules: set[str]) -> set[str]:
    """All modules of the package that a file imports, also for type checking."""
    names: set[str] = set()
    for node in statements(path):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        else:
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


MAX_LINES = 600
MAX_TOP_LEVEL = 9


def test_files_have_at_most_600_lines() -> None:
    n_lines = {str(path): len(path.read_text().splitlines()) for path in (*FILES, *PACKAGE.rglob("*.pyx"))}
    assert not {path: n for path, n in n_lines.items() if n > MAX_LINES}


def test_the_top_level_of_the_package_has_few_modules() -> None:
    assert len([*PACKAGE.glob("*.py")]) <= MAX_TOP_LEVEL


ALGORITHMS = {"tracking", "fusion", "attacks", "evaluation", "metrics", "links", "faults", "v2x"}
PURE = [path for path in FILES if path.relative_to(PACKAGE).parts[0] in ALGORITHMS]
#: Files that make Stone Soup's timestamps, which are datetimes, of the times of messages.
STONE_SOUP = ("stone_soup_objects.py", "stone_soup_default.py")
FORBIDDEN = {"zenoh", "socket", "time", "random", "os", "subprocess", "threading", "asyncio"}


def test_nodes_and_algorithms_use_no_socket_clock_or_global_generator() -> None:
    used = []
    for path in (*PURE, *NODES):
        text = re.sub(r"(self\.|def )open\(", "", path.read_text())  # methods of its own open no file
        clock = (".now(", ".utcnow(", ".today(") if path.name in STONE_SOUP else ("datetime",)
        words = ("np.random.rand", "np.random.seed", "np.random.normal", "open(", *clock)
        modules = {name.split(".")[0] for name in imported(path)} & FORBIDDEN
        used += [(str(path), name) for name in (*modules, *(word for word in words if word in text))]
    assert not used


DECISIONS_OF_THE_LAUNCHER = ("launcher_protocol.py", "supervisor.py", "ending.py", "progress.py")
#: What the processes of a run decide; the host runs a node, and the simulation plays them all.
PROTOCOL = [
    *PACKAGE.glob("*/protocol/*.py"),
    *(PACKAGE / "testing" / "simulation").glob("*.py"),
    *(PACKAGE / "mesh" / name for name in ("host.py", "waiting.py")),
    *(PACKAGE / "launch" / name for name in DECISIONS_OF_THE_LAUNCHER),
]
#: The simulation draws its delays, from a seed.
SEEDED = {"random"}


def test_protocol_and_simulation_use_no_network_thread_clock_or_file() -> None:
    assert len(PROTOCOL) > 10
    used = []
    for path in PROTOCOL:
        seeded = SEEDED if "simulation" in path.parts else set()
        modules = {name.split(".")[0] for name in imported(path)} & (
            FORBIDDEN - seeded | {"pathlib", "queue", "select"}
        )
        used += [
            (str(path), name) for name in (*modules, *(word for word in ("open(",) if f" {word}" in path.read_text()))
        ]
    assert not used
