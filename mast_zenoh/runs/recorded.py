"""A finished run with its recording: frame by frame, with everything that messages hold."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path

from mast_zenoh.errors import MessageError, RunFolderError
from mast_zenoh.launch import liveness, measurement
from mast_zenoh.launch.ending import RUNNING
from mast_zenoh.messages import codec
from mast_zenoh.messages.packed import check_kernels
from mast_zenoh.messages.schemas import Body
from mast_zenoh.metrics.record import Series
from mast_zenoh.run_folder import read_object
from mast_zenoh.run_folder.recording.reader import Recorded, file_of, read
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.routes import CLOCK, TRUTH, routes, scan_keys
from mast_zenoh.runs.run import Run


def open_recorded(path: Path) -> Run:
    """The finished run in a folder whose messages were recorded.

    Raises RunFolderError if the folder is not that of a recorded run, if the run is still in progress, or if its
    recording is damaged before its end; ConfigurationError if only compiled kernels can read it, and none are used.
    """
    file_of(path)
    if path.is_file():
        raise RunFolderError(f"{path}: found a file, expected the folder of a run")
    record = liveness.finished_record(path, read_object(path / "run.json"))
    notes = [] if record.get("status") == "ok" else [f"the run is {record.get('status')}: {record.get('message')}"]
    if record.get("status") == RUNNING:
        notes = ["run.json says that the run is in progress; whether it is cannot be known from here"]
    if (incomplete := measurement.incomplete_recording(path)) is not None:
        notes.append(f"messages.mcap: {incomplete}: later frames are missing")
    run = Run(path)
    run.files.notes[:0] = notes
    if not run.agents:
        raise RunFolderError(f"{path}: found no agent in the scenario of the run, expected one at least")
    check_kernels(run.files.wirings[0][1].codecs, str(path))
    return run


def frames_of(run: Run) -> Iterator[Frame]:
    """All frames of a recorded run in order, read one after the other; what it lacks is noted when all have been read.

    Raises RunFolderError if there is none.
    """
    count = dropped = without_truth = 0
    series_by_key = [
        (frame, routes(wiring, run.agents) | scan_keys(wiring, run.agents)) for frame, wiring in run.files.wirings
    ]
    for (time_ns, index), group in groupby(read(run.path), key=lambda message: (message.time_ns, message.frame)):
        bodies, refused = _first_valid(list(group), series_by_key)
        dropped += refused
        if CLOCK not in bodies and TRUTH not in bodies:
            dropped += len(bodies)  # not of a frame of this run: receivers refuse them
            continue
        count += 1
        without_truth += TRUTH not in bodies
        yield Frame(run.around(index), index, time_ns, bodies)
    if not count:
        raise RunFolderError(f"{file_of(run.path)}: found no whole frame, expected one at least")
    if dropped:
        run.files.note(f"messages.mcap: invalid messages, which receivers refuse, are left out: {dropped}")
    if without_truth:
        run.files.note(f"messages.mcap: frames without truth: {without_truth}")


def _first_valid(
    messages: Sequence[Recorded], series_by_key: Sequence[tuple[int, Mapping[str, Sequence[Series]]]]
) -> tuple[dict[Series, Body], int]:
    """The first valid message of each series, and how many invalid ones there are.

    series_by_key: from each frame of the run on
    """
    by_series: dict[Series, list[Recorded]] = {}
    refused = 0
    for message in messages:
        refused += message.malformed
        known = next(of for frame, of in reversed(series_by_key) if frame < message.step or frame < 0)
        for series in known.get(message.key, ()):
            by_series.setdefault(series, []).append(message)
    bodies: dict[Series, Body] = {}
    for series, candidates in by_series.items():
        for message in sorted(candidates, key=lambda each: (each.step, each.rank, each.seq)):
            try:
                bodies[series] = codec.decode(message.payload, message.type).body
                break
            except MessageError:
                refused += 1
    return bodies, refused
