"""What the tools that disturb runs at random have in common: their arguments, their lines, processes left behind."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple, NoReturn

import psutil

GONE_S = 10.0  # from the end of the launcher to that of its last node


class Tried(NamedTuple):
    """A plan carried out: its number, what was done, how the run ended, and the promises that it broke."""

    number: int
    done: str
    how: str
    broken: list[str]


def parser(doc: str | None, runs: int) -> argparse.ArgumentParser:
    """The arguments of all these tools; doc: of the tool's module."""
    made = argparse.ArgumentParser(description=(doc or "").partition("\n")[0])
    made.add_argument("--runs", type=int, default=runs)
    made.add_argument("--seed", type=int, default=0)
    made.add_argument("--only", type=int, help="the number of one run")
    return made


def numbers(arguments: argparse.Namespace) -> Iterable[int]:
    """Of the plans to carry out."""
    return range(arguments.runs) if arguments.only is None else [arguments.only]


def tell(tried: Iterable[Tried], seed: int, *more: str) -> NoReturn:
    """Print a line for each plan, and the command that repeats one that broke a promise; exit with 1 if any did.

    more: arguments that belong to that command
    """
    endings: Counter[str] = Counter()
    failed = 0
    for number, done, how, broken in tried:
        endings[how] += 1
        print(f"{number:4} {done}: {how}", flush=True)
        repeat = ["python", sys.argv[0], "--seed", str(seed), "--only", str(number), *more]
        for promise in broken:
            failed += 1
            print(f"     BROKEN: {promise}\n     {shlex.join(repeat)}", flush=True)
    print("; ".join(f"{count} {how}" for how, count in endings.most_common()))
    sys.exit(1 if failed else 0)


def left_behind(out: Path) -> list[int]:
    """Processes with the run folder on their command line that do not end."""
    deadline = time.monotonic() + GONE_S
    while (left := _processes(out)) and time.monotonic() < deadline:
        threading.Event().wait(0.1)
    return left


def _processes(out: Path) -> list[int]:
    found = []
    for process in psutil.process_iter(["cmdline", "status"]):
        alive = process.info["status"] != psutil.STATUS_ZOMBIE and process.pid != os.getpid()
        if alive and any(str(out) in word for word in process.info["cmdline"] or ()):
            found.append(process.pid)
    return found
