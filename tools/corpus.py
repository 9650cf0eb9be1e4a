"""Makes a corpus of what mast puts out, and compares two of them: a change of the code's shape may lose nothing.

python tools/corpus.py make OUT [--only PATTERN]... [--jobs N] [--tree CHECKOUT] [--pictures]
python tools/corpus.py compare OLD NEW [--only PATTERN]... [--except PATTERN]... [--tolerance X] [--most N]

`make` skips what is finished, so it can be stopped and repeated. `compare` reads files by itself, because OLD may be of
an older version; only recordings are compared by `mast diff`. It exits with 1 if there is any difference.
"""

from __future__ import annotations

import argparse
import difflib
import html
import io
import json
import math
import re
import shutil
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from fnmatch import fnmatch
from functools import partial
from pathlib import Path
from typing import Any

import chromium
import numpy as np
from corpus_entries import Failed, Maker, ask, entries, pictured
from mcap.reader import make_reader
from pyarrow import csv, parquet

ROOT = Path(__file__).parents[1]

# What two corpora of the same code differ in, each with its reason. Lock-step is exact on the mesh, too: recordings,
# metrics, tables and the rest of all files are compared there as they are in one process.

#: Files that are not compared, by the end of their names. They have to be there.
UNCOMPARED = {
    "entry.json": "what the corpus says about itself; its exit codes are compared",
    "png pdf svg gif": "pictures are for eyes: fonts and libraries change pixels, and some carry a time or random ids",
    "html": "its text, in the .txt beside it, is compared",
    "rrd": "ids of rows and chunks are random, and chunks are cut by time",
    "log": "of processes: times, ids of processes, the order of threads",
    "/trials/.parquet": "of studies; results.parquet and frames.parquet hold their numbers",
}
#: Fields of JSON files, by patterns of file:path.
VOLATILE_FIELDS = {
    "*/run.json:id": "random",
    "*/run.json:started": "time of day",
    "*/run.json:command": "where Python found the program",
    "*/run.json:launcher": "process and machine",
    "*/run.json:timings": "durations",
    "*/run.json:versions": "of packages and of the machine",
    "*/run.json:endpoint": "a free port",
    "*/run.json:nodes.*.pid": "process",
    "*/run.json:nodes.*.cpu_s": "duration",
    "*/run.json:*unsigned_control": "how often nodes report that they are idle, on the mesh",
    "*/run.json:interceptions.*.frame": "a live interception begins between two frames, when the node is ready",
    "*/run.json:interceptions.*.took_ms": "duration",
    "*.json:replay.folder": "where the corpus is",
    "*/scenario.json:nodes.*.file": "where the checkout is",
    "*/twin/sources.json:*": "digests of the sources",
    "*/study.json:environment.code": "digest of the sources",
    "mesh/intercepted/run/metrics.json:interposers.mallory.messages": "of a live interception, since its frame",
    "mesh/intercepted/run/*.json:recorded.messages": "with those of the hidden leg, since that frame",
}
#: Parts of texts and of names of files, as regular expressions, which are left out.
VOLATILE_TEXT = {
    r"\b[a-z][a-z0-9_]*-[0-9a-f]{8}\b": "a run's id is random",
    r"\b[0-9a-f]{40}\b": "digests of the code, by which trials of studies are named",
    r"frame \d+ of \d+(?: [\d.]+/s)?|finishing, \d+ s": "progress, in time",
    r"\b\d:\d\d:\d\d\b": "durations, beside progress",
    r"[\d.]+ frames/s": "speed",
    r"^.*,(?:summary )?cpu_\w+,.*\n|Processor time[\s\S]*?Breakdown|^ *processor time.*$": "durations, of matrix",
    r"(?<=none)(?:[ |&]+\d\.\d\d){2}[ |\\]*$": "as above, the last columns of its scores",
    r"^\w+ [a-z_]+ \d+ (?=ok\b|killed\b|told\b)": "ids of processes, in the table of nodes",
    r"\d+ control messages were obeyed": "as unsigned_control above",
    r'\{ "(?:start_s|frames)": [^}]*"total_s": [^}]*\}': "durations, at the end of a page",
    r"(?:live in|live from|\(from) frame \d+(?: agent/\S+ \d+)?|from frame \d+ on \([\d.]+ ms\)": "live interception",
    r"/\S*/(?=(?:nodes|scenarios|studies|keyexpr_maps)/)": "where the checkout is",
}


def make(tree: Path, out: Path, name: str, maker: Maker) -> bool:
    """Make an entry unless it is finished; returns whether it is."""
    folder = out / name
    if (folder / "entry.json").is_file():
        return True
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    began = time.monotonic()
    try:
        codes = maker(tree, folder)
    except (Failed, chromium.Unavailable, subprocess.TimeoutExpired) as problem:
        print(f"NOT MADE: {name}: {problem}", file=sys.stderr, flush=True)
        return False
    for page in folder.rglob("*.html"):
        page.with_suffix(".txt").write_text(page_text(page.read_text()))
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    described = subprocess.run(("git", "-C", tree, "describe", "--always", "--dirty"), capture_output=True, text=True)
    record = {"commit": described.stdout.strip(), "exit_codes": codes, "seconds": round(time.monotonic() - began, 1)}
    (folder / "entry.json").write_text(json.dumps(record | {"bytes": size}))
    print(f"{name}: {record['seconds']} s, {size / 1e6:.1f} MB, exit codes {codes}", flush=True)
    return True


def make_all(chosen: argparse.Namespace) -> int:
    """Make what is wanted; returns how much could not be made."""
    tree, out = chosen.tree.resolve(), chosen.out.resolve()
    made = {name: maker for name, maker in entries(tree).items() if matches(name, chosen.only or "*")}
    with ThreadPoolExecutor(chosen.jobs) as pool:
        finished = list(pool.map(lambda item: make(tree, out, *item), made.items()))
        if chosen.pictures:
            shown = [
                name for name, done in zip(made, finished, strict=True) if done and [*(out / name).rglob("*.html")]
            ]
            finished += pool.map(lambda name: make(tree, out, f"pictures/{name}", partial(pictured, out / name)), shown)
    print(f"{finished.count(True)} of {len(finished)} finished")
    return finished.count(False)


def matches(name: str, patterns: Iterable[str]) -> bool:
    """Whether one of some patterns fits a name."""
    return any(fnmatch(name, pattern) for pattern in patterns)


def page_text(page: str) -> str:
    """The text of an HTML page, without code: what is beside each other on one line."""
    page = re.sub(r"(?s)<(script|style|template)\b.*?</\1>", "", page)
    page = re.sub(r"</?(?:a|abbr|b|code|em|i|kbd|strong|sub|sup)\b[^>]*>", "", re.sub(r"\s+", " ", page))
    page = re.sub(r"<[^>]+>", "\n", re.sub(r"</?(?:small|span|td|th|time)\b[^>]*>", " ", page))
    lines = (" ".join(line.split()) for line in html.unescape(page).splitlines())
    return "".join(f"{line}\n" for line in lines if line)


_NUMBER = re.compile(r"(?<![\w.,])[-\u2212]?\d+(?:,\d{3})*(?:\.\d+)?(?:e[-+]?\d+)?(?!\w|[.,]\d)")
_VOLATILE = re.compile("|".join(VOLATILE_TEXT), re.MULTILINE)
_ABSENT = "(absent)"


def steady(text: str) -> str:
    """A text without its volatile parts."""
    return _VOLATILE.sub("", text)


def numbers_of(value: Any) -> set[float]:
    """All numbers in a text without its volatile parts, or in lists and dicts."""
    if isinstance(value, str):
        return {float(number.replace(",", "").replace("\u2212", "-")) for number in _NUMBER.findall(value)}
    if isinstance(value, (dict, list)):
        return set().union(*map(numbers_of, value.values() if isinstance(value, dict) else value))
    return {float(value)} if isinstance(value, (int, float)) else set()


#: Where (ENTRY/FILE:PLACE), the old value, the new one.
Difference = tuple[str, object, object]


def walk(old: Any, new: Any, place: str, tolerance: float) -> Iterator[Difference]:
    """How two values of JSON, or two tables as lists by column, differ."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in [*old, *(key for key in new if key not in old)]:
            inner = f"{place}{'' if place.endswith(':') else '.'}{key}"
            if not matches(inner, VOLATILE_FIELDS):
                yield from walk(old.get(key, _ABSENT), new.get(key, _ABSENT), inner, tolerance)
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for number, both in enumerate(zip(old, new, strict=True) if old != new else ()):
            yield from walk(*both, f"{place}.{number}", tolerance)
    elif not same(old, new, tolerance):
        yield place, old, new


def same(old: Any, new: Any, tolerance: float) -> bool:
    """Whether two values are equal; all NaNs are."""
    if isinstance(old, str) and isinstance(new, str):
        return steady(old) == steady(new)
    if {type(old), type(new)} <= {int, float}:
        close = math.isclose(old, new, rel_tol=tolerance, abs_tol=tolerance)
        return close or (math.isnan(old) and math.isnan(new))
    return type(old) is type(new) and bool(old == new)


def load(file: Path) -> Any:
    """A file as lists and dicts; text and others as they are."""
    if file.suffix == ".json":
        return json.loads(file.read_text())
    if file.suffix == ".parquet":
        return parquet.read_table(file).to_pydict()
    if file.suffix == ".npz":
        with np.load(file) as arrays:
            return {name: arrays[name].ravel().tolist() for name in arrays.files}
    if file.suffix == ".csv":
        return csv.read_csv(io.BytesIO(steady(file.read_text()).encode())).to_pydict()
    if file.suffix == ".mcap":
        with file.open("rb") as recording:
            messages = make_reader(recording).iter_messages()
            return [[channel.topic, message.log_time, message.data] for _, channel, message in messages]
    try:
        return steady(file.read_text())
    except UnicodeDecodeError:
        return file.read_bytes()


def text_differences(old: str, new: str, place: str, *, exactly: bool) -> Iterator[Difference]:
    """How two texts differ: line by line, or by numbers of the old one that are not in the new one."""
    if exactly:
        lines, others = old.splitlines(), new.splitlines()
        for tag, first, last, begin, end in difflib.SequenceMatcher(None, lines, others, autojunk=False).get_opcodes():
            if tag != "equal":
                yield (f"{place}{first + 1}", "\n".join(lines[first:last]), "\n".join(others[begin:end]))
        return
    known = numbers_of(new)
    for number, line in enumerate(old.splitlines(), 1):
        if missing := numbers_of(line) - known:
            yield (f"{place}{number}", f"{', '.join(map(str, sorted(missing)))} in: {line}", _ABSENT)


def kind_of(place: str, file: str) -> str:
    """What a file is, for the summary. place: of its entry"""
    if place in ("help", "list"):
        return place
    if file.startswith(("export_", "kitti")):
        return "exports"
    ends = {"messages.mcap": "recordings", "metrics.json": "metrics", "output.txt": "terminal", ".json": "records"}
    ends |= dict.fromkeys((".txt", ".md", ".tex", ".html"), "pages")
    return next((kind for end, kind in ends.items() if file.endswith(end)), "tables and pictures")


def _with_lost_numbers(differences: Iterable[Difference], document: Any) -> Iterator[Difference]:
    """Of a column or a part that has gone or has another shape, how many of its numbers are nowhere in the new file."""
    known: set[float] = set()
    for place, old, new in differences:
        if isinstance(old, (list, dict)):
            known, numbers = known or numbers_of(document), numbers_of(old)
            lost = len(numbers - known)
            values = f"{len(new)} values" if isinstance(new, (list, dict)) else new
            yield place, f"{len(old)} values", f"{values}; {lost} of {len(numbers)} numbers are nowhere in this file"
        else:
            yield place, old, new


class Comparison:
    """Compares entries, prints how they differ, and counts."""

    def __init__(self, chosen: argparse.Namespace) -> None:
        self.chosen = chosen
        self.compared: Counter[str] = Counter()
        self.differing: Counter[str] = Counter()
        self.added = 0

    def entry(self, name: str) -> None:
        """Compare one entry."""
        old, new = (self._files(folder / name) for folder in (self.chosen.old, self.chosen.new))
        if "entry.json" not in new:
            self.tell("entries", [(name, "made", _ABSENT)])
            return
        before, after = (load(side["entry.json"])["exit_codes"] for side in (old, new))
        self.tell("entries", walk(before, after, f"{name}/exit_codes:", 0.0))
        for file in sorted(old | new):
            kind, place = kind_of(name, file), f"{name}/{file}:"
            if file not in old or file not in new:
                before, after = ("there" if file in side else _ABSENT for side in (old, new))
                self.tell(kind, [(place, before, after)])
            elif not file.endswith(tuple(" ".join(UNCOMPARED).split())):
                self.tell(kind, self.file(kind, old[file], new[file], place))

    @staticmethod
    def _files(folder: Path) -> dict[str, Path]:
        """The files of an entry by name, without volatile parts of names."""
        return {steady(str(file.relative_to(folder))): file for file in folder.rglob("*") if file.is_file()}

    def file(self, kind: str, old: Path, new: Path, place: str) -> Iterator[Difference]:
        """How a file differs."""
        if kind == "recordings":
            code, text = ask(ROOT, ROOT, ("diff", str(old.parent.resolve()), str(new.parent.resolve())))
            if code:
                yield (place, "equal messages", f"exit code {code} of mast diff: {text.strip()}")
        elif old.read_bytes() != new.read_bytes():
            values = load(old), load(new)
            if all(isinstance(value, str) for value in values):
                yield from text_differences(*values, place, exactly=kind not in ("pages", "terminal"))
            else:
                yield from _with_lost_numbers(walk(*values, place, self.chosen.tolerance), values[1])

    def tell(self, kind: str, differences: Iterable[Difference]) -> None:
        """Count, and print the first differences of a file."""
        self.compared[kind] += 1
        count = 0
        for place, old, new in differences:
            if matches(place, self.chosen.excepted):
                continue
            if old == _ABSENT and kind not in ("help", "list"):
                self.added += 1
                continue
            count += 1
            if count <= self.chosen.most:
                print(f"{place}\n  old: {str(old)[:600]}\n  new: {str(new)[:600]}")
        if count > self.chosen.most:
            print(f"  … and {count - self.chosen.most} more in this file")
        self.differing[kind] += count > 0


def compare_all(chosen: argparse.Namespace) -> int:
    """Compare what is wanted; returns how many files differ."""
    comparison = Comparison(chosen)
    for name in sorted(str(mark.parent.relative_to(chosen.old)) for mark in chosen.old.rglob("entry.json")):
        if matches(name, chosen.only or "*"):
            comparison.entry(name)
    for kind, count in sorted(comparison.compared.items()):
        print(f"{kind}: {count} compared, {comparison.differing[kind]} differ")
    print(f"only in the new corpus: {comparison.added} files, fields and columns")
    return comparison.differing.total()


def main(arguments: list[str] | None = None) -> int:
    """Make or compare; returns 0 if all is made, or nothing differs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    actions = parser.add_subparsers(required=True)
    making, comparing = actions.add_parser("make"), actions.add_parser("compare")
    for each, action in ((making, make_all), (comparing, compare_all)):
        each.set_defaults(action=action)
        each.add_argument("--only", action="append", default=[], metavar="PATTERN", help="of names: 'mesh/*'")
    making.add_argument("out", type=Path)
    making.add_argument("--jobs", type=int, default=1, help="entries at a time")
    making.add_argument("--tree", type=Path, default=ROOT, help="another checkout whose package is used")
    making.add_argument("--pictures", action="store_true", help="of pages and the viewer, by Chromium")
    comparing.add_argument("old", type=Path)
    comparing.add_argument("new", type=Path)
    places = "of places of intended differences: 'exports/*openlabel*'"
    comparing.add_argument("--except", action="append", default=[], dest="excepted", metavar="PATTERN", help=places)
    comparing.add_argument("--tolerance", type=float, default=0.0, help="of numbers, relative and absolute")
    comparing.add_argument("--most", type=int, default=10, help="how many differences of a file are printed")
    chosen = parser.parse_args(arguments)
    return int(chosen.action(chosen) > 0)


if __name__ == "__main__":
    sys.exit(main())
