"""Python examples of pages run as written, and the pages name all that their readers need."""

import importlib.util
import inspect
import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

import mast_zenoh as mast
from mast_zenoh import scenario
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.wiring.model import Wiring

DOCS = Path(__file__).parents[2] / "docs"
RADAR = "agent/infra_1/detections/radar"
STONE_SOUP = (DOCS / "how-to-stone-soup.md").read_text(encoding="utf-8")
COMMANDS = [shlex.split(line) for line in re.findall(r"^    mast (.*)$", STONE_SOUP, flags=re.M)]

needs_stone_soup = pytest.mark.skipif(
    importlib.util.find_spec("stonesoup") is None, reason="Stone Soup is not installed"
)
Played = Callable[[str], dict[str, Any]]


def page(name: str) -> str:
    return (DOCS / f"{name}.md").read_text(encoding="utf-8")


@pytest.fixture
def names_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Played:
    """Runs all Python blocks of a page in a folder of their own; returns the names that they define."""
    monkeypatch.chdir(tmp_path)

    def played(name: str) -> dict[str, Any]:
        blocks = re.findall(r"^```python\n(.*?)^```$", page(name), flags=re.S | re.M)
        assert len(blocks) == len(re.findall(r"^```\w", page(name), flags=re.M)), "a block that no test runs"
        names: dict[str, Any] = {"__name__": __name__}
        for block in blocks:
            exec(compile(block, f"{name}.md", "exec"), names)
        return names

    return played


def test_the_link_of_the_page_is_on_the_detections_of_the_ego() -> None:
    text = page("how-to-scenarios")
    (example,) = re.findall(r"^### On other wires\n.*?^```python\n(.*?)^```$", text, flags=re.S | re.M)
    names: dict[str, Any] = {}
    exec(example, names)
    path, content = scenario.load("baseline", ["n_infrastructure=1"])
    resolved = scenario.resolve(path, content | names["lossy_cable"], frames=2)
    on = {wire.key: wire.interposers for wire in Wiring.from_json(resolved.wiring).wires if wire.interposers}
    assert on == {"agent/ego/detections": ("sensor_cable",)}


def test_the_blocks_on_scene_arrays_run(names_of: Played) -> None:
    names = names_of("ref-detections-and-arrays")
    assert names["scene"].agents == names["run"].agents == ("ego", "infra_1", "infra_2")
    assert names["run"].summary["agents"]["ego"]["picture"]["tp"]["mean"] > 15


def test_the_blocks_on_sensors_run(names_of: Played) -> None:
    names = names_of("how-to-sensors")
    times = names["road"].agent("infra_1").detections.column("time_s").unique().to_pylist()
    assert times[:3] == pytest.approx([0.07, 0.27, 0.47])
    pole = names["run"].agent("infra_1")
    assert pole.detections_of("lidar").equals(pole.detections)
    with pytest.raises(ConfigurationError, match=r"infra_1.*'rada'.*'radar'"):
        pole.detections_of("rada")
    attacks = names["run"].attacks.to_pandas()
    assert set(attacks["wire"]) == {RADAR}
    assert {"inserted"} <= set(attacks[attacks["interposer"] == "liar"]["effect"])
    assert set(attacks[attacks["interposer"] == "cable"]["effect"]) == {"dropped"}


@needs_stone_soup
def test_the_builder_of_the_page_tracks_objects(tmp_path: Path) -> None:
    for name, text in re.findall(r"^```python file=(\S+)\n(.*?)^```$", STONE_SOUP, flags=re.S | re.M):
        (tmp_path / name).write_text(text)
    run = mast.run(str(tmp_path / "singer.py"), frames=20, n_infrastructure=1, out=str(tmp_path / "run"))
    assert run.summary["agents"]["ego"]["local"]["tp"]["mean"] > 5.0


@needs_stone_soup
def test_the_options_of_the_default_tracker_are_listed_with_their_defaults() -> None:
    from mast_zenoh.tracking import stone_soup_default

    rows = dict(re.findall(r"^\| `(\w+)` \| ([\d.]+)[^|]* \| [^|]+ \|$", STONE_SOUP, flags=re.M))
    parameters = inspect.signature(stone_soup_default.build).parameters
    assert {name: float(value) for name, value in rows.items()} == {
        name: float(parameter.default) for name, parameter in parameters.items()
    }


@pytest.mark.heavy
@pytest.mark.timeout(300)
def test_the_blocks_on_the_python_interface_run(names_of: Played, tmp_path: Path) -> None:
    names = names_of("how-to-python")
    assert (tmp_path / "birdseye.png").stat().st_size > 10_000
    assert names["mine"].attacks.num_rows > names["run"].attacks.num_rows
    assert names["study"].table().num_rows > 100


def cells() -> list[str]:
    notebook = json.loads((DOCS / "notebook.ipynb").read_text(encoding="utf-8"))
    assert notebook["nbformat"] == 4
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] for cell in code), "outputs are not kept, as they become outdated"
    return ["".join(cell["source"]) for cell in code]


@pytest.mark.heavy
def test_the_notebook_plots_false_positives_of_two_runs_in_fewer_than_15_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code = cells()
    assert sum(bool(line.strip()) for cell in code for line in cell.splitlines()) < 15
    names: dict[str, Any] = {}
    displayed = []
    for cell in code:  # like a notebook: display the value of the last line
        *body, last = cell.splitlines()
        exec("\n".join(body), names)
        displayed.append(eval(last, names))
    assert not list(tmp_path.iterdir()), "it writes into a temporary folder"
    run, over_time, birdseye, _ = displayed
    assert isinstance(run, mast.Run)
    assert isinstance(over_time, Figure)
    labels = {line.get_label() for line in over_time.axes[0].get_lines()}
    assert {"picture, baseline", "picture, uncoordinated"} <= labels
    assert "false objects" in over_time.axes[0].get_ylabel()
    for figure in (over_time, birdseye):
        assert figure._repr_png_()[:4] == b"\x89PNG"
