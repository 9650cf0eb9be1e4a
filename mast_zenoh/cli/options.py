"""Code shared by commands: options, the two consoles, output of results."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.core import TyperCommand

from mast_zenoh.cli import completion
from mast_zenoh.errors import DiskFull, HandlerFailed, Interrupted, NotComparable, RunFolderError
from mast_zenoh.launch import ending
from mast_zenoh.mesh.security import levels

if TYPE_CHECKING:
    from mast_zenoh.cli.console import PlainConsole
    from mast_zenoh.config.loading import AllowedCode
    from mast_zenoh.launch.run import EndedRun
    from mast_zenoh.runs.run import Run
    from mast_zenoh.show.comparison import Reference


# Rich is imported when something is printed: it takes a fifth of the time of `mast --help`.
@cache
def out() -> PlainConsole:
    """The console of standard output."""
    from mast_zenoh.cli.console import PlainConsole

    return PlainConsole(soft_wrap=True)


@cache
def err() -> PlainConsole:
    """The console of standard error."""
    from mast_zenoh.cli.console import PlainConsole

    return PlainConsole(stderr=True, soft_wrap=True)


def run_argument(help: str, metavar: str = "RUN") -> Any:
    """An argument with the folder of a run."""
    return typer.Argument(metavar=metavar, help=help, autocompletion=completion.run_folders)


RunPath = Annotated[Path, run_argument("The folder of a run.")]
RouterEndpoint = Annotated[
    str | None, typer.Option("--endpoint", help="Address of a running Zenoh router, tcp/HOST:PORT.")
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="A launch-time parameter, or a dotted path.",
        autocompletion=completion.settings,
    ),
]
Scenario = Annotated[
    str,
    typer.Argument(
        help="A scenario file, or the name of a shipped one: baseline, uncoordinated, …",
        autocompletion=completion.scenarios,
    ),
]
Out = Annotated[Path | None, typer.Option(help="Folder for the results; new or empty. Default: runs/NAME-TIME.")]
Frames = Annotated[int | None, typer.Option(min=1, help="How many frames to play.")]
Seed = Annotated[int | None, typer.Option(min=0, help="Seed of all random draws.")]
Secure = Annotated[
    Literal["open", "tls", "mtls", "acl"],
    typer.Option("--secure", metavar="[LEVEL]", help="Secure the mesh: tls, mtls, or acl (the default level)."),
]
Mode = Annotated[Literal["lockstep", "realtime"] | None, typer.Option(help="Exact, or paced by the clock.")]
Runtime = Annotated[Literal["mesh", "inproc"], typer.Option(help="Processes on a mesh, or one process.")]
Rate = Annotated[float | None, typer.Option(help="Real time: speed relative to the wall clock.")]
Against = Annotated[
    str | None,
    typer.Option(
        metavar="RUN|twin",
        help="Compare with another run, or with the same run without its adversaries.",
        autocompletion=completion.against,
    ),
]
Report = Annotated[bool, typer.Option(help="Whether to write report.html and the figures.")]
AllowChurn = Annotated[
    bool, typer.Option("--allow-churn", help="Only warn when a node is lost unexpectedly in lock-step.")
]
AllowFailures = Annotated[bool, typer.Option("--allow-failures", help="Only warn when a handler of a node fails.")]
Record = Annotated[bool, typer.Option(help="Whether to write every message to messages.mcap.")]
RecordStudy = Annotated[
    bool, typer.Option("--record", help="Write every message to messages.mcap; keep the runs of all trials.")
]


Confirmed = Annotated[
    bool, typer.Option("--trust", help="Run the code, and contact the hosts, that the run folder names.")
]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="Print warnings and errors only, to standard error; name the --out.")
]


class SecureCommand(TyperCommand):
    """A command whose option `--secure` may have no value."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Insert the default level after `--secure` without a value."""
        completed = list(args)
        for index, (word, following) in enumerate(pairwise([*args, ""])):
            if word == "--secure" and following.isalpha() and get_close_matches(following.lower(), levels.LEVELS):
                levels.check(following)
            if word == "--secure" and following not in levels.LEVELS:
                completed[index] = f"--secure={levels.SECURE}"
        return super().parse_args(ctx, completed)


def refuse(present: object, problem: str, hint: str | None = None) -> None:
    """Raise a usage error for a problem, if it is present; hint: the option."""
    if present:
        raise typer.BadParameter(problem, param_hint=hint)


def check_environment(runtime: str, mode: str, secure: str, endpoint: str | None, *, viewed: bool = False) -> None:
    """Raise a usage error for options that exclude each other."""
    alone = runtime == "inproc"
    latency = "real time needs the mesh: a single process has no network latency"
    refuse(alone and mode == "realtime", latency, "--mode")
    observed = "a single process has no mesh to observe: view the run when it has finished (mast view RUN)"
    refuse(alone and viewed, observed, "--view")
    reason = f"the router at {endpoint} belongs to another process" if endpoint else "one process has no mesh"
    refuse(secure != "open" and (alone or endpoint), f"a secure mesh has its own router: {reason}", "--secure")


def conclude(finished: EndedRun, *, report: bool, against: str | None = None, allow_failures: bool = False) -> None:
    """Show a run's results, compared with another run if named, and raise its error.

    If the comparison is not possible, results are still shown, and the run's own error is raised first. Failed handlers
    of a twin count as a failure of the run unless that is allowed.
    """
    try:
        with reporting(finished.folder, complete=finished.error is None):
            refusal, reference = _show(finished, report=report, against=against)
    except (RunFolderError, DiskFull) as error:
        if finished.error:
            err().warn(str(error))
            raise finished.error from None
        raise
    if finished.error:
        if refusal:
            err().warn(f"not compared: {refusal}")
        raise finished.error
    if refusal:
        raise refusal
    if reference is not None and against == "twin" and not allow_failures:
        _raise_failure(reference)


@contextmanager
def silenced(quiet: bool) -> Iterator[None]:
    """Print nothing to standard output in this block, if `quiet`."""
    out().quiet = quiet
    try:
        yield
    finally:
        out().quiet = False


@contextmanager
def reporting(folder: Path, command: str = "report", *, complete: bool = True) -> Iterator[None]:
    """Turn errors of report writing into errors with the command that repeats it.

    complete: whether the run did not fail
    Raises RunFolderError for results that cannot be reported: a user's evaluator may return anything.
    """
    kept = "are complete except for the report" if complete else "are those of a failed run, without a report"
    hint = f"the results in {folder} {kept}: `mast {command} {folder}` writes it"
    try:
        yield
    except (KeyboardInterrupt, OSError) as exception:
        raise ending.with_hint(exception, hint) from None
    except (TypeError, ValueError, LookupError, AttributeError, ArithmeticError) as exception:
        from mast_zenoh.mesh.control import failures  # decodes messages: commands that run nothing do not load it

        description = failures.described(exception)
        raise RunFolderError(f"{folder}: the evaluator's results cannot be reported: {description}") from exception


def _show(finished: EndedRun, *, report: bool, against: str | None) -> tuple[RunFolderError | None, Reference | None]:
    """Show a run's results; returns (why it was not compared, the reference run)."""
    from mast_zenoh.runs.run import Run
    from mast_zenoh.show import terminal
    from mast_zenoh.show.findings import found_in

    scored = (finished.folder / "metrics.json").is_file()
    run = Run(finished.folder)
    reference, refusal = None, None
    if against is not None and scored:
        reference, refusal = _reference(run, against, interrupted=isinstance(finished.error, Interrupted))
    found = found_in(run, reference) if scored or report else {}
    if scored:
        terminal.show_loaded(out(), run, reference, found)
    if report:
        from mast_zenoh.show import html  # drawing libraries are slow to load

        out().plain(f"report: {html.write_page(run, reference=reference, found=found)}")
    else:
        out().plain(f"run folder: {finished.folder}")
    show_notices(finished)
    return refusal, reference


def _reference(run: Run, against: str, *, interrupted: bool) -> tuple[Reference | None, RunFolderError | None]:
    """The run to compare with, or why that is not possible."""
    from mast_zenoh.config.loading import OWN_RUN
    from mast_zenoh.show import comparison

    if interrupted:
        return None, NotComparable(f"{run.path}: was interrupted: expected a finished run")
    try:
        return comparison.reference(run, reference_folder(run.path, against, OWN_RUN)), None
    except RunFolderError as error:
        return None, error


def _raise_failure(reference: Reference) -> None:
    """Raise HandlerFailed if handlers of the reference run have failed."""
    record = reference.run.files.record
    if record.get("status") == "handler_failures":
        raise HandlerFailed(f"{reference.name} ({reference.run.path}): {record.get('message')}")


def check_reference(against: str | None) -> None:
    """Raise NotComparable unless `--against` is missing, `twin`, or the folder of a run with results."""
    if against is None or against == "twin":
        return
    from mast_zenoh.run_folder import json_or_empty

    folder = Path(against)
    expected = "expected the folder of a run with results, or twin"
    if not folder.is_dir():
        raise NotComparable(f"{folder}: found {'a file' if folder.exists() else 'no such folder'}: {expected}")
    if not any((folder / name).is_file() for name in ("run.json", "scenario.json")):
        raise NotComparable(f"{folder}: has no run.json: {expected}")
    if not (folder / "metrics.json").is_file():
        raise NotComparable(f"{folder}: has no metrics.json: {expected}")
    if not json_or_empty(folder / "metrics.json").get("agents"):
        raise NotComparable(f"{folder}: has a damaged metrics.json: {expected}")


def allowed_code(*named: str | Path | None, confirmed: bool) -> AllowedCode:
    """The code that may run: files that this command line names, and with --trust all; those are printed."""
    from mast_zenoh.config.loading import AllowedCode  # the classes of all nodes are slow to load

    def announce(sentence: str) -> None:
        err().print(sentence, style="yellow", markup=False, highlight=False)

    return AllowedCode.of(*named, confirmed=confirmed, announce=announce)


def with_trust(words: list[str]) -> str:
    """A command with --trust; words: without `mast`."""
    at = words.index("--") if "--" in words else len(words)
    return shlex.join(["mast", *words[:at], "--trust", *words[at:]])


def reference_folder(run_folder: Path, against: str, allowed: AllowedCode) -> Path:
    """The folder of the reference run; an unattacked twin runs first if needed.

    allowed: which of the code that the run folder names may run
    """
    from mast_zenoh.launch import twin

    return twin.of(run_folder, out(), allowed) if against == twin.FOLDER else Path(against)


def show_notices(finished: EndedRun, label: str = "") -> None:
    """Print a run's notices, and handler failures that its error does not name.

    Notices are warnings: if nothing else is printed, they go to standard error.
    """
    from mast_zenoh.run_folder.finding import notice_lines

    notices = notice_lines(finished.record)
    if finished.record["message"] and not finished.error:
        notices.append(f"note: {finished.record['message']}")
    for notice in notices:
        (err() if out().quiet else out()).print(f"{label}{notice}", style="yellow", markup=False, highlight=False)
    if finished.failures and not isinstance(finished.error, HandlerFailed):
        from mast_zenoh.mesh.control import failures

        warning = failures.summary(finished.failures, finished.logs)
        err().warn(warning, label)
