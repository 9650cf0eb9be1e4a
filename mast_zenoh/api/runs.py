"""A run as a Python object: its tables, messages, agents, plots and report."""

from __future__ import annotations

import html
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow

from mast_zenoh.api import messages as recorded
from mast_zenoh.api.messages import WireMessage
from mast_zenoh.errors import ConfigurationError, RunFolderError, nearest
from mast_zenoh.launch import folder, liveness
from mast_zenoh.launch.ending import RUNNING
from mast_zenoh.launch.tables import read_arrow

if TYPE_CHECKING:  # drawing libraries are slow to load
    from mast_zenoh.api.plots import Plots
    from mast_zenoh.report.runfolder import RunFolder


class Run:
    """A run folder as an object, of a run that has ended or still goes on: every access reads what is there now.

    path: of the folder

    Raises RunFolderError where there is no run folder, and from a property whose file is missing.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path).resolve()
        if not (self.path / "run.json").is_file():
            raise RunFolderError(f"{path}: no run.json there: expected the folder of a run, such as runs/NAME-TIME")
        self._loaded: RunFolder | None = None

    @property
    def record(self) -> dict[str, Any]:
        """run.json: id, status, seed, versions, timings, how every node ended (docs/endings.md)."""
        return liveness.current_record(folder.read_json(self.path / "run.json"))

    @property
    def id(self) -> str:
        """The run's own id."""
        return str(self.record["id"])

    @property
    def name(self) -> str:
        """The scenario's name."""
        return str(self.record["name"])

    @property
    def status(self) -> str:
        """`running`, `ok`, or how else it ended (docs/endings.md)."""
        return str(self.record["status"])

    @property
    def seed(self) -> int:
        """The seed of all its random draws."""
        return int(self.record["seed"])

    @property
    def running(self) -> bool:
        """Whether it still goes on."""
        return self.status == RUNNING

    @property
    def headline(self) -> str:
        """The report's first sentence: the largest change that adversaries or faults made."""
        from mast_zenoh.report.narrative.run import headline

        return f"{headline(self._folder())}."

    @property
    def summary(self) -> dict[str, Any]:
        """metrics.json: means and standard deviations over the scored frames (docs/metrics.md)."""
        return dict(self._written("metrics.json", folder.read_json))

    @property
    def metrics(self) -> pyarrow.Table:
        """A row per frame, agent and estimator: fn, fp, tp (objects), rmse_m (m), id_switches, ospa_m, gospa_m (m)."""
        return self._table("metrics.parquet")

    @property
    def objects(self) -> pyarrow.Table:
        """A row per box in range of an agent: what became of it, and where it is (m, rad; docs/metrics.md)."""
        return self._table("objects.parquet")

    @property
    def attacks(self) -> pyarrow.Table:
        """A row per measured effect of an interposer; none where nobody sat on a wire (docs/effects.md)."""
        return self._table("attacks.parquet")

    @property
    def targets(self) -> pyarrow.Table:
        """A row per frame and object that an adversary manipulated (docs/metrics.md)."""
        return self._table("targets.parquet")

    @property
    def driving(self) -> pyarrow.Table:
        """A row per frame, vehicle and estimate: what the errors would have meant for driving (docs/metrics.md)."""
        return self._table("driving.parquet")

    def messages(self, pattern: str = "*", *, taps: bool = False) -> Iterator[WireMessage]:
        """The recorded messages on the wires that a glob matches, by frame: `run.messages("agent/*/tracks")`.

        taps: include the hidden legs of intercepted wires: what was sent before an interposer changed it
        """
        return recorded.messages(self.path, pattern, taps=taps)

    @property
    def truth(self) -> pyarrow.Table:
        """A row per frame and object of the scene, world frame.

        Columns: frame, time_s (s), id, class, x y z (m, centre), vx vy vz (m/s), l w h (m), yaw (rad), and points, the
        lidar returns at the agent that has the most.
        """
        return recorded.table_of(self.path, "scene/truth", recorded.truth)

    @property
    def picture(self) -> pyarrow.Table:
        """A row per frame and object of the common picture, world frame: columns as `truth`, and score, support."""
        return recorded.table_of(self.path, "cc/picture", recorded.states)

    @property
    def agents(self) -> tuple[str, ...]:
        """The names of the agents."""
        nodes = folder.read_json(self.path / "scenario.json")["nodes"]
        return tuple(name for name, spec in nodes.items() if spec["role"] == "agent")

    def agent(self, name: str) -> Agent:
        """One of the agents. Raises ConfigurationError for a name that none has."""
        if name not in self.agents:
            raise ConfigurationError(f"{self.path}: no agent {name!r} in this run{nearest(name, self.agents)}")
        return Agent(self.path, name)

    @property
    def plot(self) -> Plots:
        """The report's figures: `run.plot.birdseye(frame=64)`, `run.plot.over_time("fp")`."""
        from mast_zenoh.api.plots import Plots

        return Plots({self._folder().label: self._folder()})

    def report(self, frame: int | None = None, against: Run | None = None) -> Path:
        """Write report.html and its figures into the folder; its path.

        frame: that the pictures show;  against: another run of the same scene and seed, to compare with
        """
        from mast_zenoh.report import html as page

        return page.write_report(self.path, frame, None if against is None else against.path)

    def _folder(self) -> RunFolder:
        """The folder as the report reads it; read again as long as the run goes on."""
        from mast_zenoh.report.runfolder import RunFolder

        if self._loaded is None or self._loaded.run.get("status") == RUNNING:
            self._loaded = RunFolder.load(self.path)
        return self._loaded

    def _table(self, name: str) -> pyarrow.Table:
        return self._written(name, read_arrow)

    def _written(self, name: str, read: Any) -> Any:
        """A file that is written when a run ends; raises RunFolderError where it is missing or broken."""
        path = self.path / name
        if not path.is_file():
            why = "the run still goes on, and it is written at its end" if self.running else f"the run is {self.status}"
            raise RunFolderError(f"{path}: missing; {why}")
        try:
            return read(path)
        except (OSError, pyarrow.ArrowException) as error:
            raise RunFolderError(f"{path}: {error}") from None

    def __repr__(self) -> str:
        record = self.record
        facts = f"{record['status']}, {record['frames']} frames, seed {record['seed']}, {record['runtime']}"
        return f"<Run {record['id']}: {facts}; {self.path}>"

    def _repr_html_(self) -> str:
        record = self.record
        words = html.escape(f"{self.headline} Folder: {self.path}")
        facts = f"{record['status']}, {record['frames']} frames, seed {record['seed']}, {record['runtime']}"
        return f"<p><b>{html.escape(record['id'])}</b> ({html.escape(facts)})<br>{words}</p>"


class Agent:
    """What one agent of a run sent and was sent, frame by frame."""

    def __init__(self, path: Path, name: str) -> None:
        self.path = path
        self.name = name

    @property
    def tracks(self) -> pyarrow.Table:
        """A row per frame and track, as the broker receives them, world frame: columns as `Run.truth`, and score."""
        return self._rows("tracks", recorded.states)

    @property
    def mission(self) -> pyarrow.Table:
        """A row per frame and object of the mission estimate, its own tracks and the picture; columns as `tracks`."""
        return self._rows("mission", recorded.states)

    @property
    def detections(self) -> pyarrow.Table:
        """A row per frame and detection that it receives, in the frame of its sensor: columns as `tracks`, no id."""
        return self._rows("detections", recorded.detections)

    @property
    def pose(self) -> pyarrow.Table:
        """A row per frame: x y z (m), vx vy vz (m/s) and quaternion qw qx qy qz of the agent in the world frame."""
        return self._rows("pose", recorded.pose)

    def _rows(self, port: str, rows: Any) -> pyarrow.Table:
        return recorded.table_of(self.path, f"agent/{self.name}/{port}", rows)

    def __repr__(self) -> str:
        return f"<Agent {self.name}: tracks, mission, detections, pose; {self.path}>"
