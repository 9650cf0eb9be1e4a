"""`mast replay`: a recorded run, put back on a mesh for live nodes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from mast_zenoh.cli import completion
from mast_zenoh.cli.options import (
    AllowChurn,
    AllowFailures,
    Confirmed,
    Frames,
    Mode,
    Out,
    Rate,
    Record,
    Report,
    Runtime,
    Secure,
    allowed_code,
    check_environment,
    check_reference,
    conclude,
)
from mast_zenoh.cli.options import err as _err
from mast_zenoh.cli.options import out as _out


def replay(
    run_folder: Annotated[
        Path, typer.Argument(metavar="RUN", help="The folder of a recorded run.", autocompletion=completion.run_folders)
    ],
    place: Annotated[
        Literal["agents", "simulator"],
        typer.Option("--from", help="Play what the agents sent, or what the simulator sent. All after it is live."),
    ] = "agents",
    scenario: Annotated[
        str | None,
        typer.Option(
            metavar="FILE", help="A scenario file; its broker, command centre, evaluator and agents are live."
        ),
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="A setting of a live node, as a dotted path.")
    ] = None,
    frames: Frames = None,
    loop: Annotated[bool, typer.Option("--loop", help="Repeat the recording until Ctrl-C, or --times.")] = False,
    times: Annotated[int | None, typer.Option(min=1, help="How often to play the recording.")] = None,
    runtime: Runtime = "mesh",
    mode: Mode = None,
    rate: Rate = None,
    out: Out = None,
    endpoint: Annotated[str | None, typer.Option(help="Address of a running Zenoh router, tcp/HOST:PORT.")] = None,
    secure: Secure = "open",
    report: Report = True,
    record: Record = True,
    allow_failures: AllowFailures = False,
    allow_churn: AllowChurn = False,
    against: Annotated[
        str | None, typer.Option(metavar="RUN", help="Compare with another run, such as the recorded one.")
    ] = None,
    confirmed: Confirmed = False,
) -> None:
    """Play a recorded run to live nodes, such as a changed command centre.

    Lock-step, or real time with --rate. Without changes, a lock-step recording gives the recorded picture.
    """
    from mast_zenoh import replay as replays
    from mast_zenoh.launch import run as launcher

    if against == "twin":
        raise typer.BadParameter(
            "a replay has no twin: expected the recorded run, or another one", param_hint="--against"
        )
    check_reference(against)
    if mode == "lockstep" and rate is not None:
        raise typer.BadParameter("lock-step waits for every node: expected --mode realtime", param_hint="--rate")
    chosen = mode or ("lockstep" if rate is None else "realtime")
    check_environment(runtime, chosen, secure, endpoint)
    files = [value for _, is_set, value in (item.partition(".file=") for item in settings or ()) if is_set]
    prepared = replays.resolve(
        run_folder,
        place,
        scenario=scenario,
        settings=settings or (),
        frames=frames,
        repeats=times or (None if loop else 1),
        mode=chosen,
        rate=1.0 if rate is None else rate,
        record=record,
        allowed=allowed_code(scenario, *files, confirmed=confirmed),
    )
    for line in prepared.lines():
        _out.print(line, markup=False, highlight=False)
    for notice in prepared.notices:
        _err.print(f"warning: {notice}", style="bold yellow", markup=False, highlight=False)
    environment: dict[str, Any] = {"runtime": runtime, "endpoint": endpoint, "secure": secure}
    allowed: dict[str, Any] = {"allow_failures": allow_failures, "allow_churn": allow_churn}
    finished = launcher.run(prepared.resolved, out, **environment, **allowed, console=_out, replay=prepared.record())
    conclude(finished, report=report, against=against, allow_failures=allow_failures)
