"""What is in the folder of a run: its documents and tables, each read when it is asked for.

Files:
run.json: how the run was made, went on and ended; at its beginning, and again at its end
scenario.json: the resolved scenario: every option of every node
wiring.json: every wire: key, message type, publisher, subscribers, interposers
scene.npz: the prepared scene that the simulator replays; with driven cars, in the end the scene as it happened
messages.mcap: every message, see docs/how-to-record-and-replay.md; not with --no-record
logs/NODE.log: what each process logged
metrics.json: the summary of the evaluator, at the end
metrics.parquet: a row per frame, agent and estimate
objects.parquet: a row per box, with its cause
attacks.parquet: a row per measured effect of an interposer
targets.parquet: a row per manipulated object and frame
driving.parquet: a row per mobile agent, estimate and frame
driven.parquet: a row per driven car and frame; with drivers
trust.parquet: a row per frame and agent; of a command centre that judges agents
trust_objects.parquet: a row per frame and object; of such a centre
results/NODE/: what each node returned at the end: results.json, and its own tables
checks.json: checks of the run's record; with links, faults or checks of yours
findings.json: what the report says, as data, with `text`, its sentence; with the report
report.html, figures/: the report and its figures
twin/: the same run without adversaries; with --against twin
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Self

import numpy as np
import pyarrow
from numpy.typing import NDArray

from mast_zenoh.arrays.boxes import Boxes
from mast_zenoh.arrays.states import Bools
from mast_zenoh.errors import MastError, RunFolderError
from mast_zenoh.launch import liveness
from mast_zenoh.launch.measurement import recorded_wirings
from mast_zenoh.metrics.scores import OUTCOMES
from mast_zenoh.run_folder import check_plain, read_object, reading
from mast_zenoh.run_folder.recording.writer import FILE
from mast_zenoh.run_folder.tables import TableFile
from mast_zenoh.run_folder.unpacking import check_expanded
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.wiring.model import Wiring

#: A table: one array per column, all of one length.
Table = dict[str, NDArray[Any]]

_COUNTS = ("frame", "agent", "estimator", "fn", "fp", "tp", "rmse_m", "id_switches")
_OBJECTS = (
    *("frame", "agent", "estimator", "kind", "outcome", "id", "match_id"),
    *("x", "y", "z", "l", "w", "h", "yaw", "cause", "by"),
)
_TARGETS = (
    *("adversary", "kind", "object", "frame", "x", "y", "seen_by_others"),
    *("believed_centre", "judged_centre", "error_m_centre", "believed_ego", "judged_ego", "error_m_ego"),
)
_TRUST = ("frame", "time_s", "agent", "mean", "log_odds", "state", "reason")
_JUDGED = ("frame", "id", "x", "y", "z", "l", "w", "h", "yaw", "withheld")
_EFFECTS = (
    *("interposer", "role", "wire", "message", "before_subscriber", "frame", "effect"),
    *("before_x", "before_y", "before_z", "after_x", "after_y", "after_z"),
)
#: What distinguishes effects.
_KINDS = ("interposer", "wire", "message", "before_subscriber", "effect")
_DRIVING = ("frame", "agent", "estimate", "false", "missed", "ttc_s", "brake", "needless", "omitted")
_DRIVEN = ("agent", "frame", "time_s", "x", "y", "heading", "speed_mps", "acceleration_mps2", "brake")


#: Frames whose boxes and manipulations are in memory, and rows of objects.parquet that they have, at most: of a longer
#: run, those of every n-th frame.
MOST_FRAMES, MOST_BOXES = 3000, 1_200_000


#: No agent has this name.
_NOBODY = "/"
#: A sample of the frames of a run: all.
ALL = range(1 << 62)


def sample_of(frames: int, n_boxes: int, wanted: int | None = None) -> range:
    """Which frames of a run with so many have their boxes in memory: every n-th. wanted: one of them"""
    every = max(1, -(-frames // MOST_FRAMES), -(-n_boxes // MOST_BOXES))
    return range((wanted or 0) % every, ALL.stop, every) if every > 1 else ALL


def are_in(sample: range, frames: NDArray[Any]) -> Bools:
    """(n,) bool: which of n frames are in a sample."""
    return np.asarray(((frames - sample.start) % sample.step == 0) & (frames >= sample.start) & (frames < sample.stop))


def rows(table: Table, mask: Bools) -> Table:
    """The rows of a table selected by a mask (n,)."""
    return {name: column[mask] for name, column in table.items()}


def column(table: Table, name: str) -> NDArray[np.float64]:
    """A column as numbers."""
    return np.asarray(table[name], np.float64)


class RunFiles:
    """The documents and tables of a run, each read from its folder when it is asked for.

    What has been read is kept, but for `all_objects`. A document that is absent or unreadable is {}, a table or the
    scene None, and `missing` names it. `wirings` raises errors instead.

    path:  the folder; None: there is none, as of a run that is going on elsewhere
    frame: of a run that is so long that only every n-th frame is read whole: one of them
    agent: whose boxes `objects` has, if not the main agent's
    given: contents that need not be read, by name

    The tables have these columns:
    counts:    metrics.parquet: a row per frame, agent and estimator
    objects:   objects.parquet: a row per box of the agent, in the frames of the sample; all_objects: of every agent
    effects:   attacks.parquet: a row per measured effect of an interposer; of a frame that is not in the sample, a row
               for all effects of a kind of an interposer on a wire
    targets:   targets.parquet: a row per manipulated object and frame
    driving:   driving.parquet: a row per frame, vehicle and estimate
    driven:    driven.parquet: a row per frame and driven car
    trust:     trust.parquet: of a command centre that judges agents
    trust_objects: trust_objects.parquet, in the frames of the sample
    """

    def __init__(self, path: Path | None, *, frame: int | None = None, agent: str = "", **given: Any) -> None:
        self.path = path or Path()
        self._read_from = path
        self._frame, self._agent, self._given = frame, agent, given
        self._absent: dict[str, str] = {}
        self._tables: dict[str, TableFile] = {}
        #: What else the record lacks, as found by whoever reads it.
        self.notes: list[str] = []
        self.__dict__.update(given)

    def with_(self, **changes: Any) -> Self:
        """The same with other contents, by name; agent, sample: what depends on them is read anew.

        Raises TypeError for an unknown name.
        """
        if unknown := changes.keys() - {*_NAMES, "all_objects"}:
            raise TypeError(f"found {min(unknown)!r}, expected one of {', '.join(_NAMES)}")
        anew = (_BY_AGENT if "agent" in changes else ()) + (_BY_SAMPLE if "sample" in changes else ())
        agent = changes.pop("agent", self._agent)
        given = {name: value for name, value in self._given.items() if name not in anew} | changes
        other = type(self)(self._read_from, frame=self._frame, agent=agent, **given)
        for name in _NAMES:
            if name in self.__dict__ and name not in anew:
                other.__dict__.setdefault(name, self.__dict__[name])
        other._absent, other.notes, other._tables = self._absent, self.notes, self._tables
        return other

    @property
    def is_live(self) -> bool:
        """Whether this is what was seen of a run that is going on."""
        return self._read_from is None

    # -- documents -----------------------------------------------------------------------------------------------------

    @cached_property
    def record(self) -> dict[str, Any]:
        """run.json, as of now."""
        return liveness.current_record(self._document("run.json", "how the run and its nodes ended is not known"))

    @cached_property
    def scenario(self) -> dict[str, Any]:
        """scenario.json."""
        return self._document("scenario.json", "no configuration")

    @cached_property
    def wiring(self) -> dict[str, Any]:
        """wiring.json."""
        return self._document("wiring.json", "the nodes on each wire are not known")

    @cached_property
    def summary(self) -> dict[str, Any]:
        """metrics.json."""
        return self._document("metrics.json", "no table of means")

    @cached_property
    def checks(self) -> dict[str, Any]:
        """checks.json, of runs with checks."""
        return self._optional("checks.json", _json_object, "what was checked is not known") or {}

    @cached_property
    def results(self) -> tuple[tuple[str, tuple[str, ...]], ...]:
        """By node, the names of its files under results/."""
        folder = self.path / "results"
        if self.is_live or not folder.is_dir():
            return ()
        nodes = sorted(path for path in folder.iterdir() if path.is_dir())
        return tuple((path.name, tuple(sorted(file.name for file in path.iterdir()))) for path in nodes)

    @cached_property
    def wirings(self) -> Sequence[tuple[int, Wiring]]:
        """The wirings that the run had, each with the frame after which it holds; the first one with -1.

        Without a recording only wiring.json is known. Raises RunFolderError if one cannot be read.
        """
        if not (self.path / FILE).exists():
            with reading(self.path):
                return [(-1, Wiring.from_json(self.wiring))]
        return recorded_wirings(self.path)

    # -- the scene and the tables --------------------------------------------------------------------------------------

    @cached_property
    def sample(self) -> range:
        """The frames of which boxes and manipulations are read."""
        n_frames, n_boxes = self._played, 0
        if not self.is_live:
            with contextlib.suppress(OSError, RunFolderError):  # `objects` says why it cannot be read
                file = self._opened("objects.parquet")
                n_boxes, last = file.n_rows, file.last_frame
                n_frames = n_frames if np.isnan(last) else min(n_frames, int(last) + 1)
        return sample_of(n_frames, n_boxes, self._frame)

    @property
    def _played(self) -> int:
        """The number of frames that the run says it has played; 0: it does not."""
        played = self.summary.get("frames") or self.record.get("frames")
        return played if isinstance(played, int) else 0

    @cached_property
    def scene(self) -> Recording | None:
        """scene.npz; of a long run, what is asked for is read then."""
        lost = "no buildings, agents and camera view in the pictures"
        scene: Recording | None = self._file("scene.npz", lambda path: Recording.open(check_plain(path)), lost)
        return scene

    @cached_property
    def agent(self) -> str | None:
        """The agent whose view is shown: the given one, `ego`, or else the first; None: unknown."""
        if self._agent:
            return self._agent
        names = list(self.scene.agent_names) if self.scene else list(self.summary.get("agents", {}))
        if not names and self.counts is not None:
            names = sorted(set(self.counts["agent"]))
        return "ego" if "ego" in names else (names[0] if names else None)

    @cached_property
    def counts(self) -> Table | None:
        """The counts of metrics.parquet, None if one is missing in a row; also of frames that a sample leaves out."""
        frames = None if self.sample.stop == ALL.stop else self.sample
        return self._table("metrics.parquet", partial(_counts, frames=frames), "no counts over time")

    @cached_property
    def objects(self) -> Table | None:
        """The boxes of the agent."""
        lost = "no outcomes of objects, no bird's-eye and camera views"
        return self._table("objects.parquet", self._boxes(self.sample), lost)

    def objects_of(self, frame: int) -> Table | None:
        """The rows of `objects` of one frame; if the others have not been read yet, they need not be."""
        if "objects" in self.__dict__ or self.is_live:
            return self.objects and rows(self.objects, self.objects["frame"] == frame)
        return self._table("objects.parquet", self._boxes(range(frame, frame + 1)), "no boxes of this frame")

    @cached_property
    def effects(self) -> Table | None:
        """The effects of interposers."""
        intercepted = any(wire.get("interposers") for wire in self.wiring.get("wires", ()))
        lost = "what interposers changed is not marked"
        return self._table("attacks.parquet", partial(_effects, sample=self.sample), lost, expected=intercepted)

    @cached_property
    def targets(self) -> Table | None:
        """The objects that adversaries manipulated."""
        return self._applied("achieved", "targets.parquet", _TARGETS, "what attacks achieved is not explained")

    @cached_property
    def driving(self) -> Table | None:
        """Effects on driving."""
        return self._applied("driving", "driving.parquet", _DRIVING, "no chart of driving")

    @cached_property
    def driven(self) -> Table | None:
        """The course of driven cars."""
        return self._applied("driven", "driven.parquet", _DRIVEN, "the course of driven cars is not shown")

    @cached_property
    def trust(self) -> Table | None:
        """The command centre's trust in agents."""
        return self._applied("integrity", "trust.parquet", _TRUST, "trust in agents is not shown")

    @cached_property
    def trust_objects(self) -> Table | None:
        """The objects that a judging command centre tracks."""
        return self._applied(
            "integrity", "trust_objects.parquet", _JUDGED, "withheld objects are not shown", self.sample
        )

    @property
    def all_objects(self) -> Any:
        """Objects.parquet, of every agent and the frames in the sample, as an Arrow table."""
        if "all_objects" in self._given or self.is_live or self.is_damaged("objects.parquet"):
            return self._given.get("all_objects")
        lost = "no object is marked as matched, missed or false"
        frames = _frames_of(self.sample)
        return self._table("objects.parquet", lambda file: self._plausible(_judged(file, frames)), lost)

    # -- what is missing -----------------------------------------------------------------------------------------------

    @property
    def missing(self) -> list[str]:
        """A sentence for each file that is absent or unreadable: what is not shown without it.

        Reads all files, but `all_objects`, which is checked when it is asked for.
        """
        for name in _NAMES:
            if name != "wirings":
                getattr(self, name)
        sentences = [self._absent[name] for name in sorted(self._absent, key=_ORDER.index)]
        if self.summary and "achieved" not in self.summary and self.effects is not None:
            sentences.append("metrics.json has no achievements: what attacks achieved is not known.")
        return [*sentences, *self.notes]

    def note(self, sentence: str) -> None:
        """Add a sentence about something else that the record lacks, once."""
        if sentence not in self.notes:
            self.notes.append(sentence)

    def is_damaged(self, name: str) -> bool:
        """Whether a file that has been asked for is there, but cannot be read."""
        return self._absent.get(name, "").startswith(f"{name} cannot be read")

    def _file(self, name: str, read: Callable[[Path], Any], consequence: str) -> Any:
        """Read a file; None on failure, with its `consequence` in `missing`."""
        if self.is_live:
            return None
        path = self.path / name
        try:
            return read(path)
        except FileNotFoundError:
            self._absent[name] = f"{name} is absent: {consequence}."
        except (OSError, ValueError, KeyError, MastError, pyarrow.ArrowException) as error:
            reason = str(error).removeprefix(f"{path}: ")
            self._absent[name] = f"{name} cannot be read ({reason}): {consequence}."
        return None

    def _optional(self, name: str, read: Callable[[Path], Any], consequence: str) -> Any:
        """Like `_file`, for a file that not every run has: its absence is not reported."""
        return self._file(name, read, consequence) if (self.path / name).is_file() else None

    def _table(
        self, name: str, read: Callable[[TableFile], Table], consequence: str, *, expected: bool = True
    ) -> Table | None:
        """Read a table; None on failure. expected: whether its absence is reported"""
        file = self._opened(name)
        table: Table | None = (self._file if expected else self._optional)(name, lambda _: read(file), consequence)
        return table

    def _opened(self, name: str) -> TableFile:
        return self._tables.setdefault(name, TableFile(self.path / name))

    def _applied(
        self, metric: str, name: str, columns: Sequence[str], consequence: str, sample: range = ALL
    ) -> Table | None:
        """A table that the evaluator writes only for runs to which it applies."""
        expected = bool(self.summary.get(metric))
        return self._table(name, lambda file: file.rows(columns, _frames_of(sample)), consequence, expected=expected)

    def _boxes(self, frames: range) -> Callable[[TableFile], Table]:
        return lambda file: self._plausible(file.rows(_OBJECTS, _frames_of(frames), self.agent or _NOBODY))

    def _plausible(self, table: Any) -> Any:
        """A table whose frames may be those of the run: pictures have room for each. Otherwise raises ValueError."""
        most = 2 * self._played + 1000
        if len(frames := np.asarray(table["frame"])) and not 0 <= frames.min() <= frames.max() <= most:
            raise ValueError(f"column frame: found {frames.min()} to {frames.max()} in a run of {self._played}")
        return table

    def _document(self, name: str, consequence: str) -> dict[str, Any]:
        return self._file(name, _json_object, consequence) or {}


#: The files in the order in which `missing` names them.
_ORDER = (
    *("run.json", "scenario.json", "wiring.json", "metrics.json", "metrics.parquet", "scene.npz", "objects.parquet"),
    *("attacks.parquet", "checks.json", "targets.parquet", "driving.parquet", "driven.parquet", "trust.parquet"),
    "trust_objects.parquet",
)
#: What is read once.
_NAMES = tuple(name for name, value in vars(RunFiles).items() if isinstance(value, cached_property))
#: Those that are of an agent, and those that are of a sample.
_BY_AGENT, _BY_SAMPLE = ("agent", "objects"), ("sample", "counts", "objects", "effects", "trust_objects")


def boxes_of(table: Table) -> Boxes:
    """The boxes in rows with the columns frame, id, x y z, l w h and yaw; their groups are frames."""
    position, size = (np.stack([column(table, name) for name in names], axis=1) for names in ("xyz", "lwh"))
    return Boxes(table["frame"], table["id"], position, size, column(table, "yaw"))


def _json_object(path: Path) -> dict[str, Any]:
    """A JSON file that holds an object."""
    path.lstat()  # raises FileNotFoundError
    return read_object(path)


def _counts(file: TableFile, frames: range | None) -> Table:
    """The counts of metrics.parquet."""
    table = file.rows(_COUNTS, frames)
    if any(np.isnan(column(table, name)).any() for name in ("fn", "fp", "tp", "id_switches")):
        raise ValueError("found missing counts, expected a number in every row")
    return table


def _judged(file: TableFile, frames: range | None) -> Any:
    """The rows of `RunFiles.all_objects`, with types and outcomes that the evaluator writes."""
    table = file.arrow((*_OBJECTS, "score"), frames)
    for name, kind in zip(table.column_names, table.schema.types, strict=True):
        is_right, expected = _TYPES.get(name, (pyarrow.types.is_floating, "floating-point numbers"))
        if not is_right(kind):
            raise ValueError(f"column {name}: found {kind}, expected {expected}")
        if name in _TYPES and table[name].null_count:
            raise ValueError(f"column {name}: found a missing value, expected one in every row")
        if is_right is pyarrow.types.is_dictionary:
            check_expanded(table[name])
    words = {word for part in table["outcome"].chunks for word in part.dictionary.to_pylist()}
    if unknown := sorted(words - set(OUTCOMES)):
        raise ValueError(f"column outcome: found {unknown[0]!r}, expected one of {', '.join(OUTCOMES)}")
    return table


#: Columns of objects.parquet that hold no floating-point numbers.
_TYPES = {
    **dict.fromkeys(("frame", "id", "match_id"), (pyarrow.types.is_integer, "integers")),
    **dict.fromkeys(
        ("agent", "estimator", "kind", "outcome", "cause", "by"),
        (pyarrow.types.is_dictionary, "text as a dictionary"),
    ),
}


def _effects(file: TableFile, sample: range) -> Table:
    """The rows of `RunFiles.effects`."""
    columns = [*_EFFECTS, *({"points"} & {*file.columns})]  # runs from before points lack it
    if sample.step == 1:
        return file.rows(columns, _frames_of(sample))

    def wanted(part: Table) -> Table:
        kinds = [np.unique(part[name], return_inverse=True)[1] for name in _KINDS]
        first = np.unique(np.column_stack([part["frame"], *kinds]), axis=0, return_index=True)[1]
        mask = are_in(sample, part["frame"])
        mask[first] = True
        return rows(part, mask)

    tables = [file.rows(columns, range(0)), *map(wanted, file.parts(columns))]
    return {name: np.concatenate([table[name] for table in tables]) for name in columns}


def _frames_of(sample: range) -> range | None:
    """The frames of which rows are read; None: all, also those that are about no frame."""
    return None if sample == ALL else sample
