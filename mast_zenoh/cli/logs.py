"""`mast logs RUN [NODE]`: what the nodes of a run have logged."""

from __future__ import annotations

import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from mast_zenoh.cli import completion, standard_streams
from mast_zenoh.cli.options import err as _err
from mast_zenoh.cli.options import escaped
from mast_zenoh.launch import stop_signals

_POLL_S = 0.2


def logs(
    run_folder: Annotated[
        Path, typer.Argument(metavar="RUN", help="The folder of a run.", autocompletion=completion.run_folders)
    ],
    node: Annotated[
        str | None,
        typer.Argument(metavar="[NODE]", help="The node. Default: all.", autocompletion=completion.logged_nodes),
    ] = None,
    follow: Annotated[
        bool, typer.Option("--follow", "-f", help="Continue with new lines until the run ends, or Ctrl-C.")
    ] = False,
) -> None:
    """Print the logs of a run's nodes, in the order of time; of all nodes with their names."""
    from mast_zenoh.launch.log_reading import RunLogs

    run_logs = RunLogs(run_folder, node)
    printed = False
    received: list[int] = []  # no exception: it could come while a line is being written, and repeat it
    with suppress(KeyboardInterrupt), stop_signals.second_interrupts(received):
        running = True
        while running and not received and standard_streams.is_read():
            running = follow and run_logs.running  # asked first: a node may log until the run ends
            for line in run_logs.new_lines(partial=not running):
                prefix = f"{line.node}  " if node is None else ""
                sys.stdout.write(f"{escaped(prefix + line.text)}\n")
                printed = True
                if received:
                    break
            sys.stdout.flush()
            if running and not received:
                threading.Event().wait(_POLL_S)
    if not (printed or run_logs.problems or received):
        sentence = "no node has written to its log" if node is None else f"{node} has not written to its log"
        _err.print(sentence, markup=False, highlight=False)
    for log, problem in run_logs.problems.items():
        _err.print(f"warning: {run_folder / log}: {problem}", style="bold yellow", markup=False, highlight=False)
