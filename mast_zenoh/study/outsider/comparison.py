"""Makes the same attempts on the same run at every security level, and tabulates their effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mast_zenoh import run_folder, scenario
from mast_zenoh.config import loading, registry
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.launch import ending
from mast_zenoh.report.tables.text_table import csv_text
from mast_zenoh.study.definition import Study
from mast_zenoh.study.outsider.attacked_run import AttackedRun, attacker_errors
from mast_zenoh.study.outsider.attempts import Attempt, Outcome
from mast_zenoh.study.store import new_folder, status_written

#: The row of messages that belong to no attempt; their number should be 0.
STRAY = "(anything else)"
CAPTION = "in: forged messages that reached a node; out: samples overheard; lured: nodes at the outsider's router"
_EFFECTS = ("admitted", "sent", "reached", "expected", "heard", "lured", "succeeded")


@dataclass
class Effects:
    """The effects of all attempts by (run, level, attempt); out: the study's folder."""

    out: Path
    outcomes: dict[tuple[str, str, str], Outcome] = field(default_factory=dict)

    def rows(self) -> list[dict[str, Any]]:
        """All counts, a row per attempt and level."""
        return [
            {"run": run, "level": level, "attempt": attempt, **{name: getattr(outcome, name) for name in _EFFECTS}}
            for (run, level, attempt), outcome in self.outcomes.items()
        ]

    def as_rich(self) -> Table:
        """Attempts by level, for a terminal."""
        headers, *lines = self._grid("\n")
        table = Table(title=CAPTION, title_justify="left", title_style="dim", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
        for header in headers:
            table.add_column(header, vertical="top")
        for line in lines:
            table.add_row(*line)
        return table

    def as_markdown(self) -> str:
        """Attempts by level as Markdown; ends with a newline."""
        headers, *lines = self._grid(" ")
        table = [headers, ["---"] * len(headers), *lines]
        return "\n".join("| " + " | ".join(line) + " |" for line in table) + f"\n\n{CAPTION}.\n"

    def as_csv(self) -> str:
        """All counts, one line per attempt and level."""
        lines = [[int(cell) if isinstance(cell, bool) else cell for cell in row.values()] for row in self.rows()]
        return csv_text(["run", "level", "attempt", *_EFFECTS], lines)

    def _grid(self, separator: str) -> list[list[str]]:
        """The header and the lines: a line per attempt, a column per level."""
        runs, levels = (list(dict.fromkeys(key[index] for key in self.outcomes)) for index in (0, 1))
        grid = [["attempt", *levels]]
        for run, attempt in dict.fromkeys((run, attempt) for run, _, attempt in self.outcomes):
            outcomes = [self.outcomes.get((run, level, attempt)) for level in levels]
            cells = [_cell(attempt, outcome, separator) if outcome else "" for outcome in outcomes]
            grid.append([attempt if len(runs) == 1 else f"{run}: {attempt}", *cells])
        return grid


def run(
    study: Study,
    out: Path | None = None,
    *,
    seed: int | None = None,
    frames: int | None = None,
    console: Console | None = None,
) -> Effects:
    """Play each run at each security level in real time, with the attempts from its scenario file.

    All runs are resolved and validated before the first one starts. study.json exists from the start, with a status,
    and gets rows as soon as they are known; attempts.md and attempts.csv are written at the end. Raises RunError if a
    run ends before the outsider has finished, and HandlerFailed if the code of an attempt fails.
    """
    console = console or Console(quiet=True)
    seed, frames = study.seed if seed is None else seed, frames or study.frames
    prepared: dict[str, tuple[Resolved, list[Attempt]]] = {}
    for each in study.configurations:
        file, loaded = scenario.load(each.scenario, (*study.scenes[0].settings, *each.settings))
        attempts = load(each.scenario)
        if not attempts:
            raise ConfigurationError(f"{file}: lists no attempts: expected a function `outsider`")
        content = loaded | {"name": each.label}
        resolved = scenario.resolve(file, content, seed=seed, frames=frames, mode="realtime")
        prepared[each.label] = resolved, attempts
    effects = Effects(new_folder(out, study.name))
    status_file = effects.out / "study.json"

    def write_status(status: str) -> None:
        content = {"name": study.name, "status": status, "security": list(study.security), "rows": effects.rows()}
        run_folder.write_json(status_file, content)

    with status_written(status_file, write_status):
        try:
            for label, (resolved, attempts) in prepared.items():
                for level in study.security:
                    console.print(f"[dim]{label} at {level}: {len(attempts)} attempts of an outsider")
                    outcomes = run_outsider(resolved, effects.out / f"{label}-{level}", level, attempts)
                    effects.outcomes |= {(label, level, name): outcome for name, outcome in outcomes.items()}
        except KeyboardInterrupt as caught:
            raise ending.with_hint(caught, f"results so far are in {status_file}") from None
    for name, text in (("attempts.md", effects.as_markdown()), ("attempts.csv", effects.as_csv())):
        (effects.out / name).write_text(text, encoding="utf-8")
    return effects


def load(name: str) -> list[Attempt]:
    """Load the attempts of a scenario file's `outsider()`; [] without it; raises ConfigurationError."""
    path, _ = loading.function("scenarios", name, "scenario")
    function = getattr(loading.module(path), "outsider", None)
    content = function() if callable(function) else []
    if not isinstance(content, (list, tuple)):
        raise ConfigurationError(f"{path}: outsider() returned {type(content).__name__}, expected a list of dicts")
    attempts: list[Attempt] = [
        registry.build(spec, Attempt, f"{path}: outsider()[{index}]") for index, spec in enumerate(content)
    ]
    for attribute in ("name", "key"):
        values = [value for attempt in attempts if (value := getattr(attempt, attribute))]
        if duplicates := {value for value in values if values.count(value) > 1}:
            raise ConfigurationError(f"{name}: outsider(): two attempts have the {attribute} {duplicates.pop()!r}")
    return attempts


def run_outsider(resolved: Resolved, folder: Path, level: str, attempts: Sequence[Attempt]) -> Mapping[str, Outcome]:
    """Make an outsider's attempts in one run; their effects by name.

    The last one, STRAY, counts other messages from outside the run that reached a host.
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
    stray = sum(count for keys in received.values() for key, count in keys.items() if key not in attempted)
    return outcomes | {STRAY: Outcome(reached=stray)}


def _cell(attempt: str, outcome: Outcome, separator: str) -> str:
    """Verdict and counts of an attempt, with a separator between them."""
    counts = []
    if outcome.expected or attempt == STRAY:
        counts.append(f"in {outcome.reached}" + (f"/{outcome.expected}" if outcome.expected else ""))
    if outcome.heard or (not outcome.expected and attempt != STRAY):
        counts.append(f"out {outcome.heard}")
    if outcome.lured:
        counts.append(f"lured {outcome.lured}")
    failed = "none" if attempt == STRAY else "no effect" if outcome.admitted else "refused"
    return f"{'succeeds' if outcome.succeeded else failed}{separator}({', '.join(counts)})"
