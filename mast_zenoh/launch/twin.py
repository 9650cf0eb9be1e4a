"""The unattacked twin of a run: same scenario and seed, without adversaries."""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from mast_zenoh import version
from mast_zenoh.config import registry
from mast_zenoh.config.loading import SHIPPED, AllowedCode
from mast_zenoh.config.resolved import RECORDING, Resolved
from mast_zenoh.errors import HandlerFailed, MastError, NotComparable, UntrustedCode
from mast_zenoh.launch import run
from mast_zenoh.run_folder import json_or_empty, write_json
from mast_zenoh.run_folder.recording.writer import MessageLog
from mast_zenoh.scenes import Scene
from mast_zenoh.scenes.cache import prepare
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.wiring import insertion
from mast_zenoh.wiring.model import Wiring

#: Its folder in the run folder, and its scenario's name.
FOLDER, NAME = "twin", "unattacked"
#: In the folder of a twin: the versions and source files on which its results depend.
SOURCES = "sources.json"
_ATTACKERS = ("adversary", "coordinator")


def unattacked(resolved: Resolved) -> Resolved:
    """The scenario without adversaries, coordinators and interposers other than links.

    It plays in lock-step, and without a recorder unless cars are driven: what happens is then known from the recording.
    Links and faults stay.
    """
    wiring = Wiring.from_json(resolved.wiring)
    driven = any(spec.role == "driver" for spec in resolved.nodes.values())
    interposers = {name for wire in wiring.wires for name in wire.interposers}
    removed = {
        name
        for name, spec in resolved.nodes.items()
        if spec.role in (*_ATTACKERS, *(() if driven else ("recorder",)))
        or (name in interposers and spec.role != "link")
    }
    nodes = {name: spec for name, spec in resolved.nodes.items() if name not in removed}
    return replace(
        resolved,
        name=NAME,
        mode="lockstep",
        nodes=nodes,
        wiring=insertion.never_inserted(wiring, removed).to_json(),
        timeline=tuple(event for event in resolved.timeline if event["kind"] != "attack"),
        steps=tuple(step for step in resolved.steps if step.node not in removed),
    )


def of(run_folder: Path, console: Console | None = None, allowed: AllowedCode = SHIPPED) -> Path:
    """The folder of the unattacked twin of a run; plays it unless it is up to date.

    allowed: which of the code that the run folder names may run
    A twin whose handlers failed is accepted: its run.json says so.
    Raises NotComparable if the run's scenario cannot be read, or cannot be played in one process.
    """
    twin = _read(run_folder, allowed)
    sources = {"versions": version.versions(), "files": _digests(twin)}
    folder = run_folder / FOLDER
    if folder.is_symlink():
        raise NotComparable(f"{folder}: is a link, expected a folder: remove it")
    if _is_played(folder, twin) and _is_up_to_date(folder, sources):
        return folder
    if folder.exists():
        if json_or_empty(folder / "run.json").get("name") != NAME:
            raise NotComparable(f"{folder}: is not the twin of {run_folder}: remove it, or name a run with --against")
        shutil.rmtree(folder)
    if twin.network.get("faults"):
        raise NotComparable(
            f"{run_folder}: its unattacked twin would be played in one process, which has no host network for its "
            "faults: run the scenario without adversaries yourself, and name that folder with --against"
        )
    try:
        ended = run.run(_undriven(replace(twin, network={})), folder, runtime="inproc", console=console)
    except MastError as error:
        raise NotComparable(f"the unattacked twin of {run_folder} cannot be played: {error}") from error
    if ended.error and not isinstance(ended.error, HandlerFailed):
        raise NotComparable(f"the unattacked twin of {run_folder} failed: {ended.error}")
    write_json(folder / SOURCES, sources)
    return folder


def _read(run_folder: Path, allowed: AllowedCode) -> Resolved:
    """The twin of a run's scenario, with its scene loaded from the run folder."""
    if origin := json_or_empty(run_folder / "run.json").get("replay"):
        raise NotComparable(
            f"{run_folder}: is a replay, whose adversaries are in its recording: expected the folder of a run, such as "
            f"the recorded one, {origin.get('folder')}"
        )
    try:
        resolved = Resolved.read(run_folder, allowed)
        recording = Recording.load(run_folder / RECORDING)
        for spec in resolved.nodes.values():
            if spec.role == "recorder":  # in the twin's folder, whatever is written here
                spec.config["log"] = MessageLog()
        twin = unattacked(
            replace(resolved.with_values(lambda value: recording if value == RECORDING else value), recording=recording)
        )
    except UntrustedCode:
        raise
    except (OSError, ValueError, KeyError, TypeError, AttributeError, MastError) as error:
        raise NotComparable(
            f"{run_folder}: its unattacked twin needs scenario.json, wiring.json and {RECORDING}: {error!r}"
        ) from None
    twin.load_modules()
    return twin


def _undriven(twin: Resolved) -> Resolved:
    """The twin of a driven run with points with its scene prepared anew: what stands beside roads keeps clear of cars.

    The run's recording has become what happened in it.
    """
    happened = twin.recording
    configs = [spec.config for spec in twin.nodes.values()]
    scenes = [config["scene"] for config in configs if "scene" in config and config.get("points")]
    if happened is None or not scenes:
        return twin
    scene: Scene = registry.build(scenes[0], Scene, "scenario.json: scene")
    prepared = replace(prepare(scene, twin.seed, len(happened), None), agents=happened.agents)
    return replace(twin.with_values(lambda value: prepared if value is happened else value), recording=prepared)


def _is_played(folder: Path, twin: Resolved) -> bool:
    """Whether a folder holds the results of this twin."""
    if json_or_empty(folder / "run.json").get("status") != "ok" or not (folder / "metrics.json").is_file():
        return False
    return bool(
        json_or_empty(folder / "scenario.json") == json.loads(json.dumps(replace(twin, network={}).to_json()))
        and json_or_empty(folder / "wiring.json") == json.loads(json.dumps(twin.wiring))
    )


def _is_up_to_date(folder: Path, sources: dict[str, Any]) -> bool:
    """Whether a twin was played by these versions and files, of those that exist here."""
    played_sources = json_or_empty(folder / SOURCES)
    files = played_sources.get("files")
    return (
        played_sources.get("versions") == sources["versions"]
        and isinstance(files, dict)
        and sources["files"].items() <= files.items()
    )


def _digests(twin: Resolved) -> dict[str, str]:
    """By path, digests of the files of nodes and algorithms, and of files next to them."""
    paths = {Path(path) for path in (*(spec.file for spec in twin.nodes.values()), *twin.modules)}
    files = {file for path in paths for file in (path, *path.parent.glob("*.py")) if file.is_file()}
    return {str(file): hashlib.blake2b(file.read_bytes(), digest_size=20).hexdigest() for file in sorted(files)}
