"""Shows the progress of a run: a live table on a terminal, a few plain lines elsewhere.

Everything fits a terminal of 60 columns, and its height: with many nodes there are two columns of them, and of those
that do not fit only the number is shown, after the nodes with something to see.
"""

from __future__ import annotations

import sys
import textwrap
import time
from collections.abc import Callable, Sequence

from rich.console import Console
from rich.live import Live
from rich.text import Text

from mast_zenoh.launch.observation import Activity, NewestScore, Status

_PERIOD_S = 0.25  # between two drawings of the table
_SHARE = 0.02  # of the launcher's time that the display takes at most
_SWITCH_S = 0.0005  # after which Python lets Zenoh's threads in while the display is drawn; its default is 5 ms
_LINE_S = 60.0  # without a terminal: between two lines at most
_ENDLESS = 10**8  # frames that no run reaches: a replay that repeats until Ctrl-C
_DASH = "\u2013"
_NAME, _LONG_NAME = 14, 30  # characters, with two columns of nodes and with one
_NUMBERS = 23  # characters beside the name
_GAP = 2
_MIN_NODES = 4  # that are shown even on a terminal with few lines

_STYLE = {"starting": "yellow", "running": "green", "done": "blue", "attack": "magenta", "fault": "magenta"}
_ORDINARY = ("running", "starting", "done")


class Display:
    """Context manager that shows progress (`update`) and permanent lines (`say`).

    quiet: show no progress
    """

    def __init__(self, console: Console, title: str, frames: int, *, quiet: bool = False) -> None:
        self.console = console
        self.live = console.is_terminal and not quiet and not console.quiet
        self._title = title
        self._frames = frames
        self._quiet = quiet
        self._live: Live | None = None
        self._next_s = 0.0
        self._printed_frame = 0
        self._printed_s = 0.0
        self._waited_s = float("-inf")  # when a line said for which nodes the end waits
        self._first_s: float | None = None  # when a frame was seen first
        self._first_frame = 0  # which
        self._switch_s = sys.getswitchinterval()

    def __enter__(self) -> Display:
        if self.live:
            self._live = Live(console=self.console, auto_refresh=False, transient=True, vertical_overflow="crop")
            self._live.__enter__()
            sys.setswitchinterval(_SWITCH_S)
        return self

    def __exit__(self, *_: object) -> None:
        if self._live:
            sys.setswitchinterval(self._switch_s)
            self._live.__exit__(None, None, None)

    def say(self, line: str) -> None:
        """Print a permanent line, unbroken however long it is."""
        self.console.print(line, highlight=False, soft_wrap=True)

    def update(self, frame: int, status: Callable[[], Status], waiting: str = "") -> None:
        """Show the run at a frame; `status` is only called when it is time to draw.

        waiting: for which nodes the end of the run waits
        """
        now = time.monotonic()
        if frame > 0 and self._first_s is None:
            self._first_s, self._first_frame = now, frame
            self._printed_s = now
        if self._live:
            if now >= self._next_s:
                width, height = self.console.size
                lines = self.lines(status(), width, height - 1)
                self._live.update(Text("\n").join(lines), refresh=True)
                done = time.monotonic()
                self._next_s = max(now + _PERIOD_S, done + (done - now) / _SHARE)
        elif waiting and not self._quiet:
            if now - self._waited_s >= _LINE_S:
                self._waited_s = now
                self.say(f"{self._title}: {waiting}")
        elif not self._quiet and self._is_line_due(frame, now):
            self._printed_frame, self._printed_s = frame, now
            of = f" of {self._frames}" if self._frames < _ENDLESS else ""
            self.say(f"{self._title}: frame {frame}{of} {self._rate(frame)}")

    def lines(self, status: Status, width: int, height: int) -> list[Text]:
        """What is shown on a terminal of this size."""
        head = [self._progress(status.frame, width)]
        below = [*_score_lines(status.score, width), *_event_lines(status.events, width)]
        room = max(_MIN_NODES, height - len(head) - len(below) - 2)  # headings, and a line for those left out
        return [*head, *_node_lines(status, width, room), *below]

    def _is_line_due(self, frame: int, now: float) -> bool:
        """Whether a quarter of the run or a minute has passed since the last line."""
        passed = frame - self._printed_frame
        is_due = passed >= max(1, self._frames // 4) or now - self._printed_s >= _LINE_S
        return passed > 0 and frame <= self._frames and is_due

    def _rate(self, frame: int) -> str:
        elapsed_s = time.monotonic() - self._first_s if self._first_s is not None else 0.0
        return f"{(frame - self._first_frame) / elapsed_s:.0f}/s" if elapsed_s > 0.2 else ""

    def _progress(self, frame: int, width: int) -> Text:
        """Title, bar and number of frames in one line."""
        of = f"/{self._frames}" if self._frames < _ENDLESS else ""
        numbers = f" {frame}{of} frames {self._rate(frame)}"
        title = _cut(self._title, max(8, width - len(numbers) - 12)) + " "
        length = max(0, width - len(title) - len(numbers))
        filled = min(length, length * frame // max(1, self._frames))
        line = Text(title, style="bold", no_wrap=True)
        return line.append("━" * filled, "green").append("━" * (length - filled), "dim").append(numbers, "not bold")


def _node_lines(status: Status, width: int, room: int) -> list[Text]:
    """A line for each node, or two nodes on a line; at most `room` lines, and one for those left out."""
    columns = 2 if len(status.states) > room and width >= 2 * (_NAME + _NUMBERS) + _GAP else 1
    name_width = _NAME if columns == 2 else min(_LONG_NAME, width - _NUMBERS)
    names = list(status.states)
    shown = names[: room * columns]
    if len(names) > len(shown):  # those with something to see first, each group in the order of the scenario
        notable = [name for name in names if _is_notable(status, name)]
        shown = [*notable, *(name for name in names if name not in notable)][: room * columns]
        shown.sort(key=names.index)
    rows = -(-len(shown) // columns)
    heading = Text(f"{'node':<{name_width}} state       /s lag drops", style="dim", no_wrap=True)
    lines = [Text(" " * _GAP).join([heading] * columns)]
    for row in range(rows):
        cells = [_cell(name, status, name_width) for name in shown[row::rows]]
        lines.append(Text(" " * _GAP, no_wrap=True).join(cells))
    if len(names) > len(shown):
        lines.append(Text(f"and {len(names) - len(shown)} more", style="dim"))
    return lines


def _cell(name: str, status: Status, name_width: int) -> Text:
    state, activity = status.states[name], status.activities.get(name, Activity())
    rate = _DASH if activity.rate_hz is None else _number(activity.rate_hz, 4)
    lag, drops = (_DASH if n is None else _number(n, size) for n, size in ((activity.lag, 3), (activity.drops, 5)))
    line = Text(f"{_cut(name, name_width):<{name_width}} ", no_wrap=True)
    line.append(f"{_cut(state, 8):<8} ", _STYLE.get(state, "red")).append(f"{rate:>4} {lag:>3} ")
    return line.append(f"{drops:>5}", "yellow" if activity.drops else "")


def _is_notable(status: Status, name: str) -> bool:
    activity = status.activities.get(name, Activity())
    return status.states[name] not in _ORDINARY or bool(activity.drops) or (activity.lag or 0) > 1


def _score_lines(score: NewestScore | None, width: int) -> list[Text]:
    line = f"picture: missed {_DASH}, false {_DASH}, matched {_DASH}"
    if score is not None:
        line = f"picture of {score.agent}: missed {score.missed}, false {score.false}, matched {score.matched}"
        line += "" if score.rmse_m is None else f", RMSE {score.rmse_m:.2f} m"
        line += "" if score.latency_ms is None else f", latency {score.latency_ms:.0f} ms"
    return [_fitted(part, width) for part in textwrap.wrap(line, width, subsequent_indent="  ")]


def _event_lines(events: Sequence[str], width: int, most: int = 3) -> list[Text]:
    shown = events if len(events) <= most else [*events[: most - 1], f"and {len(events) - most + 1} more events"]
    return [_fitted(f"now: {event}", width, "magenta") for event in shown]


def _fitted(line: str, width: int, style: str = "") -> Text:
    return Text(_cut(line, width), style=style, no_wrap=True)


def _cut(text: str, width: int) -> str:
    return text if len(text) <= width else f"{text[: width - 1]}…"


def _number(value: float, width: int) -> str:
    """A number of 0 or more in at most `width` characters: 12.5, 480, 13k."""
    if isinstance(value, float) and value < 99.95:
        return f"{value:.1f}"
    for scale, unit in ((1, ""), (1000, "k"), (1000_000, "M")):
        if len(text := f"{round(value) // scale}{unit}") <= width:
            return text
    return ">" * width
