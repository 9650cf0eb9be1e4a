"""`mast` with an event injected the first time that it reaches a stage.

    python -m at_stage STAGE WHAT… -- run baseline …

WHAT: signals by name (SIGINT SIGINT), or the path of a file that is extended until its disk is full.
"""

import errno
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mast_zenoh import __main__ as process


def fill(path: Path) -> None:
    """Fill the free space of a disk."""
    with path.open("wb", buffering=0) as file:
        for size in (1 << 16, 1 << 12, 1 << 8, 1):
            try:
                while file.write(b"\xff" * size) == size:
                    pass
            except OSError as error:
                if error.errno != errno.ENOSPC:
                    raise


def happen(words: list[str]) -> None:
    """The event. Signals come during generated code, such as that of a dataclass."""
    for word in words:
        if word.startswith("SIG"):
            exec("come(word)", {"come": signal.raise_signal, "word": signal.Signals[word]})
        else:
            fill(Path(word))


def before(place: Any, name: str, words: list[str], times: int = 1) -> None:
    """Cause the event before the `times`-th call of the function."""
    call: Callable[..., Any] = getattr(place, name)
    calls = 0

    def wrapped(*arguments: Any, **options: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == times:
            happen(words)
        return call(*arguments, **options)

    setattr(place, name, wrapped)


def arrange(stage: str, words: list[str]) -> None:
    """Arrange the event at a stage of `mast run`."""
    if stage == "loading":
        from mast_zenoh import scenario

        before(scenario, "resolve", words)
    elif stage == "starting":
        from mast_zenoh.launch import run

        before(run.run_folder, "versions", words)
    elif stage == "building":
        from mast_zenoh.mesh.inproc import InProcess

        before(InProcess, "run", words)
    elif stage == "playing":
        from mast_zenoh.launch.display import Display

        before(Display, "update", words, times=3)
    elif stage == "collecting":
        from mast_zenoh.launch import conclusion

        before(conclusion, "write", words)
    elif stage == "reporting":
        from mast_zenoh.show import html

        before(html, "write_page", words)
    else:
        raise SystemExit(f"no such stage: {stage}")


if __name__ == "__main__":
    split = sys.argv.index("--")
    stage, *words = sys.argv[1:split]
    sys.argv = ["mast", *sys.argv[split + 1 :]]
    os.environ["PYTHONUNBUFFERED"] = "1"
    arrange(stage, words)
    process.main()
