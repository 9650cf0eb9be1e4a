"""Frames/s of a run without a viewer, with one, and with one whose page has stopped reading; memory of the viewer.

The page is a WebSocket client, as if the browser were on another computer; `--browser` adds a run with Chromium on this
one, which draws without a graphics card. Runs alternate, so that other load affects all kinds alike.

    python benchmarks/live_view.py [--frames 600] [--repeats 5] [--browser] [--minutes 10]

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
from contextlib import contextmanager
from pathlib import Path

import psutil
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from mast_zenoh.launch.folder import read_json

CHROMIUM = "/usr/bin/chromium"
_FLAGS = ("--headless", "--no-sandbox", "--disable-background-networking", "--use-gl=angle", "--use-angle=swiftshader")
_FLAGS = (*_FLAGS, "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")


@contextmanager
def page(kind: str, url: str, stop: threading.Event) -> Iterator[list[int]]:
    """A page of the viewer; yields the bytes that it has received."""
    received = [0]
    address = f"ws://{url.removeprefix('http://')}frames"
    if kind == "browser":
        with tempfile.TemporaryDirectory() as profile:
            browser = subprocess.Popen(
                [CHROMIUM, *_FLAGS, f"--user-data-dir={profile}", "--remote-debugging-port=0", url]
            )
            try:
                yield received
            finally:
                browser.terminate()
                browser.wait()
        return
    with connect(address, max_size=None) as connection:

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


def frame_rate(kind: str, frames: int, words: list[str]) -> float:
    """Frames/s of one run. kind: none, reading, stopped or browser"""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        view = [] if kind == "none" else ["--view"]
        command = [sys.executable, "-m", "mast_zenoh", "run", "baseline", "--frames", str(frames), "--no-report"]
        run = subprocess.Popen([*command, *words, *view, "--out", str(out)], stdout=subprocess.PIPE, text=True)
        assert run.stdout is not None
        if kind == "none":
            run.communicate()
        else:
            url = next(match[1] for line in run.stdout if (match := re.search(r"view: (http\S+)", line)))
            with page(kind, url, threading.Event()):
                run.communicate()
        assert run.returncode == 0
        return float(read_json(out / "run.json")["timings"]["frames_per_second"])


def compare(frames: int, repeats: int, kinds: list[str], words: list[str]) -> None:
    """Print the median rate of each kind, and its difference from the one without a viewer."""
    rates: dict[str, list[float]] = {kind: [] for kind in kinds}
    for repeat in range(repeats):
        for kind in kinds if repeat % 2 == 0 else kinds[::-1]:
            rates[kind].append(frame_rate(kind, frames, words))
            print(f"  {kind}: {rates[kind][-1]:.1f} frames/s", flush=True)
    for kind in kinds:
        ratios = [own / plain for own, plain in zip(rates[kind], rates["none"], strict=True)]
        change = 100 * (statistics.median(ratios) - 1)
        print(f"{kind:>8}: median {statistics.median(rates[kind]):.1f} frames/s, {change:+.1f} % against none")


def memory(minutes: float) -> None:
    """Print the memory of the viewer every half minute."""
    with tempfile.TemporaryDirectory() as folder:
        frames = str(round(minutes * 600) + 300)
        command = [sys.executable, "-m", "mast_zenoh", "run", "baseline", "--frames", frames, "--mode", "realtime"]
        command += ["--no-report", "--no-record", "--view", "--out", f"{folder}/run"]
        run = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert run.stdout is not None
        url = next(match[1] for line in run.stdout if (match := re.search(r"view: (http\S+)", line)))
        viewer = next(each for each in psutil.Process(run.pid).children() if "view" in each.cmdline())
        with page("reading", url, threading.Event()) as received:
            end = time.monotonic() + 60 * minutes
            while time.monotonic() < end:
                time.sleep(min(30.0, 60 * minutes / 4))
                print(f"viewer {viewer.memory_info().rss >> 20} MiB, page got {received[0] >> 10} KiB", flush=True)
        run.terminate()
        run.communicate()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=600)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--browser", action="store_true")
    parser.add_argument("--minutes", type=float)
    arguments = parser.parse_args()
    if arguments.minutes:
        memory(arguments.minutes)
    else:
        names = ["none", "reading", "stopped", *(["browser"] if arguments.browser else [])]
        compare(arguments.frames, arguments.repeats, names, [])
