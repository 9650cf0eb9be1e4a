"""`mast deploy …`: runs in containers or on other hosts; `mast doctor`: checks."""

from __future__ import annotations

import inspect
import os
from pathlib import Path
from typing import Annotated, Any

import typer

from mast_zenoh.cli import options
from mast_zenoh.cli.options import out as _out
from mast_zenoh.errors import RunFolderError

app = typer.Typer(help="Run a scenario in containers or on other hosts.", no_args_is_help=True, add_completion=False)

Engine = Annotated[
    str,
    typer.Option(metavar="NAME|FILE", help="Where the nodes run: compose, ssh, or the file of your own engine."),
]


@app.command(cls=options.SecureCommand)
def up(
    scenario_file: options.Scenario,
    settings: options.Settings = None,
    engine: Engine = "compose",
    frames: options.Frames = None,
    seed: options.Seed = None,
    mode: options.Mode = None,
    rate: options.Rate = None,
    out: options.Out = None,
    secure: options.Secure = "open",
    image: Annotated[
        str | None, typer.Option(help="Image of all containers. Default: the one built by `mast deploy image`.")
    ] = None,
    hosts: Annotated[Path | None, typer.Option(help="SSH: file with the hosts. Default: deploy/hosts.toml.")] = None,
    option: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="A parameter of the engine, such as your own engine's."),
    ] = None,
    patience: Annotated[float | None, typer.Option(help="Seconds that nodes run without this launcher.")] = None,
    report: options.Report = True,
    record: options.Record = True,
    allow_failures: options.AllowFailures = False,
    allow_churn: options.AllowChurn = False,
) -> None:
    """Run a scenario in containers or on other hosts, collect results and clean up."""
    from mast_zenoh import scenario
    from mast_zenoh.deploy import engines
    from mast_zenoh.deploy.engine import check_space, needed_space
    from mast_zenoh.launch import run

    path, loaded = scenario.load(scenario_file, settings or ())
    resolved = scenario.resolve(path, loaded, seed=seed, frames=frames, mode=mode, rate=rate, record=record)
    chosen = {"image": image, "hosts": hosts, "patience_s": patience}
    kind = engines.load(engine)
    parameters = {name: value for name, value in chosen.items() if value is not None}
    accepted = inspect.signature(kind).parameters
    for name in parameters:
        options.refuse(name not in accepted, f"engine {kind.name} has no such option", f"--{name.removesuffix('_s')}")
    platform = engines.make(kind, parameters | engines.options(kind, option or ()))
    check_space(out or Path("runs"), needed_space(resolved))
    allowed: dict[str, Any] = {"allow_failures": allow_failures, "allow_churn": allow_churn}
    finished = run.run(resolved, out, engine=platform, secure=secure, **allowed, console=_out())
    options.conclude(finished, report=report)


RunName = Annotated[str, typer.Option("--run", help="Id of the run.")]


@app.command(cls=options.SecureCommand)
def write(
    scenario_file: options.Scenario,
    settings: options.Settings = None,
    frames: options.Frames = None,
    secure: options.Secure = "open",
    image: Annotated[str | None, typer.Option(help="Image of the nodes; the launcher's is IMAGE-launcher.")] = None,
    run: Annotated[str | None, typer.Option(help="Name of the run. Default: that of the scenario.")] = None,
) -> None:
    """Print a compose file that plays a scenario by itself with `docker-compose up`."""
    from mast_zenoh import scenario
    from mast_zenoh.deploy import compose_inside as inside
    from mast_zenoh.deploy import documents
    from mast_zenoh.deploy.docker import TAG

    path, loaded = scenario.load(scenario_file, settings or ())
    resolved = scenario.resolve(path, loaded, frames=frames, record=True)
    inside.check_steps(resolved)
    own = scenario_file.endswith(".py")
    launcher = documents.Launcher(
        str(path) if own else scenario_file, tuple(settings or ()), folder=str(path.parent) if own else None
    )
    more: dict[str, Any] = {"secure": secure, "patience_s": inside.PATIENCE_S, "launcher": launcher}
    name = resolved.name if run is None else scenario.checked_name(run, "--run")
    typer.echo(documents.compose_text(resolved, name, image=image or TAG, **more), nl=False)


@app.command(hidden=True)
def join(
    scenario_file: options.Scenario,
    endpoint: Annotated[str, typer.Option(help="Of the router.")],
    run: RunName,
    settings: options.Settings = None,
    frames: options.Frames = None,
    secure: options.Secure = "open",
    credentials: Annotated[Path | None, typer.Option(help="Folder of the launcher's credentials.")] = None,
) -> None:
    """Play a run whose nodes Compose has started: the launcher of a compose file."""
    from mast_zenoh import scenario
    from mast_zenoh.deploy import compose_inside as inside
    from mast_zenoh.deploy import documents
    from mast_zenoh.launch import run as launch

    path, loaded = scenario.load(scenario_file, settings or ())
    resolved = scenario.resolve(path, loaded, frames=frames, record=True)
    with inside.joined(endpoint, run, credentials) as session:
        engine = inside.Inside(run, session, endpoint, credentials)
        finished = launch.run(resolved, engine=engine, secure=secure, console=_out())
        try:
            options.conclude(finished, report=True)
        finally:
            name = documents.container(run, documents.LAUNCHER)
            _out().plain(f"results: volume {documents.project(run)}-results; get them by")
            _out().plain(f"  docker cp {name}:{finished.folder} .")


@app.command(hidden=True)
def certificates(
    scenario_file: options.Scenario,
    run: RunName,
    settings: options.Settings = None,
    secure: options.Secure = "acl",
) -> None:
    """Make the credentials of all services of a compose file, and keep them in memory."""
    from mast_zenoh import scenario
    from mast_zenoh.deploy import documents
    from mast_zenoh.deploy.compose_inside import make_credentials

    path, loaded = scenario.load(scenario_file, settings or ())
    resolved = scenario.resolve(path, loaded, frames=1, record=True)
    make_credentials(resolved, run, secure, Path(documents.KEYS))


@app.command()
def status(run_folder: options.RunPath, confirmed: options.Confirmed = False) -> None:
    """List the nodes of a run, their state and place."""
    from rich.table import Table

    kind, record = _deployed(run_folder, confirmed)
    table = Table("node", "state", "where", box=None)
    for row in kind.status(run_folder, record):
        table.add_row(row["node"], row["state"], row["where"])
    from mast_zenoh.launch import liveness

    _out().plain(f"{record['id']}: {liveness.current_record(record)['status']}")
    _out().print(table)


@app.command()
def logs(
    run_folder: options.RunPath,
    node: Annotated[str | None, typer.Argument(help="The node. Default: all.")] = None,
    follow: Annotated[bool, typer.Option("--follow", help="Continue with new output.")] = False,
    confirmed: options.Confirmed = False,
) -> None:
    """Print the logs of a run's nodes."""
    kind, record = _deployed(run_folder, confirmed)
    kind.logs(run_folder, record, node, follow=follow)


@app.command()
def down(run_folder: options.RunPath, confirmed: options.Confirmed = False) -> None:
    """Remove what is left of a run that lost its launcher or machine."""
    kind, record = _deployed(run_folder, confirmed)
    kind.down(run_folder, record)
    if record["status"] == "running":
        from mast_zenoh.run_folder import write_json

        write_json(
            run_folder / "run.json", record | {"status": "failed", "message": "taken down by `mast deploy down`"}
        )
    _out().plain(f"{record['id']}: nothing is left")


@app.command()
def image(
    base: Annotated[str | None, typer.Option(help="An image with Python 3.11 or newer and venv.")] = None,
    tag: Annotated[str | None, typer.Option(help="Name of the image.")] = None,
    launcher: Annotated[
        bool, typer.Option("--launcher", help="Also build the launcher's image, for files of `mast deploy write`.")
    ] = False,
) -> None:
    """Build the image for nodes in containers."""
    from mast_zenoh.deploy import docker as images

    base = base or images.BASE
    built = images.build_image(tag or images.TAG, base)
    added_mb = images.size_over_base(built, base) / 1e6
    _out().plain(f"image: {built}, {added_mb:.0f} MB over {base}")
    if launcher:
        _out().plain(f"image: {images.build_image(tag or images.TAG, base, launcher=True)}")


def doctor(
    credentials: Annotated[Path | None, typer.Option(help="A folder of certificates to check.")] = None,
    endpoint: Annotated[str | None, typer.Option(help="A router that the certificates are checked against.")] = None,
    report: Annotated[
        bool, typer.Option("--report", help="Print what a bug report needs, without personal data.")
    ] = False,
) -> None:
    """Check what this machine can do, and what to install for the rest.

    Exits with 0 if this machine has what runs need, 1 if not; optional parts may be missing.
    """
    from rich.markup import escape
    from rich.table import Table

    from mast_zenoh.deploy import doctor as checks

    if report and credentials is not None:
        raise typer.BadParameter("names hosts, so it cannot be in a --report", param_hint="--credentials")
    findings = list(checks.examine(credentials, endpoint))
    if report:
        _out().plain(checks.report(findings))
    else:
        table = Table("", "", "", "what to do", box=None)
        for finding in findings:
            symbol = {True: "[green]ok", False: "[red]no", None: "[yellow]--"}[finding.ok]
            table.add_row(symbol, finding.name, escape(finding.detail), escape(finding.fix))
        _out().print(table)
    raise typer.Exit(1 if any(finding.ok is False for finding in findings) else 0)


def _deployed(folder: Path, confirmed: bool) -> tuple[Any, dict[str, Any]]:
    """The engine and run.json of a run that was deployed.

    Raises UntrustedCode if the run was not started on this machine, or by an engine that does not come with mast.
    """
    from mast_zenoh.config import plugins
    from mast_zenoh.deploy import engines
    from mast_zenoh.launch import liveness
    from mast_zenoh.run_folder import read_json

    record = read_json(folder / "run.json")
    deployment = record.get("deployment")
    if deployment is None:
        raise RunFolderError(f"{folder}: was not deployed: it consists of this folder alone")
    if "engine" not in deployment or "id" not in record:
        raise RunFolderError(f"{folder / 'run.json'}: names no engine or no id, expected those of a deployed run")
    engine = str(deployment["engine"])
    allowed = options.allowed_code(confirmed=confirmed)
    places = ", ".join([engine, *(deployment.get("hosts") or ())])
    liveness.check_from_here(folder, record, allowed, f"where it was deployed: {places}")
    if match := engines.FILE.fullmatch(engine):
        confirmed_file = os.fspath(allowed.files_in(str(folder), None, [match[1]])[match[1]])
        engine = f"{confirmed_file}:{match[2]}" if match[2] else confirmed_file
    if "engine_plugin" in record:
        plugins.expect({engine: record["engine_plugin"]})
    return engines.load(engine), record
