"""What holds for all tests."""

import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import count
from pathlib import Path

import pytest
from fuzzing import Fuzzing
from hypothesis import HealthCheck, settings
from launched import Launched

# How long an example takes says something about the machine, not about the code.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")

# Whoever starts the tests under nohup has all commands inherit that a hangup is ignored.
signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests that start processes come first: they wait for most of their time, and others fill it."""
    items.sort(key=lambda item: item.get_closest_marker("mesh") is None)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--fuzz", action="store_true", help="send many more malformed messages in the fuzz tests")
    parser.addoption("--fuzz-seed", type=int, default=0, help="what the fuzz tests draw from (default: 0)")


def pytest_report_header(config: pytest.Config) -> list[str]:
    return [f"fuzz tests: seed {config.getoption('fuzz_seed')}"] if config.getoption("fuzz") else []


@pytest.fixture
def fuzzing(request: pytest.FixtureRequest) -> Fuzzing:
    """How many malformed messages a fuzz test sends, and from which seed."""
    return Fuzzing(request.config.getoption("fuzz"), request.config.getoption("fuzz_seed"))


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Launched]]:
    """Starts runs by command, each in a folder of its own; kills those that the test has left running.

    afterwards: called with each when it has ended
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
    """A disk of 3 MB, which a short run almost fills; skips the test where none can be mounted."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", str(place)], capture_output=True)
    if mounted.returncode:
        pytest.skip("mounting a disk needs root")
    try:
        yield place
    finally:
        subprocess.run(["umount", str(place)], check=True)


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Scenes prepared by tests do not touch the user's cache, nor come from it; processes inherit it."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        yield folder
