"""Commands and nodes load only the packages that they need: loading takes most of the time of a short run."""

import subprocess
import sys
from pathlib import Path

import pytest

NODES = Path(__file__).parents[2] / "nodes"
#: What only the launcher or a report needs.
SLOW = {"asyncssh", "cryptography", "dask", "jinja2", "matplotlib", "PIL", "pyarrow", "rich", "typer"}


def loaded_by(code: str) -> set[str]:
    """The modules that a new process has after some code."""
    program = f"{code}\nimport sys\nprint('loaded:', *sys.modules)"
    process = subprocess.run([sys.executable, "-P", "-c", program], capture_output=True, text=True, check=True)
    return set(process.stdout.splitlines()[-1].removeprefix("loaded: ").split())


IMPORT_NODE = f"import sys\nsys.path.insert(0, {str(NODES)!r})\nimport mast_zenoh.mesh.hosting, "


@pytest.mark.parametrize(
    ("names", "absent"),
    [
        ("simulator, broker, recorder, link", {"scipy", "filterpy", *SLOW}),
        ("agent, adversary, command_center, coordinator, evaluator", SLOW),
    ],
    ids=["without a pipeline", "with one"],
)
def test_nodes_load_nothing_that_they_do_not_need(names: str, absent: set[str]) -> None:
    assert not absent & loaded_by(IMPORT_NODE + names)


def test_a_run_without_a_report_loads_no_drawing_library(tmp_path: Path) -> None:
    words = ("run", "baseline", "--runtime", "inproc", "--frames", "2", "--no-report", "--out", str(tmp_path / "run"))
    loaded = loaded_by(f"from mast_zenoh.cli import app\napp.app({list(words)!r}, standalone_mode=False)")
    assert (tmp_path / "run" / "objects.parquet").is_file()
    assert not {"matplotlib", "PIL", "pandas", "pyarrow.compute"} & loaded


IMPORTED = """
import gc, signal, sys, threading

def state():
    collecting = gc.isenabled(), gc.get_threshold(), gc.get_freeze_count()
    return collecting, signal.getsignal(signal.SIGINT), threading.active_count()

before = state()
import mast_zenoh
mast_zenoh.run, mast_zenoh.study
import mast_zenoh.cli.app, mast_zenoh.testing.simulation
sys.exit(f"{before} became {state()}" if before != state() else 0)
"""


def test_importing_the_package_leaves_garbage_collection_signals_and_threads_as_they_are() -> None:
    process = subprocess.run([sys.executable, "-P", "-c", IMPORTED], capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
