"""The command line as a process: `mast`, and `python -m mast_zenoh`.

It sets up signal handlers and standard streams before slow imports.
"""

import gc
import os
import signal
import sys
from typing import NoReturn

gc.disable()  # what is imported stays: searching it for garbage delays the start


def _end_at_once(number: int, frame: object) -> None:
    """Handle a stop signal before anything has started: exit at once.

    An exception is not safe here: code that is being imported may turn it into another one.
    """
    try:
        os.write(2, f"error: Interrupted: stopped by {signal.Signals(number).name}\n".encode())
    finally:
        os._exit(130)


for _number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    if _number != signal.SIGHUP or signal.getsignal(_number) != signal.SIG_IGN:
        signal.signal(_number, _end_at_once)


def _cannot_start(error: BaseException) -> NoReturn:
    """Report on one line that a module could not be imported, such as for want of memory; exit."""
    from mast_zenoh.errors import MastError, ResourcesExhausted, is_out_of_resources

    kind = ResourcesExhausted if is_out_of_resources(error) else MastError
    reason = " ".join(str(error).split()) or type(error).__name__
    sys.stderr.write(f"error: {kind.__name__}: cannot start: {reason}\n")
    sys.exit(kind.exit_code)


try:
    from mast_zenoh.cli import standard_streams  # these import what takes time
    from mast_zenoh.launch import stop_signals
except (ImportError, MemoryError) as _error:
    _cannot_start(_error)


def main() -> None:
    """Run the command and exit with its code (docs/ref-exit-codes.md)."""
    standard_streams.replace()
    try:
        from mast_zenoh.cli import app
    except (ImportError, MemoryError) as error:
        _cannot_start(error)

    gc.freeze()
    gc.set_threshold(50_000, 20, 20)
    gc.enable()
    code = stop_signals.EXIT_CODE
    try:
        with stop_signals.interrupting():
            code = app.carry_out()
    except KeyboardInterrupt:
        sys.stderr.write("error: Interrupted: stopped before anything was started\n")
    for number in stop_signals.SIGNALS:
        signal.signal(number, signal.SIG_IGN)  # the interpreter is about to exit
    failure = standard_streams.failed_output()
    if failure is not None:
        sys.stderr.write(f"error: standard output: {failure.strerror}: some of what was printed is lost\n")
        from mast_zenoh.errors import DiskFull

        code = code or DiskFull.exit_code
    # Python ends a process by SIGINT if a KeyboardInterrupt has ever left code executed from a string, such as that of
    # a dataclass, even if it was caught. Executing another string clears that.
    exec("")
    sys.exit(code)


if __name__ == "__main__":
    main()
