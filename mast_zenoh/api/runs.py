"""A run as a Python object: its tables, messages, agents, plots and report."""

from __future__ import annotations

import html
from collections.abc import Iterator
from dataclasses import fields
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow

from mast_zenoh.api import messages as recorded
from mast_zenoh.api.messages import WireMessage
from mast_zenoh.config.resolved import RECORDING
from mast_zenoh.errors import ConfigurationError, RunFolderError, nearest
from mast_zenoh.launch import liveness
from mast_zenoh.launch.ending import RUNNING
from mast_zenoh.run_folder import json_or_empty, read_json, read_object, reading
from mast_zenoh.run_folder.tables import read_arrow
from mast_zenoh.scenes.recording import Recording


class Agent:
    """The messages that one agent of a run sent and received, by frame."""

    def __init__(self, path: Path, name: str) -> None:
        self.path = path
        self.name = name

    @property
    def tracks(self) -> pyarrow.Table:
        """Tracks by frame, as the broker receives them: columns of `Run.truth`, and score."""
        return self._rows("tracks", recorded.states)

    @property
    def mission(self) -> pyarrow.Table:
        """Objects of the mission estimate (own tracks and picture) by frame, as `tracks`.

        Raises ConfigurationError for an agent that does not act on one, as poles do not.
        """
        wires = [wire["key"] for wire in json_or_empty(self.path / "wiring.json").get("wires", ())]
        if wires and f"agent/{self.name}/mission" not in wires:
            others = [key.split("/")[1] for key in wires if key.startswith("agent/") and key.endswith("/mission")]
            raise ConfigurationError(
                f"{self.path}: {self.name} makes no mission estimate, as it does not act on one; found "
                f"{', '.join(others) or 'none'}: play the run with --set agents.{self.name}.acts=true"
            )
        return self._rows("mission", recorded.states)

    @property
    def detections(self) -> pyarrow.Table:
        """Received detections by frame, in the sensor's frame: columns of `tracks`, no id.

        `time_s` is the time of the measurement. Of several sensors: those of the first.
        """
        return self._rows("detections", recorded.detections)

    def detections_of(self, sensor: str) -> pyarrow.Table:
        """As `detections`, of one of several sensors. Raises ConfigurationError for a name that none has."""
        agents = {agent.name: agent for agent in Recording.load(self.path / RECORDING).agents}
        names = [each.name for each in agents[self.name].sensors]
        if sensor not in names:
            raise ConfigurationError(f"{self.name}: no sensor {sensor!r}{nearest(sensor, names)}")
        return self._rows(f"detections/{sensor}" if names.index(sensor) else "detections", recorded.detections)

    @property
    def pose(self) -> pyarrow.Table:
        """A row per frame: the agent's pose and velocity in the world frame.

        Columns: x y z (m), vx vy vz (m/s) and the quaternion qw qx qy qz.
        """
        return self._rows("pose", recorded.pose)

    def _rows(self, port: str, rows: Any) -> pyarrow.Table:
        return recorded.table_of(self.path, f"agent/{self.name}/{port}", rows)

    def __repr__(self) -> str:
        return f"<Agent {self.name}: tracks, mission, detections, pose; {self.path}>"


if TYPE_CHECKING:  # drawing libraries are slow to load
    from mast_zenoh.api.plots import Plots
    from mast_zenoh.report.film.look import Look
    from mast_zenoh.runs.run import RunRecord
    from mast_zenoh.viewer.export import Exported


class Run:
    """A run folder as an object, of a finished run or one in progress.

    Every access reads the current contents.

    path: its folder

    Raises RunFolderError if there is no run folder; a property raises it if its file is missing.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path).resolve()
        if not (self.path / "run.json").is_file():
            raise RunFolderError(f"{path}: no run.json there: expected the folder of a run, such as runs/NAME-TIME")
        self._loaded: RunRecord | None = None

    @property
    def record(self) -> dict[str, Any]:
        """run.json: id, status, seed, versions, timings, node endings (docs/endings.md)."""
        return liveness.current_record(read_object(self.path / "run.json"))

    @property
    def id(self) -> str:
        """The run's own id."""
        return str(self._entry("id"))

    @property
    def name(self) -> str:
        """The scenario's name."""
        return str(self._entry("name"))

    @property
    def status(self) -> str:
        """`running`, `ok`, or another status (docs/endings.md)."""
        return str(self._entry("status"))

    @property
    def seed(self) -> int:
        """The seed of all its random draws."""
        return int(self._entry("seed"))

    @property
    def running(self) -> bool:
        """Whether the run is still in progress."""
        return self.status == RUNNING

    @property
    def headline(self) -> str:
        """The report's title: the largest change that adversaries or faults made.

        With drivers, what happened to their cars comes first.
        """
        from mast_zenoh.report.narrative.run import headline

        with reading(self.path):
            return f"{headline(self._folder())}."

    @property
    def summary(self) -> dict[str, Any]:
        """metrics.json: means and deviations over scored frames (docs/metrics.md)."""
        return dict(self._written("metrics.json", read_json))

    @property
    def metrics(self) -> pyarrow.Table:
        """A row per frame, agent and estimator.

        Columns: fn, fp, tp (objects), rmse_m (m), id_switches, ospa_m, gospa_m (m), length_error_m, width_error_m,
        heading_error_deg, speed_error_mps, velocity_error_mps, iou_3d, scored (counts in `summary`).
        """
        return self._table("metrics.parquet")

    @property
    def objects(self) -> pyarrow.Table:
        """A row per box in range of an agent: outcome and pose, m, rad (docs/metrics.md)."""
        return self._table("objects.parquet")

    @property
    def attacks(self) -> pyarrow.Table:
        """A row per measured effect of an interposer; may be empty (docs/effects.md)."""
        return self._table("attacks.parquet")

    @property
    def targets(self) -> pyarrow.Table:
        """A row per frame and object that an adversary manipulated (docs/metrics.md)."""
        return self._table("targets.parquet")

    @property
    def driving(self) -> pyarrow.Table:
        """A row per frame, vehicle and estimate: effects on driving (docs/metrics.md)."""
        return self._table("driving.parquet")

    @property
    def driven(self) -> pyarrow.Table:
        """A row per frame and driven car: its course (docs/metrics.md).

        Raises RunFolderError for a run without drivers.
        """
        return self._table("driven.parquet")

    @property
    def trust(self) -> pyarrow.Table:
        """A row per frame and agent: the command centre's trust (docs/metrics.md).

        Raises RunFolderError for a run whose command centre judges nobody.
        """
        return self._table("trust.parquet")

    @property
    def trust_objects(self) -> pyarrow.Table:
        """A row per frame and object that a judging command centre tracks, withheld or not."""
        return self._table("trust_objects.parquet")

    def messages(self, pattern: str = "*", *, taps: bool = False) -> Iterator[WireMessage]:
        """The recorded messages on the wires that a glob matches, sorted by frame.

        For example `run.messages("agent/*/tracks")`.

        taps: include the hidden legs of intercepted wires, with messages before an interposer changed them
        Raises ConfigurationError, at the end of the iteration, for a pattern that matches no wire.
        """
        none = True
        for message in recorded.messages(self.path, pattern, taps=taps):
            none = False
            yield message
        wires = [wire["key"] for wire in json_or_empty(self.path / "wiring.json").get("wires", ())] if none else []
        if wires and not any(fnmatchcase(wire, pattern) for wire in wires):
            raise ConfigurationError(f"{self.path}: no wire matches {pattern!r}{nearest(pattern, wires)}")

    @property
    def truth(self) -> pyarrow.Table:
        """A row per frame and object of the scene, world frame.

        Columns: frame, time_s (s), id, class, x y z (m, centre), vx vy vz (m/s), l w h (m), yaw (rad), and points, the
        lidar returns at the agent that has the most.
        """
        return recorded.table_of(self.path, "scene/truth", recorded.truth)

    @property
    def picture(self) -> pyarrow.Table:
        """Objects of the common picture by frame: columns of `truth`, score, support."""
        return recorded.table_of(self.path, "cc/picture", recorded.states)

    @property
    def agents(self) -> tuple[str, ...]:
        """The names of the agents."""
        nodes = read_object(self.path / "scenario.json").get("nodes") or {}
        return tuple(name for name, spec in nodes.items() if spec and spec.get("role") == "agent")

    def agent(self, name: str) -> Agent:
        """The agent of this name; raises ConfigurationError if there is none."""
        if name not in self.agents:
            raise ConfigurationError(f"{self.path}: no agent {name!r} in this run{nearest(name, self.agents)}")
        return Agent(self.path, name)

    @property
    def plot(self) -> Plots:
        """The report's figures: `run.plot.birdseye(frame=64)`, `run.plot.over_time("fp")`."""
        from mast_zenoh.api.plots import Plots

        return Plots({self._folder().label: self._folder()})

    def report(self, frame: int | None = None, against: Run | None = None) -> Path:
        """Write report.html and its figures into the folder; returns its path.

        frame: the frame that figures show;  against: another run of the same scene and seed, to compare with
        """
        from mast_zenoh.report import html as page

        with reading(self.path):
            return page.write_report(self.path, frame, None if against is None else against.path)

    def export(self, to: str, out: str | Path) -> Exported:
        """Write the finished run in another format (docs/exports.md).

        to: a format of that page;  out: a new file or folder

        Returns the paths that were written, and what the run's record lacks. Raises ExportError for a package that is
        not installed or a path that exists, RunFolderError for a run in progress or a damaged recording.
        """
        from mast_zenoh.viewer.export import export

        with reading(self.path):
            return export(self.path, to, Path(out))

    def animate(
        self,
        out: str | Path,
        *,
        against: Run | None = None,
        start: int | None = None,
        end: int | None = None,
        speed: float = 1.0,
        fps: float | None = None,
        **look: Any,
    ) -> Path:
        """Write a film of the finished run (docs/animations.md); returns its path.

        out:        a new file that ends with .mp4, .gif or .webm;  against: another run to show beside it
        start, end: first and last frame;  speed: over that of the scene;  fps: images per second
        look:       agent, estimates, camera, window, theme, size, dpi, plain, title, captions

        Raises ExportError for the file or without ffmpeg, RunFolderError for a run in progress or a frame that the run
        does not have, ConfigurationError for an invalid option.
        """
        from mast_zenoh.report.film import writing

        options: dict[str, Any] = {"start": start, "end": end, "speed": speed, "fps": fps}
        other = None if against is None else against.path
        with reading(self.path):
            writing.animate(self.path, Path(out), _look(look), other, **options)
        return Path(out)

    def snapshot(self, out: str | Path, frame: int | None = None, *, against: Run | None = None, **look: Any) -> Path:
        """Write one frame of the finished run as a figure, on light ground; returns its path.

        out:   a new file that ends with .pdf, .svg or .png;  frame: None: the one that the report shows
        Further parameters and errors are those of `animate`.
        """
        from mast_zenoh.report.film import writing

        other = None if against is None else against.path
        with reading(self.path):
            writing.snapshot(self.path, Path(out), _look({"theme": "light", **look}), frame, other)
        return Path(out)

    def _entry(self, name: str) -> Any:
        """An entry of run.json that every run has."""
        record = self.record
        if record.get(name) is None:
            raise RunFolderError(f"{self.path / 'run.json'}: has no {name!r}, expected the record of a run")
        return record[name]

    def _folder(self) -> RunRecord:
        """The folder as the report reads it; reloaded while the run is in progress."""
        from mast_zenoh.runs.run import RunRecord

        if self._loaded is None or self._loaded.run.get("status") == RUNNING:
            self._loaded = RunRecord.load(self.path)
        return self._loaded

    def _table(self, name: str) -> pyarrow.Table:
        return self._written(name, read_arrow)

    def _written(self, name: str, read: Any) -> Any:
        """Read a file that a run writes at its end; raises RunFolderError if unusable."""
        path = self.path / name
        if not path.is_file():
            why = (
                "the run is still in progress, and writes it at its end"
                if self.running
                else f"the run is {self.status}"
            )
            raise RunFolderError(f"{path}: missing; {why}")
        try:
            return read(path)
        except (OSError, pyarrow.ArrowException) as error:
            raise RunFolderError(f"{path}: {error}") from None

    def __repr__(self) -> str:
        return f"<Run {self._entry('id')}: {self._facts()}; {self.path}>"

    def _repr_html_(self) -> str:
        words = html.escape(f"{self.headline} Folder: {self.path}")
        return f"<p><b>{html.escape(self._entry('id'))}</b> ({html.escape(self._facts())})<br>{words}</p>"

    def _facts(self) -> str:
        return f"{self.status}, {self._entry('frames')} frames, seed {self.seed}, {self._entry('runtime')}"


def _look(options: dict[str, Any]) -> Look:
    """The options of a film; raises ConfigurationError for an unknown one."""
    from mast_zenoh.report.film.look import Look

    known = [field.name for field in fields(Look)]
    if unknown := [name for name in options if name not in known]:
        raise ConfigurationError(f"no option {unknown[0]!r}{nearest(unknown[0], known)}")
    if isinstance(options.get("estimates"), str):
        options = options | {"estimates": (options["estimates"],)}
    return Look(**options)
