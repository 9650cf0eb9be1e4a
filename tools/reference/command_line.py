"""docs/ref-command-line.md: every command with its arguments and options."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any

import typer

from mast_zenoh.cli.app import app
from reference import linked, page, table

_INTRODUCTION = """\
Look up every command here, with its arguments and options. `mast COMMAND --help` prints the same.

A command exits with 0 after success, with 2 if it was called wrongly, else with the [code](ref-exit-codes.md) of the
error that it names. `mast --install-completion` makes your shell complete commands, options and names."""


def command_line_page() -> str:
    """Every command that is not hidden."""
    return page("Command line", "mast_zenoh/cli", _INTRODUCTION, (_section(*each) for each in _commands()))


def own_exit_codes() -> Iterator[tuple[str, str]]:
    """Yield (command, what its help says of its exit codes) of those that have codes of their own."""
    for command, context in _commands():
        if found := re.search(r"^Exits with .*$", command.help or "", flags=re.MULTILINE):
            yield context.command_path, found[0]


def _commands(group: Any = None, context: Any = None) -> Iterator[tuple[Any, Any]]:
    """Yield (command, its context) of a group, by default of all commands, and of groups in it."""
    group = group or typer.main.get_command(app)
    context = context or group.make_context("mast", [], resilient_parsing=True)
    for name, command in group.commands.items():
        inner = command.make_context(name, [], parent=context, resilient_parsing=True)
        if hasattr(command, "commands"):
            yield from _commands(command, inner)
        elif not command.hidden:
            yield command, inner


def _section(command: Any, context: Any) -> str:
    records = filter(None, (parameter.get_help_record(context) for parameter in command.params))
    options = table(("argument or option", "meaning"), ((f"`{names}`", words) for names, words in records))
    words = linked(inspect.cleandoc(command.help or ""))
    return f"## {context.command_path}\n\n```text\n{_usage(command, context)}\n```\n\n{words}\n\n{options}"


def _usage(command: Any, context: Any) -> str:
    return str(" ".join([context.command_path, *command.collect_usage_pieces(context)]))
