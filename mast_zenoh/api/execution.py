"""Runs scenarios, and opens run folders."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

from mast_zenoh import scenario as scenarios
from mast_zenoh.api.runs import OpenedRun
from mast_zenoh.config import loading, registry
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError, HandlerFailed, NodeLost
from mast_zenoh.launch import run as launcher

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
    secure:     security level of the mesh: certificates and access control (docs/security.md)
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
