"""What a shell completes: names of scenarios and studies, their parameters, run folders, kinds of `mast list`.

These functions run at every press of Tab: they read file names and source text, import nothing that is slow, and
return nothing rather than fail.
"""

from __future__ import annotations

import ast
import os
import re
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from mast_zenoh.config import bundle
from mast_zenoh.show.formats import FORMATS

_MAX_FOLDERS = 50
#: What may go into a command line: a shell would run other names.
_WORD = re.compile(r"[\w@.-]+")
_RUN = "run.json"  # of every run folder
#: What `mast list` lists; a test compares it with `api.catalogue`, which is slow to load.
KINDS = (
    *("attacks", "trackers", "fusion", "defences", "scenes", "links", "faults", "metrics", "drivers"),
    *("rules", "redundancy", "congestion", "channel", "awareness", "codecs", "messages", "scenarios", "studies"),
)

Completer = Callable[[Any, list[str], str], list[str]]


def _safe(candidates: Callable[[Any, str], Iterable[str]]) -> Completer:
    """A completer for Typer: the candidates that begin with the word so far; none if anything fails."""

    def complete(ctx: Any, args: list[str], incomplete: str) -> list[str]:
        try:
            return [each for each in candidates(ctx, incomplete) if each.startswith(incomplete)]
        except Exception:  # a message would be printed into the command line that is being written
            return []

    complete.__doc__ = candidates.__doc__
    return complete


@_safe
def scenarios(ctx: Any, incomplete: str) -> Iterator[str]:
    """Shipped scenarios, and Python files."""
    yield from _shipped("scenarios")
    yield from _files(incomplete)


@_safe
def studies(ctx: Any, incomplete: str) -> Iterator[str]:
    """Shipped studies, and Python files."""
    yield from _shipped("studies")
    yield from _files(incomplete)


@_safe
def settings(ctx: Any, incomplete: str) -> Iterable[str]:
    """`NAME=` for each launch-time parameter of the scenario or study on the command line."""
    kind = "studies" if ctx.info_name == "study" else "scenarios"
    for word in _words():
        if parameters := _parameters(kind, word):
            return [f"{name}=" for name in parameters]
    return []


@_safe
def run_folders(ctx: Any, incomplete: str) -> Iterator[str]:
    """Run folders, the newest of `runs` first, and folders on the way to one."""
    if not incomplete:
        newest = sorted(Path("runs").glob(f"*/{_RUN}"), key=lambda path: path.stat().st_mtime, reverse=True)
        yield from (str(path.parent) for path in islice(newest, _MAX_FOLDERS))
    for path in _beginning_with(incomplete):
        if path.is_dir():
            yield str(path) if (path / _RUN).is_file() else f"{path}/"


@_safe
def against(ctx: Any, incomplete: str) -> Iterator[str]:
    """`twin`, and run folders."""
    yield "twin"
    yield from run_folders(ctx, [], incomplete)


@_safe
def logged_nodes(ctx: Any, incomplete: str) -> Iterator[str]:
    """The nodes of the run on the command line that have a log."""
    names = sorted(path.stem for path in (Path(ctx.params["run_folder"]) / "logs").glob("*.log"))
    yield from (name for name in names if _WORD.fullmatch(name))


@_safe
def kinds(ctx: Any, incomplete: str) -> Iterable[str]:
    """What `mast list` lists."""
    return KINDS


@_safe
def formats(ctx: Any, incomplete: str) -> Iterable[str]:
    """The formats of `mast export`."""
    return FORMATS


def _words() -> list[str]:
    """The words of the command line: an option that lacks its value keeps Typer from reading the arguments."""
    variables = ("_TYPER_COMPLETE_ARGS", "COMP_WORDS")  # of zsh and fish; of bash
    return next((os.environ[name].split() for name in variables if os.environ.get(name)), [])


def _shipped(kind: str) -> list[str]:
    return [name.removesuffix(".py") for name in bundle.names(kind) if name.endswith(".py") and name[0] != "_"]


def _files(incomplete: str) -> Iterator[str]:
    """Python files, and folders, whose path begins with the word so far."""
    for path in _beginning_with(incomplete) if incomplete else Path().glob("*.py"):
        if path.is_dir():
            yield f"{path}/"
        elif path.suffix == ".py":
            yield str(path)


def _beginning_with(incomplete: str) -> list[Path]:
    """Visible files and folders whose path begins with the word so far."""
    folder, _, begun = incomplete.rpartition("/")
    place = Path(f"{folder}/") if "/" in incomplete else Path()
    return sorted(path for path in place.iterdir() if path.name.startswith(begun) and path.name[0] != ".")


def _parameters(kind: str, name: str) -> list[str]:
    """The parameters of a scenario's or study's function, read without running its file."""
    path = Path(name) if Path(name).is_file() else bundle.find(kind, f"{name.removesuffix('.py')}.py")
    if path is None:
        return []
    function = {"scenarios": "scenario", "studies": "study"}[kind]
    for statement in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(statement, ast.FunctionDef) and statement.name == function:
            arguments = statement.args
            return [each.arg for each in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)]
    return []
