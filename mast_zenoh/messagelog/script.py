"""Scripts: what each node of a recorded run sent, frame by frame, to be sent again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import msgpack

from mast_zenoh.errors import RunFolderError

#: Folder of the scripts in the run folder of a replay, and their suffix.
FOLDER, SUFFIX = Path("played"), ".msgpack"

#: Message types whose columns refer to single frames: they are played once only, as they fit no repetition.
_REPORTS = ("attack_report", "link_report")


class Output(NamedTuple):
    """A key on which a node publishes.

    port, subject: of the node, see `wiring.model.Ports`;  message: its type
    numbers: how many sequence numbers the recording of its wire uses
    """

    port: str
    subject: str
    message: str
    numbers: int


@dataclass(frozen=True)
class Script:
    """The recorded messages of one node.

    path:      its file, relative to the run folder of the replay
    outputs:   the keys on which it publishes
    sent:      by step, (index of the output, bytes) in the order of sending
    times_ns:  times of the recorded frames, ns
    period_ns: ns, interval of the scene's frames: the time between two repetitions
    repeats:   how often the recording is played
    """

    path: Path
    outputs: Sequence[Output]
    sent: Mapping[int, Sequence[tuple[int, bytes]]]
    times_ns: Sequence[int]
    period_ns: int
    repeats: int = 1

    @classmethod
    def load(cls, path: Path) -> Script:
        """Read the script of a file; raises RunFolderError if it is missing or damaged."""
        try:
            data = msgpack.unpackb(path.read_bytes(), strict_map_key=False)
            outputs = [Output(*output) for output in data["outputs"]]
            sent = {step: [(index, payload) for index, payload in lines] for step, lines in data["sent"].items()}
            return cls(path, outputs, sent, data["times_ns"], data["period_ns"], data["repeats"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise RunFolderError(f"{path}: the script of a played node cannot be read: {error!r}") from None

    def save(self, run_folder: Path) -> None:
        """Write the script into a run folder."""
        file = run_folder / self.path
        file.parent.mkdir(exist_ok=True)
        names = ("outputs", "sent", "times_ns", "period_ns", "repeats")
        file.write_bytes(msgpack.packb({name: getattr(self, name) for name in names}))

    @property
    def ports(self) -> dict[str, str]:
        """Message types by output port."""
        return {output.port: output.message for output in self.outputs}

    @property
    def frames(self) -> int:
        """Number of frames of all repetitions."""
        return len(self.times_ns) * self.repeats

    def time_ns(self, frame: int) -> int:
        """The time of a frame, ns; a repetition begins one period after the last frame of the one before."""
        repetition, recorded = divmod(frame, len(self.times_ns))
        return self.times_ns[recorded] + repetition * self._span_ns

    def messages(self, step: int) -> Iterator[tuple[Output, bytes]]:
        """The messages that the node sent in a step, in order.

        In repetitions, frames, times and sequence numbers in the headers continue those of the repetition before.
        """
        repetition, recorded = divmod(step, len(self.times_ns))
        for index, payload in self.sent.get(recorded, ()):
            output = self.outputs[index]
            if repetition == 0:
                yield output, payload
            elif output.message not in _REPORTS:
                shift = (len(self.times_ns), self._span_ns, output.numbers)
                yield output, _shifted(payload, *(repetition * each for each in shift))

    @property
    def _span_ns(self) -> int:
        return self.times_ns[-1] - self.times_ns[0] + self.period_ns


def path_of(node: str) -> Path:
    """The path of a node's script, relative to the run folder."""
    return FOLDER / f"{node}{SUFFIX}"


def _shifted(payload: bytes, frames: int, time_ns: int, numbers: int) -> bytes:
    """A message about a later frame; a malformed one is unchanged."""
    try:
        fields = msgpack.unpackb(payload)
        for name, shift in (("frame", frames), ("time_ns", time_ns), ("seq", numbers)):
            fields[name] += shift
        return bytes(msgpack.packb(fields))
    except Exception:  # any bytes may be on a wire
        return payload
