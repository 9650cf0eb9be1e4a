"""The command line as a process: `mast`, and `python -m mast_zenoh`.

It handles signals and its standard streams before anything that takes time is imported.
"""

import signal
import sys

from mast_zenoh import standard_streams, stop_signals


def main() -> None:
    """Carry out the command, and end the process with its exit code; see docs/exit_codes.md."""
    code = stop_signals.EXIT_CODE
    try:
        with stop_signals.interrupting():
            standard_streams.replace()
            from mast_zenoh import cli

            code = cli.carry_out()
    except KeyboardInterrupt:
        sys.stderr.write("error: Interrupted: stopped before anything was started\n")
    for number in stop_signals.SIGNALS:
        signal.signal(number, signal.SIG_IGN)  # all is done: the interpreter only has to tidy up
    failure = standard_streams.failed_output()
    if failure is not None:
        sys.stderr.write(f"error: standard output: {failure.strerror}: some of what was printed is lost\n")
        from mast_zenoh.errors import DiskFull

        code = code or DiskFull.exit_code
    sys.exit(code)


if __name__ == "__main__":
    main()
