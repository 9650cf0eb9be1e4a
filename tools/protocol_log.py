"""Says where the protocol of a process did something else than before.

    python tools/protocol_log.py RUN NODE            the log of a node and its replay with this code
    python tools/protocol_log.py LOG OTHER           two logs, such as of one schedule of the simulation

Logs are those of `mast run --debug-protocol`: logs/protocol/NODE.msgpack. Prints the first event or action that
differs, with its place in each, and exits with 1; or how many steps are equal. A replay runs the code of the node if it
comes with mast; with `--trust` also what the run folder names.
"""

from __future__ import annotations

import argparse
import contextlib
import shutil
import sys
import tempfile
from pathlib import Path

from mast_zenoh.config.loading import AllowedCode
from mast_zenoh.config.resolved import RECORDING, Resolved, has_topics_outside
from mast_zenoh.errors import ConfigurationError, MastError, RunFolderError
from mast_zenoh.mesh.hosting import build
from mast_zenoh.mesh.protocol_log import MAX_BYTES, PROTOCOL_LOGS, ProcessLog, difference, read, replay
from mast_zenoh.run_folder.files import check_plain, open_plain


def logs_in(path: Path) -> list[ProcessLog]:
    """The logs in a file; raises RunFolderError, and MessageError for something else."""
    with open_plain(path) as file:
        content = file.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise RunFolderError(f"{path}: found more than {MAX_BYTES} bytes, expected at most as many")
    return read(content)


def replayed(run_folder: Path, log: ProcessLog, *, confirmed: bool = False) -> ProcessLog:
    """The replay of a log of a run; the node writes its files elsewhere."""
    folder = run_folder.resolve()
    resolved = Resolved.from_json(log.beginning.scenario, log.beginning.wiring)
    resolved = resolved.allowing(AllowedCode.of(confirmed=confirmed), str(run_folder), folder)
    if has_topics_outside(resolved.nodes[log.beginning.node]):
        raise ConfigurationError(f"{log.beginning.node}: exchanges messages with programs outside the run: no replay")
    with tempfile.TemporaryDirectory(prefix="mast-") as own, contextlib.chdir(own):
        if (scene := folder / RECORDING).exists():
            shutil.copy(check_plain(scene), RECORDING)
        return replay(log, build(resolved, log.beginning.node))


def main() -> None:
    """Compare two logs, or a log and its replay."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("first", type=Path, metavar="RUN|LOG")
    parser.add_argument("second", metavar="NODE|LOG")
    parser.add_argument("--trust", action="store_true", help="run the code that the run folder names")
    arguments = parser.parse_args()
    try:
        if arguments.first.is_dir():
            ones = logs_in(arguments.first / PROTOCOL_LOGS / f"{arguments.second}.msgpack")
            others = [replayed(arguments.first, log, confirmed=arguments.trust) for log in ones]
        else:
            ones, others = logs_in(arguments.first), logs_in(Path(arguments.second))
    except (MastError, OSError) as error:
        sys.exit(f"{type(error).__name__}: {error}")
    for number, (one, other) in enumerate(zip(ones, others, strict=False)):
        if different := difference(one, other):
            sys.exit(f"process {number}:\n{different}")
        cut = "" if one.whole and other.whole else "; a log ends within a record"
        print(f"process {number}: {len(one.steps)} steps are equal{cut}")
    if len(ones) != len(others):
        sys.exit(f"found logs of {len(ones)} and {len(others)} processes")


if __name__ == "__main__":
    main()
