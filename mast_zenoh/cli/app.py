"""The commands. Each one is a single call into the packages below."""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from mast_zenoh.cli import completion, deploy, options, ros2, runs, scenarios, view
from mast_zenoh.cli.options import err as _err
from mast_zenoh.cli.options import out as _out
from mast_zenoh.errors import Interrupted, MastError, UntrustedCode
from mast_zenoh.launch import ending

if TYPE_CHECKING:
    from mast_zenoh.launch.context import RunContext

app = typer.Typer(
    help="mast-zenoh: attack, break and defend collaborative sensor fusion on a Zenoh mesh.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.add_typer(deploy.app, name="deploy")
app.add_typer(scenarios.app, name="scene")
app.command()(deploy.doctor)


@app.command(cls=options.SecureCommand)
def run(
    scenario_file: options.Scenario,
    settings: options.Settings = None,
    frames: options.Frames = None,
    seed: options.Seed = None,
    runtime: options.Runtime = "mesh",
    mode: options.Mode = None,
    rate: options.Rate = None,
    out: options.Out = None,
    endpoint: options.RouterEndpoint = None,
    secure: options.Secure = "open",
    report: options.Report = True,
    record: options.Record = True,
    allow_failures: options.AllowFailures = False,
    allow_churn: options.AllowChurn = False,
    against: options.Against = None,
    shown: Annotated[bool, typer.Option("--view", help="Show the run in a browser while it is running.")] = False,
    quiet: options.Quiet = False,
    debug_protocol: Annotated[
        bool, typer.Option("--debug-protocol", help="Log every event and action of each process in logs/protocol/.")
    ] = False,
) -> None:
    """Run a scenario; results, logs and a report go to a run folder."""
    from mast_zenoh import scenario
    from mast_zenoh.config.outside_meshes import outside_meshes
    from mast_zenoh.launch import run as launcher

    options.check_reference(against)
    path, loaded = scenario.load(scenario_file, settings or ())
    resolved = scenario.resolve(path, loaded, seed=seed, frames=frames, mode=mode, rate=rate, record=record)
    options.check_environment(runtime, resolved.mode, secure, endpoint, viewed=shown)
    options.refuse(debug_protocol and runtime == "inproc", "one process has no protocol", "--debug-protocol")
    environment: dict[str, Any] = {"runtime": runtime, "endpoint": endpoint, "secure": secure}
    environment["debug_protocol"] = debug_protocol
    allowed: dict[str, Any] = {"allow_failures": allow_failures, "allow_churn": allow_churn}
    bridges = {key: mesh for key, mesh in outside_meshes().items() if loaded.get(key) is not None}
    if runtime == "inproc":
        for mesh in filter(lambda mesh: mesh.no_bridge, bridges.values()):
            _err().warn(mesh.no_bridge)
        bridges = {}
    with ExitStack() as stack:
        stack.enter_context(options.silenced(quiet))
        prepared = [stack.enter_context(view.viewer(shown))]
        prepared += [stack.enter_context(mesh.bridge(loaded[key])) for key, mesh in bridges.items()]
        console = (_err if quiet else _out)()

        def prepare(context: RunContext) -> None:
            for each in prepared:
                each(context)

        finished = launcher.run(resolved, out, **environment, **allowed, prepare=prepare, console=console, quiet=quiet)
        options.conclude(finished, report=report, against=against, allow_failures=allow_failures)


@app.command()
def study(
    study_file: Annotated[
        str,
        typer.Argument(
            help="A study file, or the name of a shipped one: case_study, …", autocompletion=completion.studies
        ),
    ],
    settings: options.Settings = None,
    trials: Annotated[int | None, typer.Option(min=1, help="Seeds for each configuration and scene.")] = None,
    candidates: Annotated[
        int | None, typer.Option(min=1, help="How many choices of attack parameters a search tries.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Concurrent trials; all cores if dask is installed.")] = None,
    cluster: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Address of a Dask scheduler, tcp://HOST:8786.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the unfinished study in --out.")] = False,
    frames: options.Frames = None,
    seed: options.Seed = None,
    runtime: Annotated[Literal["mesh", "inproc"] | None, typer.Option(help="Overrides the study's runtime.")] = None,
    out: options.Out = None,
    record: options.RecordStudy = False,
    allow_failures: options.AllowFailures = False,
) -> None:
    """Run the scenarios of a study and compare them.

    Each runs once, with a report, or as many trials, with intervals.

    A study with a search (`search`) first looks for the attack parameters that harm most.
    """
    from mast_zenoh.study import definition

    loaded = definition.load(study_file, settings or ())
    chosen: dict[str, Any] = {"trials": trials, "candidates": candidates, "jobs": jobs}
    chosen |= {"cluster": cluster, "resume": resume, "record": record, "allow_failures": allow_failures}
    if loaded.security:
        words = {**chosen, "runtime": runtime == "inproc"}
        invalid = ", ".join(f"--{name.replace('_', '-')}" for name, value in words.items() if value)
        problem = f"attackers run once at each level, on the mesh: expected no {invalid}"
        options.refuse(invalid, problem, study_file)
        from mast_zenoh.study import attacked_run

        folder, tables = attacked_run.compare(loaded.chosen(seed=seed, frames=frames), out, console=_out())
        _out().print(tables.as_rich())
        for name in attacked_run.FILES:
            _out().plain(str(folder / name))
        return
    from mast_zenoh.study import interface

    finished = interface.run(loaded, out, **chosen, frames=frames, seed=seed, runtime=runtime, console=_out())
    if isinstance(finished, interface.ComparisonResult):
        with options.reporting(finished.out):
            from mast_zenoh.show import html, terminal  # after the runs: drawing libraries are slow to load

            terminal.show(_out(), finished.folders)
            if driven := finished.drive():
                terminal.show_driven(_out(), *driven)
            _out().plain(f"report: {html.write_study_report(finished.out, finished.folders, driven=driven)}")
        for label, run_ in finished.runs.items():
            options.show_notices(run_, f"{label}: ")
    else:
        _out().print(finished.as_rich())
        for path in (*finished.files, f"report: {finished.report}"):
            _out().plain(path)
    finished.raise_failures()


@app.command()
def diff(
    run_a: Annotated[Path, options.run_argument("The folder of a run, or a recording.", "A")],
    run_b: Annotated[Path, options.run_argument("Another one.", "B")],
    wire: Annotated[list[str] | None, typer.Option(metavar="GLOB", help="Wires to compare: cc/picture.")] = None,
    ignore: Annotated[list[str] | None, typer.Option(metavar="GLOB", help="Wires to leave out: 'attack/*'.")] = None,
    taps: Annotated[bool, typer.Option("--taps", help="Compare the hidden legs of intercepted wires too.")] = False,
) -> None:
    """Compare the messages of two runs.

    Exits with 0 if the runs are equal, 1 if they differ, 2 if they cannot be compared.
    """
    from mast_zenoh.run_folder.recording.churn import comparable
    from mast_zenoh.run_folder.recording.difference import compare, explain

    try:
        before, reason = comparable(run_a, run_b)
        difference = compare(run_a, run_b, wires=wire or ("*",), ignore=ignore or (), taps=taps, before=before)
    except MastError as error:
        _err().plain(f"cannot compare: {error}")
        raise typer.Exit(2) from None
    for line in explain(difference):
        _out().plain(line)
    if reason and difference.first is None:
        _err().plain(f"not comparable from frame {before} onwards: {reason}")
        raise typer.Exit(2)
    raise typer.Exit(0 if difference.first is None else 1)


app.command()(scenarios.wiring)
app.command("list")(scenarios.list_kind)
app.command()(runs.export)
app.command(cls=options.SecureCommand)(runs.replay)
app.command()(view.view)
app.command("ros2")(ros2.ros2)
app.command()(runs.animate)
app.command()(runs.snapshot)
app.command()(runs.logs)
app.command()(runs.intercept)
app.command()(runs.release)
app.command()(runs.report)


def carry_out() -> int:
    """Run the command; returns its exit code (docs/ref-exit-codes.md)."""
    os.umask(os.umask(0o022) | 0o022)  # only this user may change a run's files; its nodes inherit the umask
    try:
        app(prog_name="mast")
    except SystemExit as exit_:
        if exit_.code == Interrupted.exit_code:  # Typer's, for a KeyboardInterrupt
            return _show(Interrupted("stopped before anything was started, or left running"))
        return exit_.code if isinstance(exit_.code, int) else int(exit_.code is not None)
    except (Exception, KeyboardInterrupt) as exception:
        error = ending.from_exception(exception)
        if error is None:
            raise
        return _show(error)
    return 0


def _show(error: MastError) -> int:
    _err().print(f"[bold red]error:[/] {type(error).__name__}:", end=" ")
    hint = f": {options.with_trust(sys.argv[1:])}" if isinstance(error, UntrustedCode) else ""
    _err().plain(f"{error}{hint}")
    return error.exit_code


def main() -> None:
    """Run the command, and exit with its code."""
    sys.exit(carry_out())
