"""Frames/s of a run without a viewer, with one, and with one whose page has stopped reading; memory of the viewer.

Viewers come and go within one run in lock-step at full speed: none, with a viewer, none, with the other kind, none.
Each window with a viewer is compared with the windows without one just before and after it, so that neither other
load, nor the start of a run, nor what the scene does at a time counts. The page is a WebSocket client, as if the
browser were on another computer; `--browser` adds Chromium on this one, which draws without a graphics card.

    python benchmarks/live_view.py [--repeats 12] [--seconds 8] [--browser]
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
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import psutil
import zenoh
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from mast_zenoh.launch.folder import read_json

CHROMIUM = "/usr/bin/chromium"
_FLAGS = ("--headless", "--no-sandbox", "--disable-background-networking", "--use-gl=angle", "--use-angle=swiftshader")
_FLAGS = (*_FLAGS, "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
_MAST = (sys.executable, "-m", "mast_zenoh")
_SETTLE_S = 2.0  # until a viewer that came or went no longer loads anything
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
                [CHROMIUM, *_FLAGS, f"--user-data-dir={profile}", "--remote-debugging-port=0", url],
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

        reader = threading.Thread(target=read)
        if kind == "reading":
            reader.start()
        try:
            yield received
        finally:
            connection.close_socket() if kind == "stopped" else connection.close()
            if kind == "reading":
                reader.join()


@contextmanager
def viewer(kind: str, out: Path) -> Iterator[None]:
    """A viewer of a run with a page of that kind; kind none: nothing."""
    with ExitStack() as stack:
        if kind != "none":
            process = subprocess.Popen([*_MAST, "view", str(out)], stdout=subprocess.PIPE, text=True)
            stack.callback(process.communicate)
            stack.callback(process.terminate)
            stack.enter_context(page(kind, url_of(process)))
        yield


def compare(repeats: int, seconds: float, kinds: list[str]) -> None:
    """Print how the frame rate with each kind of viewer differs from that without, in percent, with a 95 % interval."""
    ratios: dict[str, list[float]] = {kind: [] for kind in kinds}
    plain: list[float] = []
    with running("--frames", str(_FRAMES)) as (run, out), ExitStack() as stack:
        while not (out / "run.json").is_file() or "endpoint" not in read_json(out / "run.json"):
            time.sleep(0.1)
        record = read_json(out / "run.json")
        configuration = zenoh.Config()
        configuration.insert_json5("mode", '"client"')
        configuration.insert_json5("connect/endpoints", f'["{record["endpoint"]}"]')
        session = stack.enter_context(zenoh.open(configuration))
        played = 0

        def count(_: zenoh.Sample) -> None:
            nonlocal played
            played += 1

        session.declare_subscriber(f"mast/{record['id']}/clock", count)
        while played < 20:
            assert run.poll() is None
            time.sleep(0.1)

        def rate(kind: str) -> float:
            with viewer(kind, out):
                time.sleep(_SETTLE_S)
                begin, frames = time.monotonic(), played
                time.sleep(seconds)
                measured = (played - frames) / (time.monotonic() - begin)
            assert run.poll() is None
            return measured

        plain.append(rate("none"))
        for repeat in range(repeats):
            for kind in kinds if repeat % 2 == 0 else kinds[::-1]:
                own = rate(kind)
                plain.append(rate("none"))
                ratios[kind].append(2 * own / (plain[-2] + plain[-1]))
                print(f"  {kind}: {own:.1f} frames/s, {plain[-2]:.1f} before, {plain[-1]:.1f} after", flush=True)
    print(f"without a viewer: median {statistics.median(plain):.1f} frames/s")
    chance = np.random.default_rng(0)
    for kind, measured in ratios.items():
        samples = np.median(chance.choice(measured, (10_000, len(measured))), axis=1)
        low, high = (100 * (value - 1) for value in np.quantile(samples, (0.025, 0.975)))
        exact = 100 * (statistics.median(measured) - 1)
        print(f"{kind:>8}: median {exact:+.1f} % ({low:+.1f} to {high:+.1f}) of {len(measured)}")


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
    parser.add_argument("--repeats", type=int, default=12)
    parser.add_argument("--seconds", type=float, default=8.0, help="length of a window")
    parser.add_argument("--browser", action="store_true")
    parser.add_argument("--minutes", type=float)
    arguments = parser.parse_args()
    if arguments.minutes:
        memory(arguments.minutes)
    else:
        names = ["reading", "stopped", *(["browser"] if arguments.browser else [])]
        compare(arguments.repeats, arguments.seconds, names)
