"""Frames/s of a run without a viewer, with one, and with one whose page has stopped reading; memory of the viewer.

Viewers come and go within one run in lock-step at full speed: none, with a viewer, none, with the other kind, none.
Each window with a viewer is compared with the windows without one just before and after it, so that neither other
load, nor the start of a run, nor what the scene does at a time counts. The page is a WebSocket client, as if the
browser were on another computer; `--browser` adds Chromium on this one, which draws without a graphics card.

    python benchmarks/live_view.py [--runs 3] [--seconds 8] [--browser]
    python benchmarks/live_view.py --minutes 10

--minutes: instead, how the memory of the viewer develops while a page reads, in real time
"""

from __future__ import annotations

import argparse
import re
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from itertools import count
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil
import zenoh
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from mast_zenoh.mesh.session import open_client
from mast_zenoh.run_folder import read_json

sys.path.append(str(Path(__file__).parents[1] / "tools"))
from chromium import FLAGS, PROGRAM

_MAST = (sys.executable, "-m", "mast_zenoh")
_SETTLE_S = 3.0  # from the first frame, or the end of a viewer; longer than a stopped page is waited for
_LAST = 0.9  # of the frames of a run: what is left is enough for two windows
_FRAMES = 20_000  # of the run; its scene takes minutes to prepare, once


@contextmanager
def running(*words: str) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """A run of `baseline` and its folder."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        command = [*_MAST, "run", "baseline", "--no-report", *words, "--out", str(out)]
        run = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            yield run, out
        finally:
            run.terminate()
            run.communicate()


def url_of(process: subprocess.Popen[str]) -> str:
    """Where a viewer's page is, from what `mast` prints."""
    assert process.stdout is not None
    return next(match[1] for line in process.stdout if (match := re.search(r"(http://\S+)", line)))


@contextmanager
def page(kind: str, url: str) -> Iterator[list[int]]:
    """A page of the viewer; yields the bytes that it has received. kind: reading, stopped or browser"""
    received = [0]
    if kind == "browser":
        with tempfile.TemporaryDirectory() as profile:
            browser = subprocess.Popen(
                [str(PROGRAM), "--headless", *FLAGS, f"--user-data-dir={profile}", "--remote-debugging-port=0", url],
                stderr=subprocess.DEVNULL,
            )
            try:
                yield received
            finally:
                browser.terminate()
                browser.wait()
        return
    with connect(f"ws://{url.removeprefix('http://')}frames", max_size=None) as connection:

        def read() -> None:
            try:
                for message in connection:
                    received[0] += len(message)
                    if isinstance(message, bytes):
                        connection.send("shown")
            except ConnectionClosed:
                pass

        while not isinstance(connection.recv(timeout=120.0), bytes):
            pass  # until the first frame: the viewer has loaded everything
        reader = threading.Thread(target=read)
        if kind == "reading":
            connection.send("shown")
            reader.start()
        try:
            yield received
        finally:
            connection.close_socket() if kind == "stopped" else connection.close()
            if kind == "reading":
                reader.join()


@contextmanager
def viewer(kind: str, out: Path) -> Iterator[list[psutil.Process]]:
    """A viewer of a run with a page of that kind; yields its processes. kind none: nothing"""
    processes: list[psutil.Process] = []
    with ExitStack() as stack:
        if kind != "none":
            process = subprocess.Popen([*_MAST, "view", str(out)], stdout=subprocess.PIPE, text=True)
            stack.callback(process.communicate)
            stack.callback(process.terminate)
            stack.enter_context(page(kind, url_of(process)))
            own = psutil.Process(process.pid)
            processes = [own, *own.children(recursive=True)]
        yield processes


def processor_s(processes: list[psutil.Process]) -> float:
    """Processor time that processes have used, s."""
    times = [process.cpu_times() for process in processes]
    return float(sum(each.user + each.system for each in times))


class Window(NamedTuple):
    """A window of a run: frames/s, the viewer's share of a processor, %, and the run's processor time, ms a frame."""

    rate: float
    share: float
    effort: float


@contextmanager
def counted_frames(out: Path) -> Iterator[Callable[[], int]]:
    """The number of frames of a run that have begun since now; waits until it plays."""
    while not (out / "run.json").is_file() or "endpoint" not in read_json(out / "run.json"):
        time.sleep(0.1)
    record = read_json(out / "run.json")
    played = 0

    def on_clock(_: zenoh.Sample) -> None:
        nonlocal played
        played += 1

    with open_client(record["endpoint"]) as session:
        session.declare_subscriber(f"mast/{record['id']}/clock", on_clock)
        while played < 20:
            time.sleep(0.1)
        yield lambda: played


#: An observer of a kind of the run in a folder: yields its processes. kind none: nothing
Beside = Callable[[str, Path], AbstractContextManager[list[psutil.Process]]]


def windows(kinds: Sequence[str], seconds: float, beside: Beside) -> Iterator[tuple[str, Window]]:
    """Measure one run as long as it plays: none, a kind, none, another kind, none, ..."""
    with running("--frames", str(_FRAMES)) as (run, out), counted_frames(out) as played:
        launcher = psutil.Process(run.pid)
        own = [launcher, *launcher.children(recursive=True)]
        for number in count():
            kind = "none" if number % 2 == 0 else kinds[number // 2 % len(kinds)]
            with beside(kind, out) as processes:
                time.sleep(_SETTLE_S)
                begin, frames = time.monotonic(), played()
                used, of_run = processor_s(processes), processor_s(own)
                time.sleep(seconds)
                passed, frames = time.monotonic() - begin, played() - frames
                share = 100 * (processor_s(processes) - used) / passed
                window = Window(frames / passed, share, 1000 * (processor_s(own) - of_run) / frames)
            assert run.poll() is None
            yield kind, window
            if kind == "none" and played() > _LAST * _FRAMES:
                return


def compare(runs: int, seconds: float, kinds: list[str], beside: Beside = viewer, name: str = "viewer") -> None:
    """Print how the frame rate with each kind of observer differs from that without, in percent, with a 95 % interval.

    name: of the observers
    """
    ratios: dict[str, list[float]] = {kind: [] for kind in kinds}
    shares: dict[str, list[float]] = {kind: [] for kind in kinds}
    efforts: dict[str, list[float]] = {kind: [] for kind in kinds}
    plain: list[float] = []
    for turn in range(runs):
        before, viewed = Window(0.0, 0.0, 0.0), ("", Window(0.0, 0.0, 0.0))
        for kind, window in windows(kinds if turn % 2 == 0 else kinds[::-1], seconds, beside):
            if kind != "none":
                viewed = kind, window
                continue
            plain.append(window.rate)
            if before.rate:
                shown, own = viewed
                ratios[shown].append(2 * own.rate / (before.rate + window.rate))
                efforts[shown].append(2 * own.effort / (before.effort + window.effort))
                shares[shown].append(own.share)
                for title, values in (
                    ("frames/s", (own.rate, before.rate, window.rate)),
                    ("ms a frame", (own.effort, before.effort, window.effort)),
                ):
                    during, earlier, later = (f"{value:.1f}" for value in values)
                    print(f"  {shown}: {during} {title}, {earlier} before, {later} after", flush=True)
            before = window
    print(f"without a {name}: median {statistics.median(plain):.1f} frames/s")
    chance = np.random.default_rng(0)
    for kind in kinds:
        samples = np.median(chance.choice(ratios[kind], (10_000, len(ratios[kind]))), axis=1)
        low, high = (100 * (value - 1) for value in np.quantile(samples, (0.025, 0.975)))
        median = 100 * (statistics.median(ratios[kind]) - 1)
        print(f"{kind:>8}: median {median:+.1f} % ({low:+.1f} to {high:+.1f}) of {len(ratios[kind])} windows,")
        print(f"          processor time of the run: {100 * (statistics.median(efforts[kind]) - 1):+.1f} % a frame,")
        print(f"          with {statistics.median(shares[kind]):.1f} % of a processor for the {name}")


def memory(minutes: float) -> None:
    """Print the memory of the viewer every half minute."""
    frames = str(round(minutes * 600) + 300)
    with running("--frames", frames, "--mode", "realtime", "--no-record", "--view") as (run, _):
        url = url_of(run)
        observer = next(each for each in psutil.Process(run.pid).children() if "view" in each.cmdline())
        with page("reading", url) as received:
            end = time.monotonic() + 60 * minutes
            while time.monotonic() < end:
                time.sleep(min(30.0, 60 * minutes / 4))
                print(f"viewer {observer.memory_info().rss >> 20} MiB, page got {received[0] >> 10} KiB", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=8.0, help="length of a window")
    parser.add_argument("--browser", action="store_true")
    parser.add_argument("--minutes", type=float)
    arguments = parser.parse_args()
    if arguments.minutes:
        memory(arguments.minutes)
    else:
        names = ["reading", "stopped", *(["browser"] if arguments.browser else [])]
        compare(arguments.runs, arguments.seconds, names)
