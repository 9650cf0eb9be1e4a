"""Code shared by tools that disturb runs: arguments, output, leftover processes."""

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

GONE_S = 10.0  # from the end of the launcher to the end of its last node


class PlanResult(NamedTuple):
    """The outcome of a plan.

    number: of the plan; done: the disturbances; how: how the run ended; broken: promises that it broke
    """

    number: int
    done: str
    how: str
    broken: list[str]


def parser(doc: str | None, runs: int) -> argparse.ArgumentParser:
    """The common arguments of these tools; doc: docstring of the tool's module."""
    arguments_parser = argparse.ArgumentParser(description=(doc or "").partition("\n")[0])
    arguments_parser.add_argument("--runs", type=int, default=runs)
    arguments_parser.add_argument("--seed", type=int, default=0)
    arguments_parser.add_argument("--only", type=int, help="the number of one run")
    return arguments_parser


def numbers(arguments: argparse.Namespace) -> Iterable[int]:
    """The numbers of the plans to carry out."""
    return range(arguments.runs) if arguments.only is None else [arguments.only]


def report_results(plan_results: Iterable[PlanResult], seed: int, *more: str) -> NoReturn:
    """Print a line per plan; exit with 1 if any run broke a promise.

    For such runs, also print the command that repeats them.

    more: other arguments of that command
    """
    endings: Counter[str] = Counter()
    failed = 0
    for number, done, how, broken in plan_results:
        endings[how] += 1
        print(f"{number:4} {done}: {how}", flush=True)
        repeat = ["python", sys.argv[0], "--seed", str(seed), "--only", str(number), *more]
        for promise in broken:
            failed += 1
            print(f"     BROKEN: {promise}\n     {shlex.join(repeat)}", flush=True)
    print("; ".join(f"{count} {how}" for how, count in endings.most_common()))
    sys.exit(1 if failed else 0)


def left_behind(out: Path) -> list[int]:
    """Ids of processes with the run folder on their command line that do not end."""
    deadline = time.monotonic() + GONE_S
    while (left := _processes(out)) and time.monotonic() < deadline:
        threading.Event().wait(0.1)
    return left


def _processes(out: Path) -> list[int]:
    process_ids = []
    for process in psutil.process_iter(["cmdline", "status"]):
        alive = process.info["status"] != psutil.STATUS_ZOMBIE and process.pid != os.getpid()
        if alive and any(str(out) in word for word in process.info["cmdline"] or ()):
            process_ids.append(process.pid)
    return process_ids
