"""The same attempts against the same run at every level of security: which of them succeeds where."""

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
from mast_zenoh.study.rogue.attempts import Attempt, Outcome
from mast_zenoh.study.rogue.infiltration import infiltrate
from mast_zenoh.study.rogue.insiders import Insider
from mast_zenoh.study.rogue.siege import Siege, attackers_own

#: Of a run with an insider, unless the study says how many: there is one for each insider and level.
_INSIDER_FRAMES = 60


@dataclass(frozen=True)
class Besieged:
    """A study that has ended: its folder, a row for each attempt or insider and level, and its files."""

    out: Path
    rows: list[AttemptRow]
    files: list[Path]


class _Prepared(NamedTuple):
    """A run of the study, as the outsider and as insiders find it."""

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
) -> Besieged:
    """Play every run of the study at every level, while attackers try what its file lists.

    The outsider makes all its attempts in one run, in real time. Each insider has a run of its own, in lock-step, so
    that it can be compared with an undisturbed twin. Everything is resolved, and refused if it is wrong, before the
    first run starts. study.json is there from the beginning, with a status, and gets a row as soon as it is known.
    Raises RunError for a run that ended while the outsider was at it, or before an insider was, and HandlerFailed for
    an attacker whose own code fails.
    """
    console = console or Console(quiet=True)
    prepared = [_prepared(study, configuration, seed, frames) for configuration in study.configurations]
    folder = run_folder.create(out, study.name)
    for part in ("logs", "figures"):
        (folder / part).rmdir()
    rows: list[AttemptRow] = []

    def note(status: str) -> None:
        content = {"name": study.name, "status": status, "security": list(study.security)}
        run_folder.write_json(folder / "study.json", content | {"rows": [row._asdict() for row in rows]})

    with ending.written(note):
        try:
            for each in prepared:
                rows.extend(_played(each, study.security, folder, console))
        except KeyboardInterrupt as caught:
            raise ending.explained(caught, f"what was found is in {folder / 'study.json'}") from None
    files = []
    for name, write in (("attempts.md", attempts_table.as_markdown), ("attempts.csv", attempts_table.as_csv)):
        (folder / name).write_text(write(rows), encoding="utf-8")
        files.append(folder / name)
    return Besieged(folder, rows, files)


def _played(each: _Prepared, levels: Sequence[str], folder: Path, console: Console) -> Iterator[AttemptRow]:
    """The rows of a run of the study, as they come."""
    for level in levels:
        if each.attempts:
            console.print(f"[dim]{each.label} at {level}: {len(each.attempts)} attempts of an outsider")
            yield from _outside(each, level, folder)
    if each.insiders:
        console.print(f"[dim]{each.label}: the undisturbed twin")
        twin = launcher.run(each.lockstep, folder / f"{each.label}-twin", runtime="inproc")
        if twin.error:
            raise twin.error
        for level, insider in itertools.product(levels, each.insiders):
            console.print(f"[dim]{each.label} at {level}: {insider.name}", highlight=False)
            yield _inside(each, level, folder, insider, twin.folder)


def load(name: str) -> list[Attempt]:
    """The attempts that a scenario file's `outsider()` lists; raises ConfigurationError."""
    attempts: list[Attempt] = _listed(name, "outsider", Attempt)
    _tell_apart(name, "outsider", "key", [attempt.key for attempt in attempts if attempt.key])
    return attempts


def load_insiders(name: str) -> list[Insider]:
    """The compromised nodes that a scenario file's `insiders()` lists; raises ConfigurationError."""
    insiders: list[Insider] = _listed(name, "insiders", Insider)
    return insiders


def _listed(name: str, what: str, base: Any) -> list[Any]:
    """What a function of a scenario file lists, made of subclasses of `base`; nothing if there is no such function."""
    path, _ = loading.function("scenarios", name, "scenario")
    function = getattr(loading.module(path), what, None)
    content = function() if callable(function) else []
    if not isinstance(content, (list, tuple)):
        raise ConfigurationError(f"{path}: {what}() returned {type(content).__name__}, expected a list of dicts")
    made = [registry.build(spec, base, f"{path}: {what}()[{index}]") for index, spec in enumerate(content)]
    _tell_apart(name, what, "name", [each.name for each in made])
    return made


def _tell_apart(name: str, what: str, part: str, values: Sequence[str]) -> None:
    twice = {value for value in values if values.count(value) > 1}
    if twice:
        raise ConfigurationError(f"{name}: {what}(): two attempts have the {part} {twice.pop()!r}")


def besiege(
    resolved: Resolved, folder: Path, level: str, attempts: Sequence[Attempt]
) -> tuple[Mapping[str, Outcome], int]:
    """(what came of each attempt by its name, messages of strangers that reached a host and are nobody's)."""
    outcomes: dict[str, Outcome] = {}
    with Siege(resolved, folder, level, [a.detours for a in attempts if a.detours]) as siege:
        for attempt in attempts:
            with attackers_own(attempt.name, attempt.make):
                outcomes[attempt.name] = attempt.make(siege)
        received = siege.received()
        for outcome in outcomes.values():
            outcome.reached = sum(keys.get(outcome.key, 0) for keys in received.values())
        attempted = {outcome.key for outcome in outcomes.values()}
        stray = sum(n for keys in received.values() for key, n in keys.items() if key not in attempted)
    return outcomes, stray


def _prepared(study: Study, configuration: Configuration, seed: int | None, frames: int | None) -> _Prepared:
    """Raises ConfigurationError for what cannot be played, and for a file that lists no attackers."""
    file, loaded = scenario.load(configuration.scenario, (*study.scenes[0].settings, *configuration.settings))
    attempts, insiders = load(configuration.scenario), load_insiders(configuration.scenario)
    if not attempts and not insiders:
        raise ConfigurationError(f"{file}: lists no attackers: expected a function `outsider` or `insiders`")
    seed, frames = study.seed if seed is None else seed, frames or study.frames
    named = loaded | {"name": configuration.label}
    realtime = scenario.resolve(file, named, seed=seed, frames=frames, mode="realtime")
    recorded = named | {"run": named.get("run", {}) | {"record": True}}
    short = frames or _INSIDER_FRAMES
    lockstep = scenario.resolve(file, recorded, seed=seed, frames=short, mode="lockstep", record=True)
    for insider in insiders:
        if insider.node not in lockstep.nodes:
            raise ConfigurationError(
                f"{file}: insiders(): no node {insider.node!r}{nearest(insider.node, lockstep.nodes)}"
            )
    return _Prepared(configuration.label, realtime, lockstep, attempts, insiders)


def _outside(each: _Prepared, level: str, folder: Path) -> list[AttemptRow]:
    """A row for each attempt of the outsider at one level, and one for what no attempt accounts for."""
    outcomes, stray = besiege(each.realtime, folder / f"{each.label}-{level}", level, each.attempts)
    rows = [_row(each.label, level, attempt, outcomes[attempt.name]) for attempt in each.attempts]
    return [*rows, AttemptRow(each.label, level, attempts_table.STRAY, reached=stray, succeeded=stray > 0)]


def _inside(each: _Prepared, level: str, folder: Path, insider: Insider, twin: Path) -> AttemptRow:
    number = each.insiders.index(insider) + 1
    place = folder / f"{each.label}-{level}-insider_{number}"
    admitted, sent, found = infiltrate(each.lockstep, place, level, insider, twin)
    return AttemptRow(each.label, level, insider.name, admitted, sent, succeeded=found.succeeded, verdict=found.verdict)


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
