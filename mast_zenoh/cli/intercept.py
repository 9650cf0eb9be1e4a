"""`mast intercept` and `mast release`: change the wiring during a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from mast_zenoh.cli import completion
from mast_zenoh.cli.options import Confirmed, allowed_code
from mast_zenoh.cli.options import out as _out

RunRecord = Annotated[
    Path, typer.Argument(metavar="RUN", help="The folder of a running run.", autocompletion=completion.run_folders)
]


def intercept(
    run_folder: RunRecord,
    wire: Annotated[str, typer.Option(help="The wire to intercept: agent/infra_2/tracks.")],
    node: Annotated[
        str,
        typer.Option(
            "--with", metavar="NODE.py|ATTACK", help="A node's file; or an attack: its name, FILE.py or FILE.py:CLASS."
        ),
    ],
    name: Annotated[str | None, typer.Option(help="Name of the new node. Default: its file's, with a number.")] = None,
    input: Annotated[str | None, typer.Option(metavar="PORT", help="Its input port for the wire's messages.")] = None,
    output: Annotated[str | None, typer.Option(metavar="PORT", help="Its output port for the wire's messages.")] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="A parameter of the node, or a dotted path.")
    ] = None,
    confirmed: Confirmed = False,
) -> None:
    """Insert a node into a wire during a run; no message is lost or duplicated."""
    from mast_zenoh.launch import live_interception

    result = live_interception.intercept(
        run_folder,
        wire,
        node,
        name=name,
        input=input,
        output=output,
        settings=settings or (),
        allowed=allowed_code(node.partition(":")[0], confirmed=confirmed),
    )
    _show_result(f"{result['node']} is on", result)


def release(
    run_folder: RunRecord,
    name: Annotated[str | None, typer.Option(help="The node to release.")] = None,
    wire: Annotated[
        str | None, typer.Option(help="Instead of a name: the wire whose only inserted node is released.")
    ] = None,
    confirmed: Confirmed = False,
) -> None:
    """Release a node from its wires during a run, after its messages are forwarded."""
    from mast_zenoh.launch import live_interception

    if (name is None) == (wire is None):
        raise typer.BadParameter("expected either --name or --wire", param_hint="--name / --wire")
    result = live_interception.release(run_folder, name=name, wire=wire, allowed=allowed_code(confirmed=confirmed))
    _show_result(f"{result['node']} is off", result)


def _show_result(subject: str, result: dict[str, Any]) -> None:
    wires = ", ".join(result["wires"])
    _out.print(
        f"{subject} {wires} from frame {result['frame']} on ({result['took_ms']:.1f} ms)", markup=False, highlight=False
    )
