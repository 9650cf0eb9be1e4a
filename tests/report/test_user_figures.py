"""User figures in reports; a report never runs the files of a run folder."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from mast_zenoh.cli.app import app
from mast_zenoh.config import loading
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.runs.run import Run
from mast_zenoh.show.figures.of_run import OURS, user_figures
from mast_zenoh.show.html import write_report
from mast_zenoh.show.run_figure import SECTIONS, FigureContext, RunFigure

Folder = Callable[..., Path]
PNG = b"\x89PNG\r\n\x1a\n" + bytes(100)

FIGURES = """
from mast_zenoh.show import RunFigure


class Blank(RunFigure):
    '''An empty chart of <frame> numbers.'''

    heading = "Blank"
    after = "AFTER"

    def draw(self, context):
        from matplotlib.figure import Figure

        assert (context.folder / "run.json").is_file()
        figure = Figure(figsize=(2, 1))
        figure.text(0.5, 0.5, f"frame {context.frame}")
        return figure


class NothingToShow(RunFigure):
    def draw(self, context):
        return None


class Unfinished(RunFigure):
    pass
"""
BROKEN = """
from mast_zenoh.show import RunFigure


class Torn(RunFigure):
    after = "wiring"

    def draw(self, context):
        raise KeyError("no such table")


class Text(RunFigure):
    def draw(self, context):
        return "a figure"


class Camera(RunFigure):
    def draw(self, context):
        return None


class Lost(RunFigure):
    after = "nowhere"

    def draw(self, context):
        return None
"""


def written(path: Path, text: str, after: str = "time") -> Path:
    path.write_text(text.replace("AFTER", after))
    return path


@pytest.mark.usefixtures("unpainted")
def test_a_figure_follows_the_section_that_it_names(run_folder: Folder, tmp_path: Path) -> None:
    folder, file = run_folder(), written(tmp_path / "mine.py", FIGURES, "nodes")
    done = CliRunner().invoke(app, ["report", str(folder), "--figures", str(file)])
    assert done.exit_code == 0, done.output
    page = (folder / "report.html").read_text()
    assert '<h2 id="blank">Blank</h2>' in page
    assert '<figure class="natural">\n<img src="data:image/png' in page, "a small figure is not enlarged"
    assert page.count("&lt;frame&gt; numbers") == 2, "caption and alternative text, escaped"
    headings = [part.split('"')[0] for part in page.split('<h2 id="')[1:]]
    assert headings.index("blank") == headings.index("nodes") + 1
    assert "nothing_to_show" not in page
    assert "Unfinished" not in page
    with pytest.raises(ConfigurationError, match=r"torn.py:1: "):
        write_report(folder, figures=[written(tmp_path / "torn.py", "1 / 0\n")])


@pytest.mark.usefixtures("unpainted")
def test_figures_of_a_loaded_scenario_are_drawn(run_folder: Folder, tmp_path: Path) -> None:
    file = written(tmp_path / "mine.py", FIGURES)
    loading.module(file)
    page = write_report(run_folder(scenario={"modules": [str(file)]}), frame=7).read_text()
    headings = [part.split('"')[0] for part in page.split('<h2 id="')[1:]]
    assert headings.index("blank") == headings.index("time") + 1


@pytest.mark.usefixtures("unpainted")
def test_a_file_that_a_run_folder_names_is_not_run(run_folder: Folder, tmp_path: Path) -> None:
    file = written(tmp_path / "evil.py", FIGURES + f"\nopen({str(tmp_path / 'was here')!r}, 'w')\n")
    assert 'id="blank"' not in write_report(run_folder(scenario={"modules": [str(file)]})).read_text()
    assert not (tmp_path / "was here").exists()


def test_a_later_report_shows_what_was_drawn_before(run_folder: Folder, tmp_path: Path) -> None:
    folder = run_folder()
    first = write_report(folder, figures=[written(tmp_path / "mine.py", FIGURES)]).read_bytes()
    (tmp_path / "mine.py").unlink()
    assert write_report(folder).read_bytes() == first


def test_a_broken_list_of_earlier_figures_is_left_out(run_folder: Folder, tmp_path: Path) -> None:
    folder, good = run_folder(), {"name": "birdseye", "heading": "", "after": "time", "alt": "", "caption": ""}
    (tmp_path / "secret.png").write_bytes(PNG)
    for name, picture in (("text", b"no picture"), ("birdseye", PNG)):
        (folder / "figures" / f"{name}.png").write_bytes(picture)

    def shown(content: str) -> int:
        (folder / "figures" / "user_figures.json").write_text(content)
        return len(user_figures(FigureContext(Run(folder), None)))

    assert shown(json.dumps([good])) == 1
    for broken in (
        {"name": "../../secret"},
        {"name": "text"},
        {"name": "absent"},
        {"heading": 1},
        {"after": "nowhere"},
    ):
        assert shown(json.dumps([good | broken])) == 0, broken
    assert [shown(content) for content in ("no JSON", "{}", "[1]")] == [0, 0, 0]


@pytest.mark.usefixtures("unpainted")
def test_a_figure_that_cannot_be_drawn_is_named_with_the_reason(run_folder: Folder, tmp_path: Path) -> None:
    file = written(tmp_path / "broken.py", BROKEN)
    page = write_report(run_folder(), figures=[file]).read_text().replace("&#39;", "'")
    assert "drawn: KeyError: 'no" in page
    assert "broken.py:9)" in page
    assert "drawn: TypeError: draw" in page
    assert "drawn: ValueError: name" in page
    assert "drawn: ValueError: after" in page
    assert page.count('<h2 id="camera">') == 1, "the built-in one is there too"


@pytest.mark.usefixtures("unpainted")
def test_no_figure_changes_the_rest_of_the_report(run_folder: Folder, tmp_path: Path) -> None:
    folder = run_folder()
    source = """
from mast_zenoh.show import RunFigure

class Forger(RunFigure):
    def draw(self, context):
        context.run.metrics["agents"]["ego"]["picture"]["fp"]["mean"] = -77.0

class Leaver(RunFigure):
    def draw(self, context):
        exit(3)

class Nameless(RunFigure):
    name = 5
    def draw(self, context):
        return None
"""
    page = write_report(folder, figures=[written(tmp_path / "hostile.py", source)]).read_text()
    assert "-77" not in page
    assert "\u221277" not in page, "with a minus sign"
    assert "drawn: SystemExit: 3" in page
    assert "drawn: ValueError" in page


def test_the_built_in_figures_use_the_same_base_class(run_folder: Folder) -> None:
    assert {kind.label() for kind in OURS} == {
        "birdseye",
        "trust",
        "camera",
        "counts",
        "causes",
        "driven",
        "driving",
        "wiring",
    }
    context = FigureContext(Run(run_folder("uncoordinated")), None)
    drawn: dict[str, Any] = {kind.label(): kind().draw(context) for kind in OURS}
    assert {name for name, figure in drawn.items() if figure is not None} == {"counts", "wiring"}
    assert all(issubclass(kind, RunFigure) and kind.after in SECTIONS for kind in OURS)


def test_a_file_with_a_figure_can_be_loaded_without_matplotlib(tmp_path: Path) -> None:
    file = written(tmp_path / "mine.py", FIGURES)
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import {file.stem}; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
