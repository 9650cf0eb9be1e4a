"""docs/ref-command-line.md: every command with its arguments and options."""

from __future__ import annotations

import inspect
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
    group = typer.main.get_command(app)
    context = group.make_context("mast", [], resilient_parsing=True)
    return page("Command line", "mast_zenoh/cli", _INTRODUCTION, _commands(group, context))


def _commands(group: Any, context: Any) -> Iterator[str]:
    """The parts of the commands of a group, and of groups in it."""
    for name, command in group.commands.items():
        if command.hidden:
            continue
        inner = command.make_context(name, [], parent=context, resilient_parsing=True)
        if hasattr(command, "commands"):
            yield from _commands(command, inner)
            continue
        yield f"## {inner.command_path}\n\n```text\n{_usage(command, inner)}\n```\n"
        yield f"{linked(inspect.cleandoc(command.help or ''))}\n"
        records = (parameter.get_help_record(inner) for parameter in command.params)
        yield table(
            ("argument or option", "meaning"), ((f"`{names}`", words) for names, words in filter(None, records))
        )


def _usage(command: Any, context: Any) -> str:
    return str(" ".join([context.command_path, *command.collect_usage_pieces(context)]))
