"""Scripts: what each node of a recorded run sent, frame by frame, to be sent again."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import msgpack
import numpy as np

from mast_zenoh.errors import MessageError, RunFolderError
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Message
from mast_zenoh.run_folder import check_plain

#: Folder of the scripts in the run folder of a replay, and their suffix.
FOLDER, SUFFIX = Path("played"), ".msgpack"


class Output(NamedTuple):
    """A key on which a node publishes.

    port, subject: of the node, see `wiring.model.Ports`;  message: its type
    numbers: how many sequence numbers the recording of its wire uses
    reported_numbers: of a link's reports, the same of the wires that they are about, by `port` in them
    """

    port: str
    subject: str
    message: str
    numbers: int
    reported_numbers: Sequence[int] = ()


@dataclass(frozen=True)
class Script:
    """The recorded messages of one node.

    path:      its file, relative to the run folder of the replay
    outputs:   the keys on which it publishes
    sent:      by step, (index of the output, bytes) in the order of sending
    times_ns:  times of the recorded frames, ns
    period_ns: interval of the scene's frames, ns
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
            data = msgpack.unpackb(check_plain(path).read_bytes(), strict_map_key=False)
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
        """The time of a frame, ns."""
        repetition, recorded = divmod(frame, len(self.times_ns))
        return self.times_ns[recorded] + repetition * self.span_ns

    def messages(self, step: int) -> Iterator[tuple[Output, bytes]]:
        """The messages that the node sent in a step, in order.

        In repetitions, frames, times and sequence numbers in the headers continue those of the repetition before.
        """
        repetition, recorded = divmod(step, len(self.times_ns))
        for index, payload in self.sent.get(recorded, ()):
            output = self.outputs[index]
            yield output, self._repeated(payload, output, repetition) if repetition else payload

    @property
    def span_ns(self) -> int:
        """Time from the beginning of a repetition to that of the next, ns.

        The frames of uneven recordings may be longer than their period: time ascends nevertheless.
        """
        return max(len(self.times_ns) * self.period_ns, self.times_ns[-1] + 1)

    def _repeated(self, payload: bytes, output: Output, repetition: int) -> bytes:
        """A message as of a later repetition; unchanged if it is malformed."""
        frames = repetition * len(self.times_ns)
        try:
            header, body = codec.decode_lazily(payload, output.message)
            header = header._replace(
                frame=header.frame + frames,
                time_ns=header.time_ns + repetition * self.span_ns,
                seq=header.seq + repetition * output.numbers,
            )
            if output.reported_numbers:
                numbers = repetition * np.array(output.reported_numbers, np.int64)[body["port"]]
                body = {**body, "frame": body["frame"] + frames, "seq": body["seq"] + numbers}
            return codec.encode(Message(header, dict(body)))
        except MessageError:
            return payload


def path_of(node: str) -> Path:
    """The path of a node's script, relative to the run folder."""
    return FOLDER / f"{node}{SUFFIX}"


def discard(folder: Path) -> None:
    """Remove what the played nodes of a replay have sent: it is in both recordings."""
    shutil.rmtree(folder / FOLDER, ignore_errors=True)
