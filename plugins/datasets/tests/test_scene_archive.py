"""Archives are unpacked within limits and never outside their folder."""

from __future__ import annotations

import io
import tarfile
import tempfile
import tracemalloc
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from carla_writer import write_run
from mast_datasets import avstack
from mast_datasets.avstack import AVstackScene

from mast_zenoh.errors import SceneError

MB = 1_000_000


class Zeros(io.RawIOBase):
    """A file of the requested number of zeros that uses no memory."""

    def readable(self) -> bool:
        return True

    def readinto(self, buffer) -> int:
        buffer[:] = bytes(len(buffer))
        return len(buffer)


def add(tar: tarfile.TarFile, name: str, size: int = 0, kind: bytes = tarfile.REGTYPE, linkname: str = "") -> None:
    member = tarfile.TarInfo(name)
    member.size, member.type, member.linkname = size, kind, linkname
    tar.addfile(member, Zeros() if size else None)


def packed(path: Path, *fill: Callable[[tarfile.TarFile], None], mode: str = "w:gz") -> Path:
    with tarfile.open(path, mode) as tar:
        for each in fill:
            each(tar)
    return path


def unpacked(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def test_unpacking_stops_before_the_file_that_exceeds_the_limit(tmp_path: Path) -> None:
    bomb = packed(tmp_path / "bomb.tar.gz", *(lambda tar, k=k: add(tar, f"{k}.txt", 3 * MB) for k in range(10)))
    assert bomb.stat().st_size < MB / 10
    reason = r"bomb\.tar\.gz: too large: 9 MB unpacked up to and including 2\.txt, expected at most 8 MB.*raise"
    with pytest.raises(SceneError, match=reason):
        avstack.unpack(bomb, tmp_path / "out", (".txt",), 8 * MB)
    assert unpacked(tmp_path / "out") == ["0.txt", "1.txt"]
    bomb = packed(tmp_path / "bomb.tar.gz", partial(add, name="objects/a.txt", size=30 * MB))
    with pytest.raises(SceneError, match=r"too large: 30 MB unpacked up to and including objects/a\.txt"):
        avstack.unpack(bomb, tmp_path / "other", (".txt",), 8 * MB)
    assert unpacked(tmp_path / "other") == []


def test_skipped_members_do_not_count_towards_the_limit(tmp_path: Path) -> None:
    path = packed(tmp_path / "a.tar.gz", lambda tar: add(tar, "a.png", 9 * MB), lambda tar: add(tar, "a.txt", 1))
    avstack.unpack(path, tmp_path / "out", (".txt",), MB)
    assert unpacked(tmp_path / "out") == ["a.txt"]


def add_much_that_is_skipped(tar: tarfile.TarFile) -> None:
    """A file that is not needed, of zeros: gzip packs it 1,000 to 1, bzip2 and xz much better."""
    add(tar, "skipped.bin", 20 * MB)
    add(tar, "wanted.txt", 1000)


@pytest.mark.parametrize("mode", ["w:bz2", "w:xz", "w:gz"])
def test_an_archive_of_a_few_kilobytes_that_unpacks_to_megabytes_is_refused(tmp_path: Path, mode: str) -> None:
    path = packed(tmp_path / "bomb.tar", add_much_that_is_skipped, mode=mode)
    if mode == "w:gz":  # as well as it can, is legal
        avstack.unpack(path, tmp_path / "out", (".txt",), MB)
    else:
        with pytest.raises(SceneError, match=r"bomb\.tar: found 20\S* MB unpacked or more"):
            avstack.unpack(path, tmp_path / "out", (".txt",), MB)
    assert unpacked(tmp_path / "out") == (["wanted.txt"] if mode == "w:gz" else [])


def test_every_compression_is_recognised_and_truncated_archives_are_refused_by_name(tmp_path: Path) -> None:
    for mode in ("w", "w:gz", "w:bz2", "w:xz"):
        path = packed(tmp_path / "archive", partial(add, name="a/b.txt", size=MB), mode=mode)
        avstack.unpack(path, tmp_path / mode, (".txt",), MB)
        assert (tmp_path / mode / "a" / "b.txt").read_bytes() == bytes(MB)
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        with pytest.raises(SceneError, match=r"archive: cannot be unpacked"):
            avstack.unpack(path, tmp_path / mode, (".txt",), 2 * MB)


def test_an_archive_of_very_many_members_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(avstack, "MAX_MEMBERS", 1000)
    path = packed(tmp_path / "many.tar.gz", *(lambda tar, k=k: add(tar, f"{k}.png") for k in range(1001)))
    with pytest.raises(SceneError, match=r"many.tar.gz: the archive exceeds the limit of 1,000 files and folders"):
        avstack.unpack(path, tmp_path / "out", (".txt",), MB)


def test_links_and_devices_are_refused_whatever_their_target(tmp_path: Path) -> None:
    for kind in (tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.FIFOTYPE, tarfile.CHRTYPE, tarfile.BLKTYPE):
        for target in ("/etc/passwd", "../outside.txt", "inside.txt"):
            path = packed(tmp_path / "a.tar.gz", partial(add, name="objects/a.txt", kind=kind, linkname=target))
            special = f"a link to '{target}'" if kind in (tarfile.SYMTYPE, tarfile.LNKTYPE) else "not a regular file"
            with pytest.raises(SceneError, match=rf"objects/a\.txt is {special}, expected plain files"):
                avstack.unpack(path, tmp_path / "out", (".txt",), MB)


def test_a_path_that_leaves_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for name in ("../a.txt", "objects/../../a.txt"):
        path = packed(tmp_path / "a.tar.gz", partial(add, name=name, size=5))
        with pytest.raises(SceneError, match=r"a\.tar\.gz: cannot be unpacked: .*outside"):
            avstack.unpack(path, tmp_path / "in" / "out", (".txt",), MB)
    assert unpacked(tmp_path) == ["a.tar.gz"]


def test_an_absolute_path_is_unpacked_below_the_folder(tmp_path: Path) -> None:
    path = packed(tmp_path / "a.tar.gz", lambda tar: add(tar, f"{tmp_path}/evil.txt", 5))
    avstack.unpack(path, tmp_path / "out", (".txt",), MB)
    assert not (tmp_path / "evil.txt").exists()


@pytest.mark.parametrize("kind", [tarfile.XHDTYPE, tarfile.XGLTYPE, tarfile.GNUTYPE_LONGNAME])
def test_a_header_that_claims_tens_of_megabytes_is_not_read_into_memory(tmp_path: Path, kind: bytes) -> None:
    path = packed(tmp_path / "a.tar.gz", lambda tar: add(tar, "x", 40 * MB, kind))
    tracemalloc.start()
    try:
        with pytest.raises(SceneError, match=r"a header exceeds the limit of 65536 bytes"):
            avstack.unpack(path, tmp_path / "out", (".txt",), MB)
        assert tracemalloc.get_traced_memory()[1] < 10 * MB
    finally:
        tracemalloc.stop()


def test_a_sparse_file_that_claims_terabytes_is_refused(tmp_path: Path) -> None:
    member = tarfile.TarInfo("a.txt")
    member.type, member.size = tarfile.GNUTYPE_SPARSE, 0
    block = bytearray(member.tobuf(tarfile.GNU_FORMAT))
    block[483:495] = b"%011o\0" % (1 << 32)  # the size of the file, holes included
    block[148:156] = b"%06o\0 " % (256 + sum(block[:148]) + sum(block[156:]))
    (tmp_path / "a.tar").write_bytes(bytes(block) + bytes(1024))
    with pytest.raises(SceneError, match=r"a.txt is not a regular file, expected plain files"):
        avstack.unpack(tmp_path / "a.tar", tmp_path / "out", (".txt",), MB)


def test_the_unpacking_limit_is_configurable_and_no_files_remain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = write_run(tmp_path / "run-0")
    path = packed(tmp_path / "town.tar.gz", lambda tar: tar.add(run, "run-0"), lambda tar: add(tar, "a.txt", 2 * MB))
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    with pytest.raises(SceneError, match=r"town\.tar\.gz: too large: 2\.\d+ MB unpacked up to and including a\.txt"):
        AVstackScene(path=str(path), max_unpacked_mb=2).record(0, None)
    assert AVstackScene(path=str(path), max_unpacked_mb=3).record(0, None).agent_names[0] == "ego"
    assert not list((tmp_path / "temporary").iterdir())
