"""`mast intercept` and `mast release`: commands that change the wiring of a run while it goes on."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from mast_zenoh.cli.options import out as _out

RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="The folder of a run that goes on.")]


def intercept(
    run_folder: RunFolder,
    wire: Annotated[str, typer.Option(help="The wire to sit on: agent/infra_2/tracks.")],
    node: Annotated[str, typer.Option("--with", metavar="NODE.py", help="A node's file, or the name of one of ours.")],
    name: Annotated[str | None, typer.Option(help="Of the new node. Default: its file's, with a number.")] = None,
    input: Annotated[str | None, typer.Option(metavar="PORT", help="Where it takes the wire's messages.")] = None,
    output: Annotated[str | None, typer.Option(metavar="PORT", help="Where it passes them on.")] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="A parameter of the node, or a dotted path.")
    ] = None,
) -> None:
    """Put a node on a wire of a run that goes on: no message is lost, doubled or out of order."""
    from mast_zenoh.launch.interception import client

    done = client.intercept(run_folder, wire, node, name=name, input=input, output=output, settings=settings or ())
    _say_done(f"{done['node']} is on", done)


def release(
    run_folder: RunFolder,
    name: Annotated[str | None, typer.Option(help="The node to take off its wires.")] = None,
    wire: Annotated[str | None, typer.Option(help="Or the wire whose only node is meant.")] = None,
) -> None:
    """Take a node off its wires while the run goes on, when it has passed on what it got."""
    from mast_zenoh.launch.interception import client

    if (name is None) == (wire is None):
        raise typer.BadParameter("say --name or --wire", param_hint="--name / --wire")
    done = client.release(run_folder, name=name, wire=wire)
    _say_done(f"{done['node']} is off", done)


def _say_done(what: str, done: dict[str, Any]) -> None:
    where = ", ".join(done["wires"])
    _out.print(
        f"{what} {where} from frame {done['frame']} on ({done['took_ms']:.1f} ms)", markup=False, highlight=False
    )
