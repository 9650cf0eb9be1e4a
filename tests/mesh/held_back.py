"""A lock-step run with remote nodes whose frames begin when a file says so.

    python held_back.py SCENARIO OUT

OUT.frames holds the number of frames that may begin; between frames the run waits and accepts messages.
"""

import sys
from pathlib import Path

from launched_apart import Beside

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.launch import run
from mast_zenoh.mesh.protocol.driver import DriverProtocol, DriverState, Phase

_LOOK_EVERY_S = 0.02


def gate(out: Path) -> Path:
    """The file that holds how many frames may begin."""
    return out.with_suffix(".frames")


def allow(out: Path, frames: int) -> None:
    """Allow this many frames to begin."""
    written = gate(out).with_suffix(".next")
    written.write_text(str(frames))
    written.replace(gate(out))


def hold_back(file: str) -> None:
    """Make this process's driver begin frames only as the file allows."""
    carry_out = DriverProtocol._carry_out

    def when_allowed(self: DriverProtocol) -> Phase:
        while self.frames >= int(Path(file).read_text()) and not self._end_reason:
            yield from self._wait(DriverState.PACING, self._now_s + _LOOK_EVERY_S)
        return (yield from carry_out(self))

    DriverProtocol._carry_out = when_allowed  # type: ignore[method-assign]


def resolved(file: str) -> Resolved:
    """The scenario to run."""
    return scenario.resolve(*scenario.load(file, []), record=True)


def main() -> None:
    """Run it; print an error and return its exit code."""
    file, out = sys.argv[1], Path(sys.argv[2])
    here = [str(Path(__file__).parent), *sys.path]
    wait = f"__import__('sys').path[:0] = {here!r}; __import__('held_back').hold_back({str(gate(out))!r})"
    outcome = run.run(resolved(file), out, engine=Beside({"simulator": wait}))
    if outcome.error:
        print(f"{type(outcome.error).__name__}: {outcome.error}", file=sys.stderr)
        sys.exit(outcome.error.exit_code)


if __name__ == "__main__":
    main()
