"""Makes every picture in docs/ and README.md: one recipe for each.

python tools/pictures.py            all of them: `make pictures`
python tools/pictures.py NAME ...   some: `make pictures PICTURES="interception.gif viewer.png"`
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import chromium
import interception_film
from chromium import Unavailable

import mast_zenoh as mast
from mast_zenoh.errors import nearest
from mast_zenoh.launch import twin
from mast_zenoh.show import html
from mast_zenoh.show.page.live_server import PageServer
from mast_zenoh.show.page.page import policy, viewer_page
from mast_zenoh.study import definition, interface

FOLDER = Path(__file__).parents[1] / "docs" / "images"
#: The frame of the attacked run that pictures show: long after the attack began.
_FRAME = 73


@dataclass(frozen=True)
class Workshop:
    """What recipes share. folder: for runs, removed in the end"""

    folder: Path

    @cached_property
    def attacked(self) -> mast.Run:
        """The shipped scenario with two uncoordinated adversaries."""
        return mast.run("uncoordinated", frames=150, out=self.folder / "uncoordinated")

    @cached_property
    def unattacked(self) -> mast.Run:
        """The same scene without adversaries."""
        return mast.run("baseline", frames=150, out=self.folder / "baseline")


def case_study(out: Path, workshop: Workshop) -> None:
    """The figure of `mast study case_study` in which three runs are side by side."""
    study = workshop.folder / "case_study"
    finished = interface.run_once(definition.load("case_study", ()).chosen(runtime="inproc"), study)
    html.write_study_report(study, finished.folders)
    out.write_bytes((study / "figures" / "side_by_side.png").read_bytes())


def driven(out: Path, workshop: Workshop) -> None:
    """The figure of `mast run driving --set attack=GhostAhead --against twin`."""
    run = mast.run("driving", attack="GhostAhead", scene_index=2, out=workshop.folder / "driven")
    html.write_report(run.path, against=twin.of(run.path))
    out.write_bytes((run.path / "figures" / "driven.png").read_bytes())


def interception(out: Path, workshop: Workshop) -> None:
    """The film of an adversary that is inserted live."""
    interception_film.make(out, workshop.folder / "interception")


def snapshot(out: Path, workshop: Workshop) -> None:
    """A still of the ego's own tracks and of the picture."""
    workshop.attacked.snapshot(out, _FRAME, estimates=("local", "picture"), camera=True)


def side_by_side(out: Path, workshop: Workshop) -> None:
    """A film of an attacked run beside the unattacked one."""
    workshop.unattacked.animate(out, against=workshop.attacked, start=30, end=80, size="1000x640", dpi=90)


def viewer(out: Path, workshop: Workshop) -> None:
    """A screenshot of `mast view`; raises Unavailable without playwright or Chromium."""
    shown = viewer_page([workshop.attacked.path], _FRAME)
    with chromium.browser() as browser, PageServer(shown, policy()) as server:
        page = browser.new_page(viewport={"width": 1280, "height": 800}, color_scheme="dark")
        page.goto(server.url)
        page.wait_for_selector(".viewer.v-ready", timeout=60_000)
        page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        page.screenshot(path=str(out))


def search(out: Path, workshop: Workshop) -> None:
    """The figure of `mast study search`."""
    finished = mast.study("search", out=workshop.folder / "search")
    out.write_bytes((finished.path / "search.png").read_bytes())


def cooperation(out: Path, workshop: Workshop) -> None:
    """The figure of `mast study cooperation`, as on docs/explanation-v2x.md: 6 minutes on two cores."""
    finished = mast.study(
        "cooperation", out=workshop.folder / "cooperation", architectures="centre,peers,radio", agents="5,20"
    )
    out.write_bytes((finished.path / "cooperation.png").read_bytes())


def worst_detections(out: Path, workshop: Workshop) -> None:
    """The figure of `python benchmarks/detector.py --worst FOLDER`."""
    script = Path(__file__).parents[1] / "benchmarks" / "detector.py"
    folder = workshop.folder / "worst"
    subprocess.run([sys.executable, script, "--worst", folder], check=True, stdout=subprocess.DEVNULL)
    out.write_bytes((folder / "worst_detections.png").read_bytes())


#: By name of the file.
RECIPES: dict[str, Callable[[Path, Workshop], None]] = {
    "case_study.png": case_study,
    "cooperation.png": cooperation,
    "driven.png": driven,
    "interception.gif": interception,
    "search.png": search,
    "snapshot.png": snapshot,
    "side_by_side.gif": side_by_side,
    "viewer.png": viewer,
    "worst_detections.png": worst_detections,
}


def main(names: list[str]) -> int:
    """Make pictures; returns 1 if one could not be made."""
    if unknown := [name for name in names if name not in RECIPES]:
        print(f"no recipe for {unknown[0]!r}{nearest(unknown[0], RECIPES)}", file=sys.stderr)
        return 2
    left_out = 0
    with tempfile.TemporaryDirectory(prefix="pictures-") as temporary:
        workshop = Workshop(Path(temporary))
        for name in names or RECIPES:
            new = Path(temporary) / name
            try:
                RECIPES[name](new, workshop)
            except Unavailable as reason:
                print(f"left out: {name}: {reason}", file=sys.stderr)
                left_out += 1
                continue
            target = FOLDER / name
            changed = not target.is_file() or target.read_bytes() != new.read_bytes()
            target.write_bytes(new.read_bytes())
            print(f"{'new' if changed else 'as before'}: docs/images/{name} ({target.stat().st_size / 1e6:.2f} MB)")
    return int(left_out > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
