"""A recorded scene gives the same bytes wherever its folder is."""

import os
import shutil
import tarfile
from pathlib import Path

import pytest
from equal_runs import assert_equal, run_alone

pytestmark = pytest.mark.heavy

DATA = Path(os.environ.get("MAST_DATA") or Path(__file__).parents[4] / "shared" / "data")


@pytest.fixture(scope="session")
def scene_a(tmp_path_factory: pytest.TempPathFactory) -> Path:
    archive = DATA / "scene_a.tar.gz"
    if not archive.exists():
        pytest.skip(f"no reference data: {archive} is missing (set MAST_DATA)")
    folder = tmp_path_factory.mktemp("scene_a")
    with tarfile.open(archive) as tar:
        tar.extractall(folder, filter="data")
    return folder / "scene_a"


@pytest.fixture(scope="session")
def av2_log() -> Path:
    logs = sorted((DATA / "av2_logs").glob("*/city_SE3_egovehicle.feather"))
    if not logs:
        pytest.skip(f"no reference data: no log in {DATA / 'av2_logs'} (set MAST_DATA)")
    return logs[0].parent


@pytest.mark.parametrize("scene", ["scene_a", "av2_log"])
def test_a_recorded_scene_gives_the_same_run_from_a_copied_folder(
    tmp_path: Path, request: pytest.FixtureRequest, scene: str
) -> None:
    original: Path = request.getfixturevalue(scene)
    copy = tmp_path / "elsewhere" / original.name
    shutil.copytree(original, copy)
    kind = "avstack" if scene == "scene_a" else "av2"
    attack = ("n_adversaries=1", "attack_start_s=0.2")
    assert_equal(
        *(
            run_alone(tmp_path / name, "uncoordinated", f"scene={kind}:{folder}", *attack, frames=6, record=True)
            for name, folder in (("original", original), ("copy", copy))
        )
    )
