"""What commands print fits a terminal of 80 columns, and --quiet prints nothing but problems."""

from io import StringIO
from pathlib import Path

import failing
import pytest
from rich.console import Console

from mast_zenoh.api import catalogue
from mast_zenoh.cli import scenarios
from mast_zenoh.cli.console import PlainConsole
from mast_zenoh.show.tables.text_table import TextTable

SHORT = ("--runtime", "inproc", "--frames", "8")


def test_listings_fit_80_columns_and_name_everything(mast) -> None:
    for kind in ("", *catalogue.KINDS):
        code, out, _ = mast("list", *([kind] if kind else []))
        assert code == 0
        assert max(map(len, out.splitlines())) <= 80
        names = catalogue.list_kind(kind).names if kind else catalogue.KINDS
        assert all(name in out for name in names)


def test_the_wiring_fits_a_terminal_and_is_a_line_for_each_wire_elsewhere(mast, monkeypatch) -> None:
    scenario = ("wiring", "coordinated", "--set", "n_adversaries=2")
    _, plain, _ = mast(*scenario)
    clock = next(line for line in plain.splitlines() if line.startswith("  clock "))
    assert clock.endswith("adversary_1, adversary_2, coordinator")
    monkeypatch.setattr(scenarios, "_out", lambda: PlainConsole(force_terminal=True, width=80))
    _, wrapped, _ = mast(*scenario)
    assert max(map(len, wrapped.splitlines())) <= 80
    assert wrapped.split() == plain.split()


def test_tables_of_studies_fit_80_columns_and_cut_no_word() -> None:
    """Six columns with intervals, and names of attacks and defences in full."""
    headings = ["attack", "breakdown point (%)", "bound (%)", "difference (percentage points)", "honest first", "n"]
    numbers = ["> 80 [> 80, > 80]", "3.42 [3.10, 3.80]", "not reached [1.20, \u221e)", "0.000 [0.000, 0.975] of 2"]
    lines = [[name, *numbers, "21"] for name in ("coordinated", "UncoordinatedAttack", "Overconfidence")]
    file = StringIO()
    table = TextTable("Breakdown points", "A long sentence about it. " * 9, headings, lines, 1)
    Console(file=file, width=80).print(table.as_rich(), soft_wrap=True)
    printed = file.getvalue()
    assert max(map(len, printed.splitlines())) <= 80
    assert "\u2026" not in printed
    for word in " ".join([*headings, *(cell for line in lines for cell in line)]).split():
        assert word in printed


@pytest.mark.usefixtures("without_figures")
def test_a_quiet_run_that_goes_well_prints_nothing(mast, tmp_path: Path) -> None:
    long_enough = ("--frames", "40", "--set", "n_infrastructure=1")
    assert mast("run", "baseline", *SHORT[:2], *long_enough, "--quiet", "--out", "here") == (0, "", "")
    assert (tmp_path / "here" / "report.html").is_file()
    assert "run folder:" in mast("run", "baseline", *SHORT, "--no-report", "--out", "loud")[1]


def test_a_quiet_run_prints_warnings_and_errors_to_standard_error(mast, tmp_path: Path) -> None:
    path = str(failing.write("attack", tmp_path))
    code, out, err = mast("run", path, *SHORT, "-q", "--no-report", "--out", "failed")
    assert (code, out) == (30, "")
    assert "unsettled: too short" in err
    assert "error: HandlerFailed: " in err
    assert "eve.on_detections failed" in err
    assert "frame 4 of 8" not in err
