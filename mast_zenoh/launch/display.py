"""Shows the progress of a run: a live panel on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Mapping
from types import TracebackType

from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table


class Display:
    """Context manager that shows progress (`update`) and permanent lines (`say`)."""

    def __init__(self, console: Console, title: str, frames: int) -> None:
        self.console = console
        self._title = title
        self._frames = frames
        self._bar = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("frames  {task.fields[rate]}"),
            TimeRemainingColumn(),
        )
        self._task = self._bar.add_task(title, total=frames, rate="")
        self._live: Live | None = None
        self._printed_frame = 0
        self._first_frame_at: float | None = None

    def __enter__(self) -> Display:
        if self.console.is_terminal:
            self._live = Live(self._bar, console=self.console, refresh_per_second=8, transient=True)
            self._live.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live:
            self._live.__exit__(kind, error, trace)

    def say(self, line: str) -> None:
        """Print a permanent line."""
        self.console.print(line, highlight=False)

    def update(self, frame: int, states: Mapping[str, str]) -> None:
        """Show the newest frame and the state of every node."""
        now = time.monotonic()
        if frame > 0 and self._first_frame_at is None:
            self._first_frame_at = now
        elapsed_s = now - self._first_frame_at if self._first_frame_at else 0.0
        rate = f"{frame / elapsed_s:.0f}/s" if elapsed_s > 0.2 else ""
        if self._live:
            self._bar.update(self._task, completed=frame, rate=rate)
            table = Table.grid(padding=(0, 2))
            cells = [f"[{_COLOUR.get(state, 'red')}]●[/] {name} [dim]{state}" for name, state in states.items()]
            for row in _rows(cells, 4):
                table.add_row(*row)
            grid = Table.grid()
            grid.add_row(self._bar)
            grid.add_row(table)
            self._live.update(grid)
        elif self._printed_frame + max(1, self._frames // 4) <= frame <= self._frames:
            self._printed_frame = frame
            self.say(f"{self._title}: frame {frame} of {self._frames} {rate}")


_COLOUR = {"starting": "yellow", "running": "green", "done": "blue"}


def _rows(cells: list[str], width: int) -> list[list[str]]:
    return [cells[i : i + width] for i in range(0, len(cells), width)]
