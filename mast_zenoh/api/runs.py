"""Runs from Python: `mast.run`, and `mast.Run`, a run with what shows it."""

from __future__ import annotations

import html
import inspect
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from mast_zenoh import scenario as scenarios
from mast_zenoh.config import loading, registry
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError, HandlerFailed, NodeLost, RunFolderError, nearest
from mast_zenoh.launch import run as launcher
from mast_zenoh.run_folder import reading
from mast_zenoh.runs.run import Run

if TYPE_CHECKING:
    from mast_zenoh.run_folder.finding import Finding
    from mast_zenoh.show.export import Exported
    from mast_zenoh.show.figures.plots import Plots
    from mast_zenoh.show.film.takes import Look


class OpenedRun(Run):
    """A run folder as an object, of a finished run or one in progress.

    Its tables, and what is drawn and written, are of the moment in which they are asked for.

    path: its folder

    Raises RunFolderError if there is no run folder; a property raises it if its file is missing.
    """

    def __init__(self, path: str | Path) -> None:
        if not (Path(path) / "run.json").is_file():
            raise RunFolderError(f"{path}: no run.json there: expected the folder of a run, such as runs/NAME-TIME")
        super().__init__(Path(path).resolve())

    @property
    def headline(self) -> str:
        """The run in one sentence; of a run that was compared, without the comparison.

        Collisions of cars come first, then the largest change that adversaries or faults made.
        """
        from mast_zenoh.show.findings import headline

        with reading(self.path):
            return f"{headline(self._now())}."

    @property
    def findings(self) -> list[Finding]:
        """What the report says, as data, in its order: what failed, what changed and why, what adversaries did."""
        from mast_zenoh.show.findings import findings

        with reading(self.path):
            return findings(self._now())

    @property
    def plot(self) -> Plots:
        """The report's figures: `run.plot.birdseye(frame=64)`, `run.plot.over_time("fp")`."""
        from mast_zenoh.show.figures.plots import Plots

        return Plots({self.name: self._now()})

    def report(self, frame: int | None = None, against: OpenedRun | None = None) -> Path:
        """Write report.html and its figures into the folder; returns its path.

        frame: the frame that figures show;  against: another run of the same scene and seed, to compare with
        """
        from mast_zenoh.show import html as page

        with reading(self.path):
            return page.write_report(self.path, frame, None if against is None else against.path)

    def export(self, to: str, out: str | Path) -> Exported:
        """Write the finished run in another format (docs/how-to-export.md).

        to: a format of that page;  out: a new file or folder

        Returns the paths that were written, and what the run's record lacks. Raises ExportError for a package that is
        not installed or a path that exists, RunFolderError for a run in progress or a damaged recording.
        """
        from mast_zenoh.show.export import export

        with reading(self.path):
            return export(self.path, to, Path(out))

    def animate(
        self,
        out: str | Path,
        *,
        against: OpenedRun | None = None,
        start: int | None = None,
        end: int | None = None,
        speed: float = 1.0,
        fps: float | None = None,
        **look: Any,
    ) -> Path:
        """Write a film of the finished run (docs/how-to-export.md#films-and-figures); returns its path.

        out:        a new file that ends with .mp4, .gif or .webm;  against: another run to show beside it
        start, end: first and last frame, by default of the run, at most 3000;  speed: over that of the scene
        fps:        images per second
        look:       agent, estimates, camera, window, theme, size, dpi, plain, title, captions

        Raises ExportError for the file or without ffmpeg, RunFolderError for a run in progress or a frame that the run
        does not have, ConfigurationError for an invalid option.
        """
        from mast_zenoh.show.film import writing

        options: dict[str, Any] = {"start": start, "end": end, "speed": speed, "fps": fps}
        other = None if against is None else against.path
        with reading(self.path):
            writing.animate(self.path, Path(out), _look(look), other, **options)
        return Path(out)

    def snapshot(
        self, out: str | Path, frame: int | None = None, *, against: OpenedRun | None = None, **look: Any
    ) -> Path:
        """Write one frame of the finished run as a figure, on light ground; returns its path.

        out:   a new file that ends with .pdf, .svg or .png;  frame: None: the one that the report shows
        Further parameters and errors are those of `animate`.
        """
        from mast_zenoh.show.film import writing

        other = None if against is None else against.path
        with reading(self.path):
            writing.snapshot(self.path, Path(out), _look({"theme": "light", **look}), frame, other)
        return Path(out)

    def _now(self) -> Run:
        """The run as it is now."""
        return Run(self.path)

    def __repr__(self) -> str:
        return f"<Run {self.id}: {self._facts()}; {self.path}>"

    def _repr_html_(self) -> str:
        words = html.escape(f"{self.headline} Folder: {self.path}")
        return f"<p><b>{html.escape(self.id)}</b> ({html.escape(self._facts())})<br>{words}</p>"

    def _facts(self) -> str:
        return f"{self.status}, {self.record.get('frames')} frames, seed {self.seed}, {self.record.get('runtime')}"


def _look(options: dict[str, Any]) -> Look:
    """The options of a film; raises ConfigurationError for an unknown one."""
    from mast_zenoh.show.film.takes import Look

    known = [field.name for field in fields(Look)]
    if unknown := [name for name in options if name not in known]:
        raise ConfigurationError(f"no option {unknown[0]!r}{nearest(unknown[0], known)}")
    if isinstance(options.get("estimates"), str):
        options = options | {"estimates": (options["estimates"],)}
    return Look(**options)


#: Types of the argument `scenario`: a name or file, a dict, or a function that returns one.
Scenario = str | Path | Mapping[str, Any] | Callable[..., Mapping[str, Any]]


def run(
    scenario: Scenario,
    *,
    frames: int | None = None,
    seed: int | None = None,
    out: str | Path | None = None,
    runtime: Literal["inproc", "mesh"] = "inproc",
    mode: Literal["lockstep", "realtime"] | None = None,
    rate: float | None = None,
    record: bool = True,
    report: bool = False,
    endpoint: str | None = None,
    secure: Literal["open", "tls", "mtls", "acl"] = "open",
    allow_failures: bool = False,
    allow_churn: bool = False,
    **parameters: Any,
) -> OpenedRun:
    """Run a scenario, and return the run with its tables, messages and plots.

    scenario:   name of a shipped scenario (`mast.list("scenarios")`), a file, a dict, or a function that returns one
    parameters: arguments of the scenario's function; a dotted key sets a value in the dict that it returns:
                `**{"command_center.pipeline.clustering.assign_radius": 3.0}`
    frames:     number of frames to play; None: all frames of the scene;  seed: of all random draws
    out:        folder for the results, new or empty; None: runs/NAME-TIME below the current directory
    runtime:    "inproc": everything in this process; "mesh": a process for each node
    mode, rate: "lockstep" is exact; "realtime" follows the clock, `rate` times faster, and needs the mesh
    record:     write every message, for `Run.messages`, `.truth` and `.picture`
    report:     also write report.html
    endpoint:   address of a running Zenoh router, tcp/HOST:PORT
    secure:     security level of the mesh: certificates and access control (docs/explanation-security.md)
    allow_failures, allow_churn: count a run as ok although a handler failed, or a node was lost

    Raises ConfigurationError, WiringError or SceneError before anything starts, and RunError if the run fails; the
    results so far are in the folder that the error names.
    """
    options = [name for name in inspect.signature(run).parameters if name not in ("scenario", "parameters")]
    path, content = scenarios.load_values(scenario, parameters, options)
    choices: dict[str, Any] = {"seed": seed, "frames": frames, "mode": mode, "rate": rate, "record": record}
    resolved = scenarios.resolve(path, content, **choices)
    _check_runtime(path, resolved, runtime=runtime, secure=secure, endpoint=endpoint)
    finished = launcher.run(
        resolved,
        None if out is None else Path(out),
        runtime=runtime,
        endpoint=endpoint,
        secure=secure,
        allow_failures=allow_failures,
        allow_churn=allow_churn,
        command=_call(scenario, {"frames": frames, "seed": seed, "runtime": runtime, "mode": mode, **parameters}),
    )
    result = OpenedRun(finished.folder)
    if finished.error is not None:
        note = f"The results so far are in {finished.folder}: read them with mast_zenoh.open(…)"
        if isinstance(finished.error, (HandlerFailed, NodeLost)):  # their messages name an option of the command line
            option = "allow_failures" if isinstance(finished.error, HandlerFailed) else "allow_churn"
            note += f". Command-line options are keyword arguments in Python: {option}=True"
        finished.error.add_note(note)
        raise finished.error
    if report:
        result.report()
    return result


def _call(scenario: Scenario, arguments: Mapping[str, Any]) -> str:
    """The call that starts a run, shortened, for run.json."""
    name = repr(str(scenario)) if isinstance(scenario, (str, Path)) else getattr(scenario, "__name__", "a dict")
    words = [f"{key}={value!r:.80}" for key, value in arguments.items() if value is not None]
    return f"mast_zenoh.run({', '.join([name, *words])})"


def _check_runtime(path: Path, resolved: Resolved, *, runtime: str, secure: str, endpoint: str | None) -> None:
    """Raise ConfigurationError if a scenario cannot run in the requested runtime."""
    if runtime not in ("inproc", "mesh"):
        raise ConfigurationError(f"runtime: found {runtime!r}, expected inproc or mesh")
    if runtime == "inproc":
        if resolved.mode == "realtime":
            raise ConfigurationError("mode: realtime needs the mesh: add runtime='mesh'")
        if secure != "open" or endpoint is not None:
            raise ConfigurationError("secure and endpoint need the mesh: add runtime='mesh'")
        return
    if secure != "open" and endpoint is not None:
        raise ConfigurationError(
            f"secure: a secure mesh starts its own router: found the endpoint {endpoint}, expected none"
        )
    session_classes = loading.session_classes()
    configs = [dict(spec.config) for spec in resolved.nodes.values()]
    named = [session_classes.get(name, getattr(name, "cls", None)) for name in registry.type_names(configs)]
    named += [session_classes.get(spec.type) for spec in resolved.nodes.values() if spec.file == str(loading.SESSION)]
    unloadable = sorted({cls.__name__ for cls in named if cls is not None and loading.file_of_class(cls) is None})
    if unloadable:
        raise ConfigurationError(
            f"{path}: {', '.join(unloadable)}: defined in this session, but nodes on a mesh load classes from files: "
            "expected a class in a Python file next to the scenario, or runtime='inproc'"
        )
