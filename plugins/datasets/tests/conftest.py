"""Reference scenes."""

import tarfile
from pathlib import Path

import pytest
from reference_data import reference


@pytest.fixture(scope="session")
def scene_a_archive() -> Path:
    return reference("scene_a.tar.gz")


@pytest.fixture(scope="session")
def scene_a(scene_a_archive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scene_a")
    with tarfile.open(scene_a_archive) as archive:
        archive.extractall(folder, filter="data")
    return folder / "scene_a"


@pytest.fixture(scope="session")
def carla_fixture() -> Path:
    return reference("avstack_carla_fixture")


@pytest.fixture(scope="session")
def av2_logs() -> list[Path]:
    return sorted(path for path in reference("av2_logs").iterdir() if path.is_dir())
