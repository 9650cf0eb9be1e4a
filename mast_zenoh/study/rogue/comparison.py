"""Makes the same attacks on the same run at every security level."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console

from mast_zenoh import scenario
from mast_zenoh.config import loading, registry
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.launch import ending
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.launch import run as launcher
from mast_zenoh.report.tables import attempts as attempts_table
from mast_zenoh.report.tables.attempts import AttemptRow
from mast_zenoh.study.definition import Configuration, Study
from mast_zenoh.study.rogue.attacked_run import AttackedRun, attacker_errors
from mast_zenoh.study.rogue.attempts import Attempt, Outcome
from mast_zenoh.study.rogue.infiltration import infiltrate
from mast_zenoh.study.rogue.insiders import Insider
from mast_zenoh.study.rogue.sybil import Sybil

#: The classes that a scenario file's `outsider()` can name besides those of `attempts`.
OUTSIDERS = (Sybil,)
#: Default number of frames of a run with an insider: there is one run per insider and level.
_INSIDER_FRAMES = 60


@dataclass(frozen=True)
class RogueResult:
    """A finished study.

    rows: one per attempt or insider, and level; files: all written tables
    """

    out: Path
    rows: list[AttemptRow]
    files: list[Path]


class _PreparedRun(NamedTuple):
    """A run of the study: in real time for the outsider, in lock-step for insiders."""

    label: str
    realtime: Resolved
    lockstep: Resolved
    attempts: list[Attempt]
    insiders: list[Insider]


def run(
    study: Study,
    out: Path | None = None,
    *,
    seed: int | None = None,
    frames: int | None = None,
    console: Console | None = None,
) -> RogueResult:
    """Play each run at each security level, with the attackers from its scenario file.

    The outsider makes all its attempts in one real-time run. Each insider has its own lock-step run, which is compared
    with an undisturbed twin. All runs are resolved and validated before the first one starts. study.json exists from
    the start, with a status, and gets each row as soon as it is known. Raises RunError if a run ends before its
    attackers have finished, and HandlerFailed if the code of an attacker fails.
    """
    console = console or Console(quiet=True)
    prepared = [_prepare(study, configuration, seed, frames) for configuration in study.configurations]
    folder = run_folder.create(out, study.name)
    for subfolder in ("logs", "figures"):
        (folder / subfolder).rmdir()
    rows: list[AttemptRow] = []

    def write_status(status: str) -> None:
        content = {"name": study.name, "status": status, "security": list(study.security)}
        run_folder.write_json(folder / "study.json", content | {"rows": [row._asdict() for row in rows]})

    with ending.status_written(write_status):
        try:
            for each in prepared:
                rows.extend(_attack_rows(each, study.security, folder, console))
        except KeyboardInterrupt as caught:
            raise ending.with_hint(caught, f"results so far are in {folder / 'study.json'}") from None
    files = []
    for name, write in (("attempts.md", attempts_table.as_markdown), ("attempts.csv", attempts_table.as_csv)):
        (folder / name).write_text(write(rows), encoding="utf-8")
        files.append(folder / name)
    return RogueResult(folder, rows, files)


def _attack_rows(each: _PreparedRun, levels: Sequence[str], folder: Path, console: Console) -> Iterator[AttemptRow]:
    """Attack one run of the study at every level; yields rows as they become known."""
    for level in levels:
        if each.attempts:
            console.print(f"[dim]{each.label} at {level}: {len(each.attempts)} attempts of an outsider")
            yield from _outsider_rows(each, level, folder)
    if each.insiders:
        console.print(f"[dim]{each.label}: the undisturbed twin")
        twin = launcher.run(each.lockstep, folder / f"{each.label}-twin", runtime="inproc")
        if twin.error:
            raise twin.error
        for level, insider in itertools.product(levels, each.insiders):
            console.print(f"[dim]{each.label} at {level}: {insider.name}", highlight=False)
            yield _insider_row(each, level, folder, insider, twin.folder)


def load(name: str) -> list[Attempt]:
    """Load the attempts of a scenario file's `outsider()`; raises ConfigurationError."""
    attempts: list[Attempt] = _load_attackers(name, "outsider", Attempt)
    _require_unique(name, "outsider", "key", [attempt.key for attempt in attempts if attempt.key])
    return attempts


def load_insiders(name: str) -> list[Insider]:
    """Load the insiders of a scenario file's `insiders()`; raises ConfigurationError."""
    insiders: list[Insider] = _load_attackers(name, "insiders", Insider)
    return insiders


def _load_attackers(name: str, function_name: str, base: Any) -> list[Any]:
    """Build the attackers listed by a scenario file's function; [] without it."""
    path, _ = loading.function("scenarios", name, "scenario")
    function = getattr(loading.module(path), function_name, None)
    content = function() if callable(function) else []
    if not isinstance(content, (list, tuple)):
        raise ConfigurationError(
            f"{path}: {function_name}() returned {type(content).__name__}, expected a list of dicts"
        )
    attackers = [
        registry.build(spec, base, f"{path}: {function_name}()[{index}]") for index, spec in enumerate(content)
    ]
    _require_unique(name, function_name, "name", [each.name for each in attackers])
    return attackers


def _require_unique(name: str, function_name: str, attribute: str, values: Sequence[str]) -> None:
    duplicates = {value for value in values if values.count(value) > 1}
    if duplicates:
        raise ConfigurationError(f"{name}: {function_name}(): two attempts have the {attribute} {duplicates.pop()!r}")


def run_outsider(
    resolved: Resolved, folder: Path, level: str, attempts: Sequence[Attempt]
) -> tuple[Mapping[str, Outcome], int]:
    """Make an outsider's attempts in one run.

    Returns the effects by attempt, and how many other messages from outside the run reached a host.
    """
    outcomes: dict[str, Outcome] = {}
    with AttackedRun(resolved, folder, level, [a.detour_node for a in attempts if a.detour_node]) as attacked_run:
        for attempt in attempts:
            with attacker_errors(attempt.name, attempt.make):
                outcomes[attempt.name] = attempt.make(attacked_run)
        received = attacked_run.foreign_messages()
        for outcome in outcomes.values():
            outcome.reached = sum(keys.get(outcome.key, 0) for keys in received.values())
        attempted = {outcome.key for outcome in outcomes.values()}
        stray = sum(n for keys in received.values() for key, n in keys.items() if key not in attempted)
    return outcomes, stray


def _prepare(study: Study, configuration: Configuration, seed: int | None, frames: int | None) -> _PreparedRun:
    """Resolve a run; raises ConfigurationError if invalid or without attackers."""
    file, loaded = scenario.load(configuration.scenario, (*study.scenes[0].settings, *configuration.settings))
    attempts, insiders = load(configuration.scenario), load_insiders(configuration.scenario)
    if not attempts and not insiders:
        raise ConfigurationError(f"{file}: lists no attackers: expected a function `outsider` or `insiders`")
    seed, frames = study.seed if seed is None else seed, frames or study.frames
    named_scenario = loaded | {"name": configuration.label}
    realtime = scenario.resolve(file, named_scenario, seed=seed, frames=frames, mode="realtime")
    recorded_scenario = named_scenario | {"run": named_scenario.get("run", {}) | {"record": True}}
    insider_frames = frames or _INSIDER_FRAMES
    lockstep = scenario.resolve(file, recorded_scenario, seed=seed, frames=insider_frames, mode="lockstep", record=True)
    for insider in insiders:
        if insider.node not in lockstep.nodes:
            raise ConfigurationError(
                f"{file}: insiders(): no node {insider.node!r}{nearest(insider.node, lockstep.nodes)}"
            )
    return _PreparedRun(configuration.label, realtime, lockstep, attempts, insiders)


def _outsider_rows(each: _PreparedRun, level: str, folder: Path) -> list[AttemptRow]:
    """A row for each attempt of the outsider at a level, and one for stray messages."""
    outcomes, stray = run_outsider(each.realtime, folder / f"{each.label}-{level}", level, each.attempts)
    rows = [_row(each.label, level, attempt, outcomes[attempt.name]) for attempt in each.attempts]
    return [*rows, AttemptRow(each.label, level, attempts_table.STRAY, reached=stray, succeeded=stray > 0)]


def _insider_row(each: _PreparedRun, level: str, folder: Path, insider: Insider, twin: Path) -> AttemptRow:
    number = each.insiders.index(insider) + 1
    insider_folder = folder / f"{each.label}-{level}-insider_{number}"
    admitted, sent, finding = infiltrate(each.lockstep, insider_folder, level, insider, twin)
    return AttemptRow(
        each.label, level, insider.name, admitted, sent, succeeded=finding.succeeded, verdict=finding.verdict
    )


def _row(label: str, level: str, attempt: Attempt, outcome: Outcome) -> AttemptRow:
    return AttemptRow(
        run=label,
        level=level,
        attempt=attempt.name,
        admitted=outcome.admitted,
        sent=outcome.sent,
        reached=outcome.reached,
        expected=outcome.expected,
        heard=outcome.heard,
        lured=outcome.lured,
        succeeded=outcome.succeeded,
    )
