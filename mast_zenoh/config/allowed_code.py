"""Which code that a run folder names may run: shipped files, and those that the user names or confirms.

A run folder is data. Its scenario names Python files, and reading one never runs them: `Resolved.read` turns every name
that is not allowed into an `UntrustedFile`, which can be shown but not opened.
"""

from __future__ import annotations

import filecmp
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from mast_zenoh.config import bundle, loading
from mast_zenoh.errors import UntrustedCode

_KINDS = ("nodes", "scenarios", "studies")
#: Of nodes that play what was recorded; they are part of the package.
_PLAYER = ("mast_zenoh", "mesh", "player.py")


@dataclass(frozen=True)
class AllowedCode:
    """The code of a run folder that may run besides shipped files.

    files:     named by the user, on this command line
    confirmed: whether all files that the run folder names may run (`--trust`)
    announce:  gets a sentence with the names of these files before they run
    """

    files: frozenset[Path] = frozenset()
    confirmed: bool = False
    announce: Callable[[str], object] | None = None

    @classmethod
    def of(
        cls, *named: str | Path | None, confirmed: bool = False, announce: Callable[[str], object] | None = None
    ) -> AllowedCode:
        """Files that the user has named; None: none."""
        return cls(frozenset(Path(file).resolve() for file in named if file is not None), confirmed, announce)

    def files_in(self, origin: str, folder: Path | None, names: Iterable[str]) -> dict[str, str | UntrustedFile]:
        """By name in a scenario, the file to run, or an UntrustedFile.

        origin: where the scenario comes from, for messages;  folder: the run folder, None: none
        """
        shipped = {name: _shipped(name) for name in names}
        own = {name: _found(name, folder) for name, file in shipped.items() if file is None}
        allowed = {name: path for name, path in own.items() if self.confirmed or path.resolve() in self.files}
        if refused := [str(path) for name, path in own.items() if name not in allowed]:
            error = UntrustedCode(
                f"{origin}: names code that does not come with mast: {', '.join(sorted(refused))}: nothing of it was "
                "run; read it, and if you trust it, confirm it with --trust"
            )
            return {
                name: file or (str(allowed[name]) if name in allowed else UntrustedFile(name, error))
                for name, file in shipped.items()
            }
        confirmed = sorted(str(path) for path in allowed.values() if path.resolve() not in self.files)
        if confirmed and self.announce is not None:
            self.announce(f"--trust: running code that {origin} names: {', '.join(confirmed)}")
        return {name: file or str(allowed[name]) for name, file in shipped.items()}


#: Shipped files alone, and all of a run that this process is a part of.
SHIPPED, OWN_RUN = AllowedCode(), AllowedCode(confirmed=True)


class UntrustedFile(os.PathLike[str]):
    """The name of a Python file in a scenario that a third party may have written.

    It has a text, but is no path: everything that would open it raises UntrustedCode.
    """

    def __init__(self, name: str, error: UntrustedCode) -> None:
        self._name, self._error = name, error

    def __str__(self) -> str:
        return self._name

    def __fspath__(self) -> str:
        raise self._error


def _shipped(name: str) -> str | None:
    """The shipped file that a recorded name stands for, perhaps of another installation; None: it is a user's."""
    path = Path(name)
    if path == loading.SESSION:  # a class of this session, which has run already
        return name
    if path.parts[-4:] == _PLAYER:
        return str(Path(__file__).parents[1].joinpath(*_PLAYER[1:]))
    known = [found for kind in _KINDS if (found := bundle.find(kind, path.name)) is not None]
    if not path.is_file():
        return next((str(found) for found in known if path.is_absolute()), None)
    return next((str(found) for found in known if filecmp.cmp(path, found, shallow=False)), None)


def _found(name: str, folder: Path | None) -> Path:
    """The file of a name: where it was in the run, or of the same name in the run folder."""
    path = Path(name)
    beside = None if folder is None else folder / path.name
    return (beside if beside is not None and not path.is_file() and beside.is_file() else path).absolute()
