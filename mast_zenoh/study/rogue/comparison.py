"""The same attempts against the same run at every level of security: which of them succeeds where."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from mast_zenoh import loading, registry, scenario
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.report import attempts_table
from mast_zenoh.report.attempts_table import AttemptRow
from mast_zenoh.resolved import Resolved
from mast_zenoh.study.definition import Study
from mast_zenoh.study.rogue.attempts import Attempt, Outcome
from mast_zenoh.study.rogue.siege import Siege


@dataclass(frozen=True)
class Besieged:
    """A study that has ended: its folder, a row for each attempt and level, and its files."""

    out: Path
    rows: list[AttemptRow]
    files: list[Path]


def run(
    study: Study,
    out: Path | None = None,
    *,
    seed: int | None = None,
    frames: int | None = None,
    console: Console | None = None,
) -> Besieged:
    """Play every run of the study at every level, in real time, while its outsider tries what its file lists.

    Everything is resolved, and refused if it is wrong, before the first run starts. Raises RunError for a run that
    ended while the outsider was at it.
    """
    console = console or Console(quiet=True)
    seed = study.seed if seed is None else seed
    prepared = []
    for configuration in study.configurations:
        file, loaded = scenario.load(configuration.scenario, (*study.scenes[0].settings, *configuration.settings))
        attempts = load(configuration.scenario)
        named = loaded | {"name": configuration.label}
        resolved = scenario.resolve(file, named, seed=seed, frames=frames or study.frames, mode="realtime")
        prepared.append((configuration.label, resolved, attempts))
    folder = run_folder.create(out, study.name)
    for part in ("logs", "figures"):
        (folder / part).rmdir()
    rows: list[AttemptRow] = []
    for label, resolved, attempts in prepared:
        for level in study.security:
            console.print(f"[dim]{label} at {level}: {len(attempts)} attempts")
            outcomes, stray = besiege(resolved, folder / f"{label}-{level}", level, attempts)
            rows += [_row(label, level, attempt, outcomes[attempt.name]) for attempt in attempts]
            rows.append(AttemptRow(label, level, attempts_table.STRAY, reached=stray, succeeded=stray > 0))
    content = {"name": study.name, "security": list(study.security), "rows": [row._asdict() for row in rows]}
    run_folder.write_json(folder / "study.json", content)
    files = []
    for name, write in (("attempts.md", attempts_table.as_markdown), ("attempts.csv", attempts_table.as_csv)):
        (folder / name).write_text(write(rows), encoding="utf-8")
        files.append(folder / name)
    return Besieged(folder, rows, files)


def load(name: str) -> list[Attempt]:
    """The attempts that a scenario file's `outsider()` lists; raises ConfigurationError."""
    path, function = loading.function("scenarios", name, "outsider")
    listed = function()
    if not isinstance(listed, (list, tuple)):
        raise ConfigurationError(f"{path}: outsider() returned {type(listed).__name__}, expected a list of dicts")
    attempts = [registry.build(spec, Attempt, f"{path}: outsider()[{index}]") for index, spec in enumerate(listed)]
    for what, values in (("name", [a.name for a in attempts]), ("key", [a.key for a in attempts if a.key])):
        twice = {value for value in values if values.count(value) > 1}
        if twice:
            raise ConfigurationError(f"{path}: outsider(): two attempts have the {what} {twice.pop()!r}")
    return attempts


def besiege(
    resolved: Resolved, folder: Path, level: str, attempts: Sequence[Attempt]
) -> tuple[Mapping[str, Outcome], int]:
    """(what came of each attempt by its name, messages of strangers that reached a host and are nobody's)."""
    outcomes: dict[str, Outcome] = {}
    with Siege(resolved, folder, level, [a.detours for a in attempts if a.detours]) as siege:
        for attempt in attempts:
            outcomes[attempt.name] = attempt.make(siege)
        received = siege.received()
        for outcome in outcomes.values():
            outcome.reached = sum(keys.get(outcome.key, 0) for keys in received.values())
        attempted = {outcome.key for outcome in outcomes.values()}
        stray = sum(n for keys in received.values() for key, n in keys.items() if key not in attempted)
    return outcomes, stray


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
