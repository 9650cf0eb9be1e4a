"""`mast.Run`: a run with what shows it."""

from __future__ import annotations

import html
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mast_zenoh.errors import ConfigurationError, RunFolderError, nearest
from mast_zenoh.run_folder import reading
from mast_zenoh.runs.run import Run

if TYPE_CHECKING:  # drawing libraries are slow to load
    from mast_zenoh.run_folder.finding import Finding
    from mast_zenoh.show.export import Exported
    from mast_zenoh.show.figures.plots import Plots
    from mast_zenoh.show.film.look import Look


class OpenedRun(Run):
    """A run folder as an object, of a finished run or one in progress.

    Its tables, and what is drawn and written, are of the moment in which they are asked for.

    path: its folder

    Raises RunFolderError if there is no run folder; a property raises it if its file is missing.
    """

    def __init__(self, path: str | Path) -> None:
        if not (Path(path) / "run.json").is_file():
            raise RunFolderError(f"{path}: no run.json there: expected the folder of a run, such as runs/NAME-TIME")
        super().__init__(Path(path).resolve())

    @property
    def headline(self) -> str:
        """The report's title: the largest change that adversaries or faults made.

        With drivers, what happened to their cars comes first.
        """
        from mast_zenoh.show.findings import headline

        with reading(self.path):
            return f"{headline(self._now())}."

    @property
    def findings(self) -> list[Finding]:
        """What the report says, as data, in its order: what failed, what changed and why, what adversaries did."""
        from mast_zenoh.show.findings import findings

        with reading(self.path):
            return findings(self._now())

    @property
    def plot(self) -> Plots:
        """The report's figures: `run.plot.birdseye(frame=64)`, `run.plot.over_time("fp")`."""
        from mast_zenoh.show.figures.plots import Plots

        return Plots({self.name: self._now()})

    def report(self, frame: int | None = None, against: OpenedRun | None = None) -> Path:
        """Write report.html and its figures into the folder; returns its path.

        frame: the frame that figures show;  against: another run of the same scene and seed, to compare with
        """
        from mast_zenoh.show import html as page

        with reading(self.path):
            return page.write_report(self.path, frame, None if against is None else against.path)

    def export(self, to: str, out: str | Path) -> Exported:
        """Write the finished run in another format (docs/exports.md).

        to: a format of that page;  out: a new file or folder

        Returns the paths that were written, and what the run's record lacks. Raises ExportError for a package that is
        not installed or a path that exists, RunFolderError for a run in progress or a damaged recording.
        """
        from mast_zenoh.show.export import export

        with reading(self.path):
            return export(self.path, to, Path(out))

    def animate(
        self,
        out: str | Path,
        *,
        against: OpenedRun | None = None,
        start: int | None = None,
        end: int | None = None,
        speed: float = 1.0,
        fps: float | None = None,
        **look: Any,
    ) -> Path:
        """Write a film of the finished run (docs/animations.md); returns its path.

        out:        a new file that ends with .mp4, .gif or .webm;  against: another run to show beside it
        start, end: first and last frame, by default of the run, at most 3000;  speed: over that of the scene
        fps:        images per second
        look:       agent, estimates, camera, window, theme, size, dpi, plain, title, captions

        Raises ExportError for the file or without ffmpeg, RunFolderError for a run in progress or a frame that the run
        does not have, ConfigurationError for an invalid option.
        """
        from mast_zenoh.show.film import writing

        options: dict[str, Any] = {"start": start, "end": end, "speed": speed, "fps": fps}
        other = None if against is None else against.path
        with reading(self.path):
            writing.animate(self.path, Path(out), _look(look), other, **options)
        return Path(out)

    def snapshot(
        self, out: str | Path, frame: int | None = None, *, against: OpenedRun | None = None, **look: Any
    ) -> Path:
        """Write one frame of the finished run as a figure, on light ground; returns its path.

        out:   a new file that ends with .pdf, .svg or .png;  frame: None: the one that the report shows
        Further parameters and errors are those of `animate`.
        """
        from mast_zenoh.show.film import writing

        other = None if against is None else against.path
        with reading(self.path):
            writing.snapshot(self.path, Path(out), _look({"theme": "light", **look}), frame, other)
        return Path(out)

    def _now(self) -> Run:
        """The run as it is now."""
        return Run(self.path)

    def __repr__(self) -> str:
        return f"<Run {self.id}: {self._facts()}; {self.path}>"

    def _repr_html_(self) -> str:
        words = html.escape(f"{self.headline} Folder: {self.path}")
        return f"<p><b>{html.escape(self.id)}</b> ({html.escape(self._facts())})<br>{words}</p>"

    def _facts(self) -> str:
        return f"{self.status}, {self.record.get('frames')} frames, seed {self.seed}, {self.record.get('runtime')}"


def _look(options: dict[str, Any]) -> Look:
    """The options of a film; raises ConfigurationError for an unknown one."""
    from mast_zenoh.show.film.look import Look

    known = [field.name for field in fields(Look)]
    if unknown := [name for name in options if name not in known]:
        raise ConfigurationError(f"no option {unknown[0]!r}{nearest(unknown[0], known)}")
    if isinstance(options.get("estimates"), str):
        options = options | {"estimates": (options["estimates"],)}
    return Look(**options)
