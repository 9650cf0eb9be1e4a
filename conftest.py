"""Options and fixtures for all tests."""

import os
import signal
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from importlib.metadata import distributions
from itertools import count
from pathlib import Path

import pytest
from fuzzing import Fuzzing
from hypothesis import HealthCheck, settings
from launched import Launched
from painting import leave_unpainted

# The duration of an example depends on the machine, not on the code.
settings.register_profile("quick", deadline=None, max_examples=25, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("fuzz", settings.get_profile("quick"), max_examples=1000)
settings.load_profile("quick")

# Under nohup all commands would inherit that hangups are ignored.
signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the longest files first, then tests that start processes: they mostly wait, others fill the time."""
    items.sort(key=lambda item: [item.get_closest_marker(marker) is None for marker in ("long", "mesh")])


def pytest_configure(config: pytest.Config) -> None:
    """Have the plugins of this checkout found that are on the path but not installed, also by child processes.

    With `--fuzz`, tests of properties try more examples.
    """
    if config.getoption("fuzz"):
        settings.load_profile("fuzz")
    folder = tempfile.TemporaryDirectory(prefix="mast-plugins-")
    config.add_cleanup(folder.cleanup)
    for file in Path(__file__).parent.glob("plugins/*/pyproject.toml"):
        project = tomllib.loads(file.read_text(encoding="utf-8"))["project"]
        if any(distributions(name=project["name"])) or str(file.parent) not in sys.path:
            continue
        info = Path(folder.name) / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
        )
        points = (f"{name} = {module}\n" for name, module in project["entry-points"]["mast_zenoh.plugins"].items())
        (info / "entry_points.txt").write_text("".join(["[mast_zenoh.plugins]\n", *points]))
        sys.path.append(folder.name)
        os.environ["PYTHONPATH"] = os.pathsep.join([os.environ.get("PYTHONPATH", ""), folder.name])


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--fuzz", action="store_true", help="make many more random draws")
    parser.addoption("--fuzz-seed", type=int, default=0, help="what malformed messages are drawn from (default: 0)")


def pytest_report_header(config: pytest.Config) -> list[str]:
    return [f"malformed messages: seed {config.getoption('fuzz_seed')}"] if config.getoption("fuzz") else []


@pytest.fixture
def fuzzing(request: pytest.FixtureRequest) -> Fuzzing:
    """Number and seed of the malformed messages that fuzz tests send."""
    return Fuzzing(request.config.getoption("fuzz"), request.config.getoption("fuzz_seed"))


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Launched]]:
    """Starts runs by command in their own folders; kills those still running.

    afterwards: called with each run after its end
    """
    numbers = count()
    with ExitStack() as stack:

        def begin(
            *command: str, afterwards: Callable[[Launched], None] = lambda _: None, **environment: str
        ) -> Launched:
            run = Launched(tmp_path / f"run_{next(numbers)}", *command, **environment)
            stack.callback(afterwards, run)
            stack.callback(run.kill)
            return run

        yield begin


@pytest.fixture
def tiny_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 3 MB, almost filled by a short run; skips where not mountable."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", str(place)], capture_output=True)
    if mounted.returncode:
        pytest.skip("mounting a disk needs root")
    try:
        yield place
    finally:
        subprocess.run(["umount", str(place)], check=True)


@pytest.fixture
def unpainted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures of pages are one pixel."""
    leave_unpainted(monkeypatch)


@pytest.fixture
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages of runs have words and tables only."""
    monkeypatch.setattr("mast_zenoh.show.figures.of_run.run_figures", lambda context: {})


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Iterator[Path]:
    """Scenes of tests use their own cache, also in child processes; all workers share one."""
    folder = tmp_path_factory.mktemp("cache")
    if worker_id != "master":
        shared = tmp_path_factory.getbasetemp().parent / "scenes"
        shared.mkdir(exist_ok=True)
        (folder / "mast-zenoh").mkdir()
        (folder / "mast-zenoh" / "scenes").symlink_to(shared)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        yield folder


@pytest.fixture
def mast(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Callable[..., tuple[int, str, str]]:
    """Run a command in this process and in an empty folder; returns exit code, stdout and stderr."""
    from mast_zenoh.cli import app

    monkeypatch.chdir(tmp_path)

    def run(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["mast", *words])
        with pytest.raises(SystemExit) as raised:
            app.main()
        printed = capsys.readouterr()
        return int(raised.value.code or 0), printed.out, printed.err

    return run
