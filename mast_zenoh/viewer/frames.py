"""The record of a finished run, one frame at a time, as arrays in the world frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import pyarrow

from mast_zenoh.errors import MastError, MessageError, RunFolderError
from mast_zenoh.launch import liveness, measurement
from mast_zenoh.launch.ending import RUNNING
from mast_zenoh.launch.measurement import recorded_wirings
from mast_zenoh.launch.tables import from_arrow, read_arrow
from mast_zenoh.messagelog.reader import Recorded, file_of, read
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Body
from mast_zenoh.metrics.record import Series
from mast_zenoh.run_files import read_object
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.viewer import routes
from mast_zenoh.viewer.evaluated import ChangeTable, Judgements, ScoreTable, Table
from mast_zenoh.viewer.frame import Frame, frame_of
from mast_zenoh.viewer.routes import CLOCK, TRUTH
from mast_zenoh.wiring.model import Wiring


@dataclass(frozen=True, eq=False)
class RunFrames:
    """The record of a finished run.

    path:    its folder;  run: run.json
    agents:  their names, the main agent first;  topics: by series of objects, its key expression
    scene:   buildings, sensors and cameras; None: not known
    missing: a sentence for everything that the record lacks; complete when all frames have been read
    """

    path: Path
    run: Mapping[str, Any]
    agents: tuple[str, ...]
    topics: Mapping[Series, str]
    scene: Recording | None
    missing: list[str]
    _wirings: Sequence[tuple[int, Mapping[str, Sequence[Series]]]]
    _judgements: Judgements
    _scores: ScoreTable
    _changes: ChangeTable

    @classmethod
    def load(cls, path: Path) -> RunFrames:
        """Open the folder of a finished run.

        Raises RunFolderError if the folder is not that of a recorded run, if the run is still in progress, or if its
        recording is damaged before its end.
        """
        file_of(path)
        if path.is_file():
            raise RunFolderError(f"{path}: found a file, expected the folder of a run")
        run = liveness.finished_record(path, read_object(path / "run.json"))
        missing = [] if run.get("status") == "ok" else [f"the run is {run.get('status')}: {run.get('message')}"]
        if run.get("status") == RUNNING:
            missing = ["run.json says that the run is in progress; whether it is cannot be known from here"]
        if (incomplete := measurement.incomplete_recording(path)) is not None:
            missing.append(f"messages.mcap: {incomplete}: later frames are missing")
        wirings = recorded_wirings(path)
        agents = _agents(path, wirings)
        topics: dict[Series, str] = {}
        for _, wiring in wirings:
            topics |= routes.topics(wiring, agents)
        read = partial(_read_or_note, path, missing)
        metrics = read("metrics.json", read_object, "estimates that equal others may lack outcomes", {})
        same_as = metrics.get("same_as") or {}
        no_outcomes = "no object is marked as matched, missed or false"
        return cls(
            path,
            run,
            agents,
            routes.in_order(topics, agents),
            read("scene.npz", Recording.load, "no buildings, and cameras are the default ones", None),
            missing,
            [(frame, routes.routes(wiring, agents)) for frame, wiring in wirings],
            read("objects.parquet", lambda file: Judgements(_table(file), same_as), no_outcomes, Judgements.none()),
            read("metrics.parquet", lambda file: ScoreTable(_table(file)), "no scores", ScoreTable.none()),
            read("attacks.parquet", lambda file: ChangeTable(_table(file)), "no changes are shown", ChangeTable.none()),
        )

    @property
    def ego(self) -> str:
        """The main agent: `ego`, else the first."""
        return self.agents[0]

    @property
    def name(self) -> str:
        """The run's own id."""
        return str(self.run.get("id") or self.path.name)

    @property
    def scored(self) -> list[Series]:
        """Agents and estimates with scores, of those that have objects."""
        estimators = {series.estimator for series in self.topics}
        return [series for series in self._scores.series if series.estimator in estimators]

    def __iter__(self) -> Iterator[Frame]:
        """All frames in order, read from the recording one after the other.

        Raises RunFolderError if there is none.
        """
        count = dropped = without_truth = 0
        for (time_ns, index), group in groupby(read(self.path), key=lambda message: (message.time_ns, message.frame)):
            chosen, refused = self._choose(list(group))
            dropped += refused
            if CLOCK not in chosen and TRUTH not in chosen:
                dropped += len(chosen)  # not of a frame of this run: receivers refuse them
                continue
            count += 1
            without_truth += TRUTH not in chosen
            yield frame_of(self, index, time_ns, chosen, self._judgements, self._scores, self._changes)
        if not count:
            raise RunFolderError(f"{file_of(self.path)}: found no whole frame, expected one at least")
        if dropped:
            self.note(f"messages.mcap: invalid messages, which receivers refuse, are left out: {dropped}")
        if without_truth:
            self.note(f"messages.mcap: frames without truth: {without_truth}")

    def note(self, sentence: str) -> None:
        """Add a sentence about something that the record lacks, once."""
        if sentence not in self.missing:
            self.missing.append(sentence)

    def _choose(self, messages: Sequence[Recorded]) -> tuple[dict[Series, Body], int]:
        """The first valid message of each series, and how many invalid ones there are."""
        by_series: dict[Series, list[Recorded]] = {}
        refused = 0
        for message in messages:
            refused += message.malformed
            for series in self._routes(message.step).get(message.key, ()):
                by_series.setdefault(series, []).append(message)
        chosen: dict[Series, Body] = {}
        for series, candidates in by_series.items():
            for message in sorted(candidates, key=lambda each: (each.step, each.rank, each.seq)):
                try:
                    chosen[series] = codec.decode(message.payload, message.type).body
                    break
                except MessageError:
                    refused += 1
        return chosen, refused

    def _routes(self, step: int) -> Mapping[str, Sequence[Series]]:
        """The series by key in a frame of the run."""
        return next(of for frame, of in reversed(self._wirings) if frame < step or frame < 0)


def _agents(path: Path, wirings: Sequence[tuple[int, Wiring]]) -> tuple[str, ...]:
    """The names of the agents, the main one first: nodes that send tracks which a broker collates."""
    names = dict.fromkeys(
        wire.legs[0].publisher.node
        for _, wiring in wirings
        for wire in wiring.wires
        if wire.message == "tracks" and wire.legs[0].publisher.port == "tracks" and wire.subject
    )
    if not names:
        raise RunFolderError(f"{path}: found no agent in the wiring of the run, expected one at least")
    return tuple(sorted(names, key=lambda name: name != "ego"))


def _read_or_note(
    path: Path, missing: list[str], name: str, read_file: Callable[[Path], Any], consequence: str, default: Any
) -> Any:
    """Read a file of a run folder; notes what is missing instead of failing."""
    file = path / name
    try:
        if not file.is_file():
            raise FileNotFoundError
        return read_file(file)
    except FileNotFoundError:
        missing.append(f"{name} is absent: {consequence}")
    except KeyError as error:
        missing.append(f"{name} cannot be read (found no column {error}): {consequence}")
    except (OSError, ValueError, TypeError, MastError, pyarrow.ArrowException) as error:
        missing.append(f"{name} cannot be read ({str(error).removeprefix(f'{file}: ')}): {consequence}")
    return default


def _table(path: Path) -> Table:
    table: Table = from_arrow(read_arrow(path))
    return table
