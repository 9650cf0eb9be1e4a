"""Changes the code at random places, one at a time, and counts how many changes the tests notice.

Places are drawn from a seed, as many of each kind: arithmetic, comparison, boolean, constant (times 1.5), and
condition (negated).

    python tools/mutations.py [ROOM ...] [--count 80] [--seed 0] [--tests CHECKOUT] [--jobs 1]

A room is a folder of mast_zenoh/, by default those of ROOMS. For each change the quick tests of the room run, in a
copy of the checkout: tests/ROOM, tests/kernels, and what BESIDE says. `--tests` takes the tests of another checkout:
so two suites can be compared on the same code.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
ROOMS = ("fusion", "tracking", "attacks", "wiring", "mesh", "messages", "evaluation", "integrity")
#: Tests of a room that are in other folders; those of compiled functions, which compare them with the code, are of all.
BESIDE = {
    "attacks": ("testing/test_invalid_parameters_are_refused.py",),
    "mesh": ("simulation", "runtime", "control", "security"),
    "evaluation": ("nodes/test_evaluator.py", "effects", "driving"),
    "fusion": ("pipelines", "nodes"),
    "messages": ("runtime/test_row_limits.py", "runtime/test_limits.py"),
}
#: s that the tests of a room may take; a change with which they take longer is noticed by that.
DEADLINE_S = 900

_ARITHMETIC = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult}
_COMPARISON = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
}
_BOOLEAN = {ast.And: ast.Or, ast.Or: ast.And}
KINDS = ("arithmetic", "comparison", "boolean", "constant", "condition")
#: A tuple of more values is a table that a program has written.
_TABLE = 100


class Mutation(NamedTuple):
    """A change of a file. start, end: of the changed text, bytes;  new: what replaces it"""

    file: Path
    kind: str
    line: int
    start: int
    end: int
    new: str

    def apply(self, tree: Path) -> None:
        """Make it in the copy of a checkout."""
        path = tree / self.file
        old = path.read_bytes()
        path.write_bytes(old[: self.start] + self.new.encode() + old[self.end :])


def mutations(file: Path, content: bytes) -> Iterator[Mutation]:
    """All changes of a file, one of each kind at each place at most. file: relative to the checkout"""
    lines = [0]
    for line in content.splitlines(keepends=True):
        lines.append(lines[-1] + len(line))

    def changed(kind: str, node: ast.expr, new: ast.expr) -> Mutation:
        start, end = lines[node.lineno - 1] + node.col_offset, lines[node.end_lineno - 1] + node.end_col_offset  # type: ignore[operator]
        return Mutation(file, kind, node.lineno, start, end, f"({ast.unparse(new)})")

    for node in _code(ast.parse(content)):
        if isinstance(node, ast.BinOp) and type(node.op) in _ARITHMETIC:
            yield changed("arithmetic", node, ast.BinOp(node.left, _ARITHMETIC[type(node.op)](), node.right))
        elif isinstance(node, ast.Compare) and len(node.ops) == 1:
            op = _COMPARISON[type(node.ops[0])]()
            yield changed("comparison", node, ast.Compare(node.left, [op], node.comparators))
        elif isinstance(node, ast.BoolOp):
            yield changed("boolean", node, ast.BoolOp(_BOOLEAN[type(node.op)](), node.values))
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value:
            value = node.value * 1.5 if isinstance(node.value, float) else round(node.value * 1.5) or 2
            yield changed("constant", node, ast.Constant(value))
        elif isinstance(node, (ast.If, ast.IfExp, ast.While)):
            yield changed("condition", node.test, ast.UnaryOp(ast.Not(), node.test))


def _code(node: ast.AST) -> Iterator[ast.AST]:
    """The nodes below one that tests can notice: no annotations, messages of errors, tables, type checkers' code."""
    if isinstance(node, ast.Raise) or (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
        return
    if isinstance(node, ast.Tuple) and len(node.elts) > _TABLE:
        return
    yield node
    skipped = ("annotation", "returns", "format_spec")
    for name, value in ast.iter_fields(node):
        if name not in skipped:
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST) and not isinstance(child, ast.JoinedStr):
                    yield from _code(child)


def drawn(rooms: Sequence[str], count: int, seed: int) -> list[Mutation]:
    """So many changes of the code of some rooms, as many of each kind."""
    every: dict[str, list[Mutation]] = {kind: [] for kind in KINDS}
    for room in rooms:
        for path in sorted((ROOT / "mast_zenoh" / room).rglob("*.py")):
            for mutation in mutations(path.relative_to(ROOT), path.read_bytes()):
                every[mutation.kind].append(mutation)
    rng = random.Random(seed)
    return [rng.choice(every[KINDS[number % len(KINDS)]]) for number in range(count)]


def are_red(room: str, mutation: Mutation | None, tests: Path, work: Path) -> bool:
    """Whether the tests of a room fail with a change, or without one.

    tests: the checkout that they are from;  work: a folder for the copy
    """
    tree = Path(tempfile.mkdtemp(dir=work))
    ignored = shutil.ignore_patterns(".git", ".venv", "node_modules", ".*_cache", "__pycache__")
    shutil.copytree(ROOT, tree, ignore=ignored, dirs_exist_ok=True)
    if tests != ROOT:
        shutil.rmtree(tree / "tests")
        shutil.copytree(tests / "tests", tree / "tests", ignore=ignored)
    if mutation is not None:
        mutation.apply(tree)
    folders = [f"tests/{each}" for each in (room, *BESIDE.get(room, ()), "kernels")]
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-m", "not heavy", "-p", "no:cacheprovider", *folders]
    path = os.pathsep.join(map(str, [tree, *(tree / "plugins").glob("*")]))
    try:
        ended = subprocess.run(
            command, cwd=tree, env=os.environ | {"PYTHONPATH": path}, capture_output=True, timeout=DEADLINE_S
        )
    except subprocess.TimeoutExpired:
        return True
    finally:
        shutil.rmtree(tree, ignore_errors=True)
    return ended.returncode != 0


def main() -> None:
    """The command line."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("rooms", nargs="*", default=ROOMS, metavar="ROOM")
    words.add_argument("--count", type=int, default=80)
    words.add_argument("--seed", type=int, default=0)
    words.add_argument("--tests", type=Path, default=ROOT, metavar="CHECKOUT")
    words.add_argument("--jobs", type=int, default=1)
    chosen = words.parse_args()
    every = drawn(chosen.rooms, chosen.count, chosen.seed)
    noticed: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as work, ThreadPoolExecutor(chosen.jobs) as pool:
        tests = chosen.tests.resolve()
        for room in sorted({each.file.parts[1] for each in every}):
            if are_red(room, None, tests, Path(work)):
                sys.exit(f"tests of {room}: fail without a change, too")
        results = pool.map(lambda each: are_red(each.file.parts[1], each, tests, Path(work)), every)
        for mutation, found in zip(every, results, strict=True):
            noticed[mutation.kind] += found
            word = "noticed" if found else "MISSED"
            print(f"{word:8} {mutation.kind:10} {mutation.file}:{mutation.line}: {mutation.new}", flush=True)
    print(", ".join(f"{kind} {noticed[kind]}" for kind in KINDS))
    print(f"noticed {sum(noticed.values())} of {len(every)}")


if __name__ == "__main__":
    main()
