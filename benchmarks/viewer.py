"""How fast the viewer opens and follows its slider, in Chromium without a graphics card.

    python benchmarks/viewer.py [--run FOLDER] [--report] [--opens 7] [--moves 60] [--width 1600]

Without --run it plays 500 frames of the generated junction with 45 objects, five agents, two adversaries and a command
centre that judges agents. It measures the page of `mast view`; with --report the report, which also holds the figures.

Opening is from the request to the finished first picture. A move of the slider is from the input event to the end of
drawing, with the wait for the next frame of the screen; moves are 60 ms apart, because the emulated graphics card takes
about that long to put a frame together. `script` is what drawing itself takes. Medians and 95th percentiles are on the
wall clock: compare them on a machine without other work. `CPU` is the time that the page's main thread used per opening
or move, without waiting: compare it anywhere.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import tempfile
from pathlib import Path
from typing import Any

from mast_zenoh import scenario
from mast_zenoh.launch import run as launcher
from mast_zenoh.show.html import write_report
from mast_zenoh.show.page.page import viewer_page

sys.path.append(str(Path(__file__).parents[1] / "tools"))
from chromium import browser as chromium

FRAMES, SEED = 500, 1
#: ms between two moves.
PAUSE = 60
OBJECTS = {"n_vehicles": 25, "n_bicycles": 5, "n_pedestrians": 15}
#: Moves the slider to a frame, and returns ms to the end of drawing, and ms of drawing.
MOVE = """(frame) => new Promise((done) => {
  const slider = document.querySelector(".v-slider");
  if (!viewer.timed) {
    const draw = viewer.draw;
    viewer.draw = () => {
      const began = performance.now();
      draw.call(viewer);
      viewer.timed = performance.now() - began;
    };
  }
  const began = performance.now();
  slider.value = String(frame);
  slider.dispatchEvent(new Event("input", { bubbles: true }));
  requestAnimationFrame(() => done([performance.now() - began, viewer.timed ?? 0]));
})"""
#: Notes when a page has drawn its first picture, in ms since the request.
READY = """new MutationObserver((_, observer) => {
  if (!document.querySelector(".viewer.v-ready")) return;
  observer.disconnect();
  requestAnimationFrame(() => { window.firstPicture = performance.now(); });
}).observe(document, { subtree: true, childList: true, attributes: true, attributeFilter: ["class"] })"""
#: What the page shows while the slider moves.
SETTINGS = {
    "one panel": "viewer.state.showPanels(1)",
    "three panels": "viewer.state.showPanels(3)",
    "one camera": "viewer.state.showPanels(1); viewer.state.choose(0, { eye: 'camera' })",
    "three panels, all layers": """viewer.state.showPanels(3); viewer.state.choose(0, { eye: 'above' });
      viewer.state.set({ layers: Object.fromEntries(Object.keys(viewer.state.layers).map((name) => [name, true])) })""",
}


def play(folder: Path) -> Path:
    """Play the run to measure."""
    settings = [f"scene.{name}={count}" for name, count in OBJECTS.items()]
    path, loaded = scenario.load("defended", ["attack_start_s=4.0", "defence=SequentialConsistency", *settings])
    resolved = scenario.resolve(path, loaded, frames=FRAMES, record=True, seed=SEED)
    return launcher.run(resolved, folder / "run", runtime="inproc").folder


def open_page(browser: Any, address: str, width: int) -> tuple[Any, float, float]:
    """The opened page, ms until its first picture, ms of work in its main thread."""
    page = browser.new_page(viewport={"width": width, "height": 1000})
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})
    page.add_init_script(READY)
    page.goto(address)
    page.wait_for_selector(".viewer.v-ready", timeout=120_000)
    ready = page.evaluate("() => new Promise((done) => requestAnimationFrame(() => done(window.firstPicture)))")
    return page, float(ready), busy_ms(session)


def busy_ms(session: Any) -> float:
    """ms of CPU that the main thread of a page has used so far."""
    metrics = {each["name"]: each["value"] for each in session.send("Performance.getMetrics")["metrics"]}
    return 1000.0 * float(metrics["TaskDuration"])


def line(name: str, values: list[float], cpu: float | None = None) -> None:
    """Print a line of the table."""
    p95 = sorted(values)[min(int(0.95 * len(values)), len(values) - 1)]
    print(f"{name:34}{statistics.median(values):10.1f}{p95:10.1f}" + ("" if cpu is None else f"{cpu:10.1f}"))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path)
    parser.add_argument("--report", action="store_true")
    parser.add_argument("--opens", type=int, default=7)
    parser.add_argument("--moves", type=int, default=60)
    parser.add_argument("--width", type=int, default=1600)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        run = arguments.run or play(Path(folder))
        path = Path(folder) / "view.html"
        if arguments.report:
            path = write_report(run)
        else:
            path.write_bytes(viewer_page([run], 250))
        print(
            f"{path.stat().st_size / 1e6:.2f} MB; load {os.getloadavg()[0]:.1f} on {len(os.sched_getaffinity(0))} cores"
        )
        print(f"{'ms':34}{'median':>10}{'95 %':>10}{'CPU':>10}")
        opened = [open_page(browser, path.as_uri(), arguments.width) for _ in range(arguments.opens)]
        line("open", [ready for _, ready, _ in opened], statistics.median(cpu for _, _, cpu in opened))
        for other, _, _ in opened[1:]:
            other.close()
        page = opened[0][0]
        session = page.context.new_cdp_session(page)
        session.send("Performance.enable", {"timeDomain": "threadTicks"})
        for name, action in SETTINGS.items():
            page.evaluate(action)
            frames = page.evaluate("viewer.state.runs[0].frames")
            before, moves = busy_ms(session), []
            for step in range(arguments.moves):
                moves.append(page.evaluate(MOVE, (step * 97 + 31) % frames))
                page.wait_for_timeout(PAUSE)
            busy = (busy_ms(session) - before) / arguments.moves
            line(f"slider, {name}", [total for total, _ in moves], busy)
            line("  script", [drawing for _, drawing in moves])


if __name__ == "__main__":
    main()
