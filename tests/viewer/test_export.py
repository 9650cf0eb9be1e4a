"""An export is complete or not there at all, and says what it lacks."""

import shutil
import sys
from pathlib import Path

import pytest
from commands_in_process import command

import mast_zenoh as mast
from mast_zenoh.errors import ExportError, RunFolderError
from mast_zenoh.show.export import export, pcap
from mast_zenoh.show.formats import FORMATS, GONE


@pytest.mark.parametrize(("name", "instead"), GONE.items())
def test_a_format_that_is_gone_names_what_serves_instead(
    recorded: mast.Run, out: Path, name: str, instead: str
) -> None:
    code, _, err = command("export", str(recorded.path), "--to", name, "-o", str(out))
    assert code == ExportError.exit_code
    assert f"--to {name}" in " ".join(err.split())
    with pytest.raises(ExportError, match=f"--to {name}.*gone"):
        recorded.export(name, out)
    assert not out.exists()


def test_the_command_names_what_it_wrote_and_what_is_missing(recorded: mast.Run, tmp_path: Path) -> None:
    folder = shutil.copytree(recorded.path, tmp_path / "copy")
    (folder / "objects.parquet").unlink()
    code, out, err = command("export", str(folder), "--to", "mot", "-o", str(tmp_path / "mot"))
    assert code == 0
    assert f"exported: {tmp_path / 'mot'}" in out
    assert "warning: objects.parquet" in err
    assert (tmp_path / "mot" / "seqmap.txt").is_file()


@pytest.mark.parametrize("name", FORMATS)
def test_a_damaged_recording_and_a_write_error_leave_nothing_behind(
    recorded: mast.Run, broadcast: mast.Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    run = broadcast if name == "pcap" else recorded
    folder = shutil.copytree(run.path, tmp_path / "copy")
    content = bytearray((folder / "messages.mcap").read_bytes())
    content[len(content) // 2] ^= 0xFF
    (folder / "messages.mcap").write_bytes(content)
    with pytest.raises(RunFolderError, match="a damaged chunk"):
        export(folder, name, tmp_path / "exported")

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pcap, "packet", fail)
    monkeypatch.setattr("mast_zenoh.runs.recorded.read", fail)
    with pytest.raises(mast.MastError, match=r"space left.*device"):
        export(run.path, name, tmp_path / "exported")
    assert [path.name for path in tmp_path.iterdir()] == ["copy"]


def test_nothing_is_overwritten(recorded: mast.Run, tmp_path: Path) -> None:
    for name in ("run.mcap", "new.layout.json"):
        (tmp_path / name).write_text("mine")
    code, _, err = command("export", str(recorded.path), "--to", "csv", "-o", str(tmp_path / "run.mcap"))
    assert code == ExportError.exit_code
    assert "exists already: expected" in err
    with pytest.raises(ExportError, match=r"new\.layout\.json: exists already"):
        export(recorded.path, "foxglove", tmp_path / "new.mcap")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        "run.mcap": "mine",
        "new.layout.json": "mine",
    }


def test_a_folder_that_does_not_exist_and_an_unknown_format_are_named(recorded: mast.Run, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"no folder .*nothing'"):
        export(recorded.path, "csv", tmp_path / "nothing" / "run.csv")
    with pytest.raises(ExportError, match=r"unknown.*'foxgove'.*'foxglove'"):
        export(recorded.path, "foxgove", tmp_path / "run.mcap")
    code, _, err = command("export", str(recorded.path), "--to", "foxgove", "-o", str(tmp_path / "run.mcap"))
    assert code == 2
    assert "mean 'foxglove'" in " ".join(err.replace("│", " ").split())
    code, _, err = command("export", str(tmp_path / "nowhere"), "--to", "pcap")
    assert code == RunFolderError.exit_code
    assert "nowhere: no such" in " ".join(err.split()), "before the missing name of a file"
    code, _, err = command("export", str(recorded.path), "--to", "pcap")
    assert code == 2
    assert "file or folder" in " ".join(err.split())


@pytest.mark.parametrize(
    ("name", "package", "extra"),
    [("foxglove", "foxglove", "foxglove"), ("rrd", "rerun", "rerun")],
)
def test_a_package_that_is_not_installed_is_named_with_its_extra(
    recorded: mast.Run, out: Path, monkeypatch: pytest.MonkeyPatch, name: str, package: str, extra: str
) -> None:
    monkeypatch.delitem(sys.modules, f"mast_zenoh.show.export.{name}", raising=False)
    for module in [module for module in sys.modules if module.split(".")[0] == package]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, package, None)
    code, _, err = command("export", str(recorded.path), "--to", name, "-o", str(out))
    assert code == ExportError.exit_code
    assert f"pip install 'mast-zenoh[{extra}]'" in " ".join(err.split())
    assert not out.exists()
