"""The one error tree. Every leaf that ends a command has its own exit code (docs/exit_codes.md).

    MastError                     1   anything not named below
    ├── ConfigurationError       10   a scenario or study is wrong
    │   ├── WiringError          11   a key-expression map or rewrite is wrong
    │   └── NodeFileError        12   a node's file is missing or does not define the node
    ├── SceneError               13   a scene's data is missing, truncated or inconsistent
    ├── MessageError             14   bytes that are not a message of the expected schema
    ├── RunFolderError           15   a run folder is missing, incomplete or already in use
    │   └── NotComparable        17   two runs cannot be compared
    ├── CredentialsError         16   a certificate or key is missing, expired or refused
    └── RunError                 20   a run ended badly
        ├── StartError           21   the nodes did not all come up in time
        ├── NodeDied             22   a node whose policy is `fail` ended
        ├── StallError           23   lock-step made no progress in time
        ├── TrialsFailed         24   some trials of a study failed; the others are kept
        ├── BackendError         25   this machine cannot carry out a fault
        ├── NotRunning           26   a run that is to be changed does not run
        ├── EngineError          27   an engine, a host or an image is missing, out of reach, or has failed
        ├── DiskFull             28   there is no room for what a run writes
        ├── VersionMismatch      29   a node elsewhere runs another version
        ├── HandlerFailed        30   a handler of a node raised an exception: the numbers may be wrong
        ├── ImplausibleCounts    31   a node reports messages that it cannot have sent or handled
        ├── ServiceDied          32   a part of the launcher that serves the nodes has ended
        ├── NodeLost             33   a node was lost in lock-step though nothing in the scenario said so
        └── Interrupted         130   Ctrl-C, SIGTERM or SIGHUP

A usage error on the command line exits with 2, as everywhere.
"""

from __future__ import annotations

import difflib
import errno
from collections.abc import Iterable


class MastError(Exception):
    """Root of all errors this package raises on purpose; `exit_code` is the command line's."""

    exit_code = 1


class ConfigurationError(MastError):
    """A scenario or study is wrong: names the file, the path inside it, what was found and expected."""

    exit_code = 10


class WiringError(ConfigurationError):
    """A key-expression map, a rewrite, or what they resolve to is wrong."""

    exit_code = 11


class NodeFileError(ConfigurationError):
    """A node's file is missing or does not define the node."""

    exit_code = 12


class SceneError(MastError):
    """A scene's data is missing, truncated or inconsistent: names the file, the line and the reason."""

    exit_code = 13


class MessageError(MastError):
    """Bytes that are not a message of the expected schema. Costs one message, never a node."""

    exit_code = 14


class RunFolderError(MastError):
    """A run folder is missing, incomplete or already in use."""

    exit_code = 15


class NotComparable(RunFolderError):
    """Two runs cannot be compared: they play different scenes or lengths, or one has no results. Says in what."""

    exit_code = 17


class CredentialsError(MastError):
    """A certificate or key is missing, expired or refused: names the file or the endpoint, and the reason."""

    exit_code = 16


class RunError(MastError):
    """A run ended badly."""

    exit_code = 20


class StartError(RunError):
    """The nodes did not all come up in time."""

    exit_code = 21


class NodeDied(RunError):
    """A node whose `on_exit` policy is `fail` ended before the run did."""

    exit_code = 22


class StallError(RunError):
    """Lock-step made no progress in time: names what each node still owes."""

    exit_code = 23


class TrialsFailed(RunError):
    """Some trials of a study failed: names each with the command that runs it alone; the others are kept."""

    exit_code = 24


class BackendError(RunError):
    """This machine, or this way of running, cannot carry out a fault: says what lacks, and what to install."""

    exit_code = 25


class NotRunning(RunError):
    """A run that is to be changed does not run any more, plays in one process, or does not answer."""

    exit_code = 26


class EngineError(RunError):
    """An engine, a host or an image is missing, out of reach, or has failed: says which, and what to do."""

    exit_code = 27


class DiskFull(RunError):
    """There is no room for what a run writes: names the place, what is free and what is needed."""

    exit_code = 28


class VersionMismatch(RunError):
    """A node elsewhere runs another version than the launcher: names both."""

    exit_code = 29


class HandlerFailed(RunError):
    """A node's handler raised an exception, so the numbers may be wrong: names node, frames, exception and line."""

    exit_code = 30


class ImplausibleCounts(RunError):
    """A node reports messages that it cannot have sent or handled, so lock-step cannot go by it: names the node."""

    exit_code = 31


class ServiceDied(RunError):
    """A part of the launcher that serves the nodes has ended, so what they ask for or hand in is lost: names it."""

    exit_code = 32


class NodeLost(RunError):
    """A node was lost in lock-step though nothing in the scenario said so: names it and the frame."""

    exit_code = 33


class Interrupted(RunError):
    """The run was stopped by Ctrl-C, SIGTERM or SIGHUP; what was recorded up to then is kept."""

    exit_code = 130


#: No space, no quota left, and a file larger than the process may write.
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def is_disk_full(error: BaseException) -> bool:
    """Whether an error of the operating system says that there is no room for what is written."""
    return isinstance(error, OSError) and error.errno in _NO_ROOM


def nearest(found: str, known: Iterable[str]) -> str:
    """A hint for messages: `; did you mean 'x'?`, or the known names if none is near."""
    names = sorted(known)
    close = difflib.get_close_matches(found, names, n=1, cutoff=0.5)
    if close:
        return f"; did you mean {close[0]!r}?"
    return f"; known: {', '.join(names)}" if names else ""
