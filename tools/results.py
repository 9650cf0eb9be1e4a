"""Makes docs/results/: plays the studies of `results_pages.PAGES`, and writes a page and a CSV file of each.

python tools/results.py                     all pages, for hours: `make results`
python tools/results.py attacks driving     some: `make results PAGES="attacks driving"`
python tools/results.py --quick             all, with wide intervals, into build/results: `make results QUICK=1`
python tools/results.py --cluster ADDRESS   on a Dask cluster

It goes on where it was interrupted: the studies are in build/studies, a folder for each.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import math
import os
import platform
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from PIL import Image
from results_pages import PAGES, Benchmark, Page, Part
from rich.console import Console
from scipy import stats

from mast_zenoh.errors import Interrupted, MastError
from mast_zenoh.metrics.study_results import Row, StudySeries
from mast_zenoh.show.figures.drawing import RenderedFigure
from mast_zenoh.show.findings import of_study
from mast_zenoh.show.number_text import over_trials
from mast_zenoh.show.study_columns import MOSTLY_ZERO_NOTE
from mast_zenoh.show.tables.text_table import TextTable, csv_text, numbers_of_rows, shown, table_of_rows
from mast_zenoh.study import definition, interface, statistics
from mast_zenoh.study.tables import StudyResult

ROOT = Path(__file__).parents[1]
FOLDER, BUILT = ROOT / "docs" / "results", ROOT / "build"
#: Arguments of a part that `mast study` has options for; others are parameters of the study's function.
OPTIONS = ("trials", "frames", "seed")
#: Sentences above a table.
_SENTENCES = 3
#: Columns of the CSV file of a page.
COLUMNS = ("study", "of", "measure", "value", "low", "high", "interval", "trials")
#: Measures that differ from machine to machine.
_OF_A_MACHINE = {"ms per frame", "frames/s", "median", "ratio"}
#: The chance that a page with right numbers is said to differ.
_FALSE_ALARM = 0.001


class Missing(Exception):
    """Why a page cannot be made here."""


@dataclass(frozen=True)
class Played:
    """A study as a page shows it. numbers: lines of the CSV file, by COLUMNS;  size, seeds: of its trials"""

    title: str
    sentences: Sequence[str]
    table: TextTable
    numbers: Sequence[Mapping[str, object]]
    command: str
    size: str = ""
    seeds: str = ""
    figure: RenderedFigure | None = None


def play(page: Page, part: Part, *, quick: bool, cluster: str | None) -> Played:
    """Play what is left of a study. Raises Missing without its data, and TrialsFailed."""
    chosen = dict(part.quick if quick else part.full) | {name: data(path) for name, path in part.paths.items()}
    options = {name: chosen.pop(name) for name in OPTIONS if name in chosen}
    folder = BUILT / "studies" / ("quick" if quick else "full") / f"{page.name}-{part.study}"
    folder.parent.mkdir(parents=True, exist_ok=True)
    console = Console(stderr=True)
    console.print(f"{page.name}: {part.title}", style="bold")
    study = definition.load_values(part.study, chosen)
    result = interface.run(study, folder, **options, cluster=cluster, resume=True, console=console)
    assert isinstance(result, StudyResult)
    result.raise_failures()
    table, numbers = of_kind(part, result) if part.table else of_columns(part, result)
    words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
    places = {name: place(path) for name, path in part.paths.items()}
    words += [word for name, value in chosen.items() for word in ("--set", f"{name}={places.get(name, value)}")]
    apart = ", each at a junction of its own" * (study.per_trial.get("seed") == "scene_index")
    facts = result.facts
    return Played(
        part.title,
        shortened(sentences_of(result)),
        table,
        [{"study": part.study} | line for line in numbers],
        command("mast", "study", part.study, *words),
        f"{facts.size}{apart}, {facts.frames or 'all'} frames each{', in $MAST_DATA' * bool(part.paths)}.",
        f"{part.study} {' to '.join(dict.fromkeys(map(str, (facts.seeds[0], facts.seeds[-1]))))}",
        result.figures[part.figure],
    )


def measure(page: Page, part: Benchmark, *, quick: bool) -> Played:
    """Run a benchmark, or read what it wrote before; numbers differ from machine to machine."""
    file = BUILT / "studies" / ("quick" if quick else "full") / f"{page.name} {part.title} {commit()}.json"
    options = part.quick if quick else part.full
    paths = [part.path] if part.path else []
    arguments = [part.program, *map(data, paths), *options]
    if not file.is_file():
        file.parent.mkdir(parents=True, exist_ok=True)
        unfinished = file.with_suffix(".part")
        subprocess.run([sys.executable, *arguments, "--json", str(unfinished)], cwd=ROOT, check=True)
        unfinished.replace(file)
    values = {name: np.array(each) for name, each in json.loads(file.read_text("utf-8")).items()}
    rows = []
    for name, each in values.items():
        median = statistics.pooled(lambda of, each=each: float(np.median(each[of])), len(each))
        rows.append(Row({"": name}, len(each), {part.heading: median}))
    columns = {part.heading: shown(part.heading), "repetitions": lambda row: str(row.trials)}
    numbers = [{"study": part.program} | line for line in lines_of(*numbers_of_rows(rows))]
    table = table_of_rows(part.title, part.about, rows, columns)
    return Played(part.title, [], table, numbers, command("python", part.program, *map(place, paths), *options))


def data(name: str) -> str:
    """The whole path of recorded data, or a scene's short name with it. Raises Missing if they are not here."""
    *kind, path = name.rsplit(":", 1)
    found = Path(os.environ.get("MAST_DATA") or ROOT.parent / "shared" / "data") / path
    if not found.exists():
        raise Missing(f"{path} is not in $MAST_DATA")
    return ":".join([*kind, str(found)])


def place(name: str) -> str:
    """Recorded data, or a scene's short name with it, as in a command."""
    kind, colon, path = name.rpartition(":")
    return f"{kind}{colon}$MAST_DATA/{path}"


def command(*words: str) -> str:
    """A line for a shell, in which $MAST_DATA is replaced."""
    return " ".join(f'"{word}"' if "$MAST_DATA" in word else shlex.quote(word) for word in words)


def sentences_of(result: StudyResult) -> list[str]:
    """What the page of the study says first."""
    rows, facts = of_study.titled(result.rows, result.facts)
    comparisons = of_study.compare(rows, facts.baseline)
    own = (result.own.tables.headline, result.own.tables.reading) if result.own is not None else ()
    headline, reading, _ = of_study.conclusions(rows, facts, comparisons, *own)
    return [f"{headline}.", *reading]


def shortened(sentences: Sequence[str]) -> list[str]:
    """The first ones and the last, which says what cannot be told from no change."""
    return [*sentences[: _SENTENCES - 1], *sentences[max(_SENTENCES - 1, len(sentences) - 1) :]]


def of_columns(part: Part, result: StudyResult) -> tuple[TextTable, list[dict[str, object]]]:
    """The table of the columns that a page names, and the lines of its CSV file."""
    names = {heading: " ".join(of) for heading, of in part.columns.items()}
    rows = [
        Row(
            {"": row.title},
            0,
            {names[heading]: row.get(StudySeries("", who, metric)) for heading, (who, metric) in part.columns.items()},
        )
        for row in result.rows
    ]
    about = MOSTLY_ZERO_NOTE if any(each.mostly_zero for row in rows for each in row.numbers.values()) else ""
    texts = {heading: shown(f"{of} {metric}", over_trials) for heading, (of, metric) in part.columns.items()}
    return table_of_rows(part.title, about, rows, texts), list(lines_of(*numbers_of_rows(rows)))


def of_kind(part: Part, result: StudyResult) -> tuple[TextTable, list[dict[str, object]]]:
    """A table of the study's kind, and the lines of its CSV file with the measures that a page names."""
    assert result.own is not None
    tables = {table.title: table for table in result.own.tables.tables}
    numbers = lines_of(*result.own.tables.numbers)
    return tables[part.table], [line for line in numbers if not part.measures or line["measure"] in part.measures]


def lines_of(headings: Sequence[str], lines: Sequence[Sequence[object]]) -> Iterator[dict[str, object]]:
    """The lines of a study's CSV file, in the columns of a page's."""
    names = headings[: headings.index("measure")]
    for line in lines:
        values = dict(zip(headings, line, strict=True))
        of = "; ".join(f"{name} {values[name]}".strip() for name in names if values[name] not in ("", None))
        yield {"of": of} | {name: values[name] for name in COLUMNS if name in values}


def origin(parts: Sequence[Played]) -> dict[str, str]:
    """Where the numbers of a page come from, by name."""
    lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines() if sys.platform == "linux" else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return {
        "commit": commit(),
        "date": f"{datetime.now(UTC):%Y-%m-%d}",
        "processor": f"{(models or [platform.machine()])[0]}, {os.cpu_count()} cores",
        "load, when the page was written": f"{os.getloadavg()[0]:.1f}",
        "Python": platform.python_version(),
        "seeds": "; ".join(part.seeds for part in parts if part.seeds),
    }


@cache
def commit() -> str:
    """Of what is played: asked before it, so that one that is made in the meantime is not named."""
    changed = git("status", "--porcelain", "--", ":!docs")
    return git("rev-parse", "--short", "HEAD") + ", with changes" * bool(changed)


def git(*arguments: str) -> str:
    """The output of a git command here."""
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def write(page: Page, parts: Sequence[Played], out: Path, *, quick: bool) -> None:
    """Write a page, its figures and its CSV file into a folder."""
    out.mkdir(parents=True, exist_ok=True)
    figures = {}
    for number, part in enumerate(parts, 1):
        if part.figure is not None:
            figures[part.title] = f"{page.name}-{number}.png"
            (out / figures[part.title]).write_bytes(smaller(part.figure.png))
    lines = [[line.get(name) for name in COLUMNS] for part in parts for line in part.numbers]
    (out / f"{page.name}.csv").write_text(csv_text(COLUMNS, lines), "utf-8")
    templates = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        autoescape=False,
        keep_trailing_newline=True,
    )
    content = dict(page=page, parts=parts, figures=figures, origin=origin(parts), quick=quick)
    text = templates.get_template("results.md.j2").render(content)
    (out / f"{page.name}.md").write_text(re.sub(r"\n{3,}", "\n\n", text), "utf-8")


def smaller(png: bytes) -> bytes:
    """A PNG of at most 256 colours: figures have few."""
    image, file = Image.open(io.BytesIO(png)).convert("RGB"), io.BytesIO()
    image.quantize(256).save(file, "PNG", optimize=True)
    return min(file.getvalue(), png, key=len)


def outside(quick: Path, full: Path) -> tuple[list[str], int, int]:
    """Numbers of a CSV file that differ from another's by more than both intervals allow.

    Returns these, how many were compared, and how many may differ by chance.
    """
    found, reference = numbers_in(quick), numbers_in(full)
    differing, compared = [], 0
    for name in found.keys() & reference.keys():
        (value, low, high), (true, true_low, true_high) = found[name], reference[name]
        if math.isfinite(low + high + true_low + true_high) and name[-1] not in _OF_A_MACHINE:
            compared += 1
            own, other = (value - low, true_high - true) if value > true else (high - value, true - true_low)
            if abs(value - true) > math.hypot(own, other):
                differing.append(f"{' '.join(name)}: {value:.3g} [{low:.3g}, {high:.3g}], not {true:.3g}")
    return sorted(differing), compared, int(stats.binom.ppf(1.0 - _FALSE_ALARM, compared, 0.05))


def numbers_in(file: Path) -> dict[tuple[str, str, str], tuple[float, float, float]]:
    """By study, what it is of, and measure: value, low and high."""
    with file.open(encoding="utf-8", newline="") as text:
        return {
            (line["study"], line["of"], line["measure"]): tuple(
                float(line[name] or "nan") for name in ("value", "low", "high")
            )
            for line in csv.DictReader(text)
        }


def main(arguments: Sequence[str] | None = None) -> int:
    """Make pages; returns how many failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pages", nargs="*", metavar="PAGE", help=", ".join(page.name for page in PAGES))
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--cluster", metavar="ADDRESS")
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args(arguments)
    if unknown := {*chosen.pages} - {page.name for page in PAGES}:
        parser.error(f"no page {', '.join(sorted(unknown))}: expected some of {', '.join(page.name for page in PAGES)}")
    out = chosen.out or (BUILT / "results" if chosen.quick else FOLDER)
    commit()
    failed = 0
    for page in PAGES:
        if chosen.pages and page.name not in chosen.pages:
            continue
        try:
            parts = [
                measure(page, part, quick=chosen.quick)
                if isinstance(part, Benchmark)
                else play(page, part, quick=chosen.quick, cluster=chosen.cluster)
                for part in page.parts
            ]
        except Missing as missing:
            print(f"{page.name}: not made, what is there is kept: {missing}")
            continue
        except Interrupted:
            raise
        except (MastError, subprocess.CalledProcessError) as error:  # the other pages need not wait for somebody
            print(f"{page.name}: not made: {error}", file=sys.stderr)
            failed += 1
            continue
        write(page, parts, out, quick=chosen.quick)
        print(out / f"{page.name}.md")
    return failed


if __name__ == "__main__":
    sys.exit(main())
