"""tools/corpus.py finds what differs between two corpora, and nothing else."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import corpus
import corpus_entries
import numpy as np
import pyarrow as pa
import pytest
from equal_runs import run_alone
from pyarrow import parquet

RUN = "inproc/baseline-1/run"
METRICS, TABLE, OUTPUT = f"{RUN}/metrics.json", f"{RUN}/objects.parquet", "inproc/baseline-1/output.txt"
CSV = "exports/centre/export_csv.csv"
PAGE = "<h1>Run baseline-{}</h1><tr><td>missed</td><td>4.18</td></tr><p>42 frames/s"


def fill(folder: Path, run_id: str) -> None:
    """A corpus with a file of each kind."""
    texts = {
        f"{RUN}/run.json": json.dumps(
            {"id": f"baseline-{run_id}", "status": "ok", "nodes": {"ego": {"pid": 7, "exit": 0}}}
        ),
        METRICS: json.dumps({"ego": {"fn": {"mean": 4.25, "std": float("nan")}, "tp": [1, 2, 3]}}),
        f"{RUN}/report.txt": corpus.page_text(PAGE.format(run_id)),
        OUTPUT: "$ mast run\nbaseline: frame 15 of 60 26/s\nmisses 1,204 objects, \u22120.05 m\n",
        "help/mast.run.txt": "Usage: mast run\n  --out  Folder for the results\n",
        "list/list.json": json.dumps({"attacks": {"Flood": ["  Sends much", "    rate = 2.0"]}}),
        f"exports/centre/export_mot/baseline-{run_id}.txt": "1,2,3.5\n",
        CSV: "frame,x\n1,2.5\n2,nan\n",
    }
    for name, text in texts.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    for name in ("inproc/baseline-1", "help", "list", "exports/centre"):
        (folder / name / "entry.json").write_text(json.dumps({"exit_codes": [0, 18], "seconds": run_id}))
    columns = {"frame": [0, 1, 2], "x": [0.1, float("nan"), 0.3], "who": ["ego", None, "infra_1"]}
    parquet.write_table(pa.table(columns), folder / TABLE)
    np.savez(folder / RUN / "scene.npz", position=np.arange(6.0).reshape(3, 2))


@pytest.fixture
def corpora(tmp_path: Path) -> tuple[Path, Path]:
    """Two that differ in what is volatile alone."""
    fill(tmp_path / "old", "0123abcd")
    fill(tmp_path / "new", "89efef01")
    return tmp_path / "old", tmp_path / "new"


def compared(corpora: tuple[Path, Path], capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, str]:
    """(exit code, output) of the comparison."""
    code = corpus.main(["compare", *map(str, corpora), *options])
    return code, capsys.readouterr().out


def test_what_is_volatile_is_no_difference(corpora: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    run = corpora[1] / RUN / "run.json"
    run.write_text(run.read_text().replace('"pid": 7', '"pid": 1234'))
    output = corpora[1] / OUTPUT
    output.write_text(output.read_text().replace("15 of 60 26/s", "16 of 60 83/s"))
    code, text = compared(corpora, capsys)
    assert code == 0, text
    assert "metrics: 1 compared" in text
    assert "exports: 2 compared" in text


def replaced(file: str, old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        text = (folder / file).read_text()
        assert text.count(old) == 1
        (folder / file).write_text(text.replace(old, new))

    return change


def altered(change: Callable[[dict[str, list[Any]]], Any]) -> Callable[[Path], None]:
    """A change of the columns of a Parquet file."""

    def alter(folder: Path) -> None:
        columns = parquet.read_table(folder / TABLE).to_pydict()
        change(columns)
        parquet.write_table(pa.table(columns), folder / TABLE)

    return alter


@pytest.mark.parametrize(
    ("change", "place", "old", "new"),
    [
        (replaced(METRICS, "4.25", "4.250000001"), f"{METRICS}:ego.fn.mean", "4.25", "4.250000001"),
        (replaced(METRICS, "[1, 2, 3]", "[1, 2]"), f"{METRICS}:ego.tp", "3 values", "2 values; 1 of 3"),
        (replaced(METRICS, '"mean"', '"average"'), f"{METRICS}:ego.fn.mean", "4.25", "(absent)"),
        (replaced(f"{RUN}/run.json", '"ok"', '"failed"'), f"{RUN}/run.json:status", "ok", "failed"),
        (altered(lambda columns: columns["x"].__setitem__(2, 0.31)), f"{TABLE}:x.2", "0.3", "0.31"),
        (altered(lambda columns: columns["who"].__setitem__(1, "")), f"{TABLE}:who.1", "None", ""),
        (altered(lambda columns: columns.pop("frame")), f"{TABLE}:frame", "3 values", "(absent); 3 of 3"),
        (replaced(f"{RUN}/report.txt", "4.18", "4.19"), f"{RUN}/report.txt:2", "4.18 in: missed 4.18", "(absent)"),
        (replaced(OUTPUT, "1,204", "1,205"), f"{OUTPUT}:3", "1204.0 in: misses", "(absent)"),
        (replaced("help/mast.run.txt", "Folder", "Place"), "help/mast.run.txt:2", "  --out  Folder", "  --out  Place"),
        (replaced("list/list.json", '"attacks"', '"more": {}, "attacks"'), "list/list.json:more", "(absent)", "{}"),
        (replaced(CSV, "2.5", "2.25"), f"{CSV}:x.0", "2.5", "2.25"),
        (replaced("exports/centre/entry.json", "18", "0"), "exports/centre/exit_codes:.1", "18", "0"),
        (lambda folder: (folder / RUN / "scene.npz").unlink(), f"{RUN}/scene.npz:", "there", "(absent)"),
        (lambda folder: (folder / "help/entry.json").unlink(), "help", "made", "(absent)"),
    ],
)  # fmt: skip
def test_a_difference_is_found_with_its_place_and_both_values(
    corpora: tuple[Path, Path],
    capsys: pytest.CaptureFixture[str],
    change: Callable[[Path], None],
    place: str,
    old: str,
    new: str,
) -> None:
    change(corpora[1])
    code, text = compared(corpora, capsys)
    assert code == 1
    assert f"{place}\n  old: {old}" in text
    assert f"\n  new: {new}" in text
    assert compared(corpora, capsys, "--except", f"{place}*")[0] == 0


def test_what_is_new_is_counted_and_no_difference(
    corpora: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    altered(lambda columns: columns.update(more=[1, 2, 3]))(corpora[1])
    (corpora[1] / RUN / "more.json").write_text("{}")
    code, text = compared(corpora, capsys)
    assert code == 0
    assert "corpus: 2 files" in text


def test_numbers_may_differ_by_the_tolerance(corpora: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    replaced(METRICS, "4.25", "4.250000001")(corpora[1])
    assert compared(corpora, capsys, "--tolerance", "1e-12")[0] == 1
    assert compared(corpora, capsys, "--tolerance", "1e-6")[0] == 0


def test_recordings_are_compared_message_by_message(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for side, seed in (("old", 1), ("new", 1), ("other", 2)):
        place = tmp_path / side / "inproc/a"
        run_alone(place / "run", "baseline", "n_infrastructure=1", seed=seed, frames=3, record=True)
        (place / "entry.json").write_text('{"exit_codes": [0]}')
    assert compared((tmp_path / "old", tmp_path / "new"), capsys)[0] == 0
    code, text = compared((tmp_path / "old", tmp_path / "other"), capsys)
    assert code == 1
    assert "diff: first difference" in text


def test_what_is_finished_is_not_made_again_and_what_has_failed_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    calls: list[str] = []

    def refused(tree: Path, folder: Path) -> list[int]:
        calls.append("refused")
        return [corpus_entries.note(folder, "export", 18, "none")]

    def failing(tree: Path, folder: Path) -> list[int]:
        calls.append("failing")
        return [corpus_entries.note(folder, "run", 20 if calls.count("failing") == 1 else 0, "<p>")]

    monkeypatch.setattr(corpus, "entries", lambda tree: {"a/refused": refused, "b/failing": failing})
    assert corpus.main(["make", str(tmp_path), "--tree", str(tmp_path), "--only", "b/*"]) == 1
    assert "MADE: b/failing: exit" in capsys.readouterr().err
    assert corpus.main(["make", str(tmp_path), "--tree", str(tmp_path)]) == 0
    assert corpus.main(["make", str(tmp_path), "--tree", str(tmp_path)]) == 0
    assert calls == ["failing", "refused", "failing"]
    assert json.loads((tmp_path / "a/refused/entry.json").read_text())["exit_codes"] == [18]
    shutil.rmtree(tmp_path / "a")
    assert corpus.main(["make", str(tmp_path), "--tree", str(tmp_path)]) == 0
    assert calls[3:] == ["refused"]


def test_everything_that_is_played_is_shipped() -> None:
    shipped = {kind: {file.stem for file in (corpus.ROOT / kind).glob("*.py")} for kind in ("scenarios", "studies")}
    made = corpus_entries.entries(corpus.ROOT)
    assert shipped["scenarios"] >= {words[0] for words in corpus_entries.VARIANTS.values()}
    assert corpus_entries.VARIANTS.keys() | shipped["scenarios"] >= set(corpus_entries.ON_MESH)
    assert shipped["studies"] >= corpus_entries.STUDIES.keys()
    assert {f"inproc/{name}-{seed}" for name in shipped["scenarios"] for seed in (1, 2)} <= made.keys()
    assert sum(name.startswith("mesh/") for name in made) == 10
    assert len(corpus_entries.STUDIES) == 8


def test_a_page_is_text_without_code_what_is_side_by_side_on_one_line() -> None:
    page = "<script>let a = 1;\n</script><h1>A <b>run</b>\n of 3</h1><tr><td>FN</td><td class='n'>4.2</td></tr>&minus;1"
    assert corpus.page_text(page) == "A run of 3\nFN 4.2\n\u22121\n"


def test_numbers_of_a_text_are_no_parts_of_words_or_versions() -> None:
    text = "infra_1 has 1,204 in 6-49 at \u22120.05, 1e-6 or 12 % of 7.; numpy 2.4.6, 3D, 5a6f"
    assert corpus.numbers_of(text) == {1204.0, 6.0, 49.0, -0.05, 1e-6, 12.0, 7.0}
