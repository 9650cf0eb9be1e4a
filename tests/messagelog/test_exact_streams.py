"""Runs in one process are byte-identical under irrelevant changes."""

from __future__ import annotations

import os
import shutil
import tarfile
from pathlib import Path

import pytest
from recordings import run
from tiny_world import Run, tiny

from mast_zenoh.messagelog.difference import compare, explain
from mast_zenoh.messagelog.reader import read

pytestmark = pytest.mark.heavy

DATA = Path(os.environ.get("MAST_DATA") or Path(__file__).parents[3] / "shared" / "data")


def equal(a: Path, b: Path, **options: bool) -> int:
    """Assert that two runs are equal; returns the number of messages."""
    difference = compare(a, b, **options)
    assert difference.first is None, "\n".join(explain(difference))
    return difference.equal


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


def test_a_thousand_delivery_orders_give_the_same_bytes() -> None:
    resolved = tiny("coordinated", "n_adversaries=1", "attack_start_s=0.1", frames=3)
    plain = Run(resolved, encode=False)
    assert plain.messages["attack/adversary_1/report"], "the attack has started"
    for shuffle in range(1000):
        assert Run(resolved, encode=False, shuffle=shuffle).messages == plain.messages, f"order {shuffle}"


@pytest.mark.parametrize("infrastructure", [1, 2, 5])
@pytest.mark.parametrize("name", ["coordinated", "uncoordinated"])
def test_repeating_a_run_gives_the_same_bytes(tmp_path: Path, name: str, infrastructure: int) -> None:
    settings = (f"n_infrastructure={infrastructure}", "n_adversaries=1", "attack_start_s=0.2")
    a, b, c = (run(tmp_path / x, name, *settings, seed=seed) for x, seed in (("a", 0), ("b", 0), ("c", 1)))
    assert equal(a, b, taps=True) == len(list(read(a)))
    assert compare(a, c).first is not None


@pytest.mark.parametrize("infrastructure", [1, 2, 5])
def test_interposers_that_change_nothing_leave_no_trace(tmp_path: Path, infrastructure: int) -> None:
    setting = f"n_infrastructure={infrastructure}"
    plain, tapped = (run(tmp_path / name, name, setting) for name in ("baseline", "passthrough"))
    assert equal(plain, tapped) == len(list(read(plain)))
    assert compare(plain, tapped, taps=True).only_b.total() == 6 * 2 * (infrastructure + 1)


def test_additional_agents_change_nothing_for_the_others(tmp_path: Path) -> None:
    runs = {n: run(tmp_path / str(n), "baseline", f"n_infrastructure={n}") for n in (1, 2, 5)}
    payloads = {
        n: {(m.key, m.frame): m.payload for m in read(folder) if m.message == "pose" or m.message == "clock"}
        for n, folder in runs.items()
    }
    assert payloads[1].items() <= payloads[2].items() <= payloads[5].items()


@pytest.mark.parametrize("scene", ["scene_a", "av2_log"])
def test_a_recorded_scene_gives_the_same_run_from_a_copied_folder(
    tmp_path: Path, request: pytest.FixtureRequest, scene: str
) -> None:
    original: Path = request.getfixturevalue(scene)
    copy = tmp_path / "elsewhere" / original.name
    shutil.copytree(original, copy)
    kind = "avstack" if scene == "scene_a" else "av2"
    a, b = (
        run(tmp_path / name, "uncoordinated", f"scene={kind}:{folder}", "n_adversaries=1", "attack_start_s=0.2")
        for name, folder in (("original", original), ("copy", copy))
    )
    assert equal(a, b, taps=True) > 100
