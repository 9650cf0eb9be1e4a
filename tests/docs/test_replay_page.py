"""The page on replays works as written, and its table is right."""

import json
from pathlib import Path

import pytest
from page_commands import play_page

from mast_zenoh.messagelog.difference import compare

PAGE = (Path(__file__).parents[2] / "docs" / "replay.md").read_text(encoding="utf-8")

pytestmark = [pytest.mark.heavy, pytest.mark.mesh, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which all files of the page were written and all its commands were run, in order."""
    return play_page(PAGE, tmp_path_factory.mktemp("replay"), least=6)


def test_every_file_and_command_of_the_page_works_as_written(folder: Path) -> None:
    printed = (folder / "printed").read_text()
    assert "equal: 60 messages" in printed
    for changed in ("pipeline.clustering.assign_radius", "file, type", "file, type, witnesses"):
        assert f"live: broker, command_center (changed: {changed}), evaluator, recorder" in printed
    assert compare(folder / "recorded", folder / "same", wires=("cc/picture",)).first is None
    assert compare(folder / "recorded", folder / "wider", wires=("cc/picture",)).first is not None


def test_the_table_of_the_page_has_the_measured_numbers(folder: Path) -> None:
    for row, measure in (("false (FP)", "fp"), ("missed (FN)", "fn")):
        metrics = [
            json.loads((folder / run / "metrics.json").read_text()) for run in ("recorded", "witnessed", "strict")
        ]
        numbers = [f"{each['agents']['ego']['picture'][measure]['mean']:.2f}" for each in metrics]
        assert f"| {row} | {' | '.join(numbers)} |" in PAGE
