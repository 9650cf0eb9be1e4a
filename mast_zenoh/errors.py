"""All errors of this package, as one tree.

Each error that can end a command has its own exit code (docs/ref-exit-codes.md).

    MastError                     1   any error that is not listed below
    ├── ConfigurationError       10   a scenario or study is invalid
    │   ├── WiringError          11   a key-expression map or rewrite is invalid
    │   ├── NodeFileError        12   a node's file is missing or does not define the node
    │   └── PluginError          35   a plugin is missing, cannot be imported, or has a class named like another one
    ├── SceneError               13   a scene's data is missing, truncated or inconsistent, or its code has failed
    ├── MessageError             14   bytes that are not a message of the expected schema
    ├── RunFolderError           15   a run folder is missing, incomplete or already in use
    │   ├── NotComparable        17   two runs cannot be compared
    │   └── UntrustedCode        19   a run folder names code that the user has not confirmed
    ├── CredentialsError         16   a certificate or key is missing, expired or refused
    ├── ExportError              18   a run cannot be written in another format
    └── RunError                 20   a run failed
        ├── StartError           21   a node did not start in time
        ├── NodeDied             22   a node whose `on_exit` policy is `fail` ended before the run
        ├── StallError           23   lock-step made no progress in time
        ├── TrialsFailed         24   some trials of a study failed; the others are kept
        ├── BackendError         25   this machine or runtime cannot carry out a fault
        ├── NotRunning           26   the run to be changed or shown is not running, or what is outside it is not there
        ├── EngineError          27   an engine, a host or an image is missing, unreachable or has failed
        ├── DiskFull             28   there is no space for the files of a run
        ├── VersionMismatch      29   a remote node's version differs from the launcher's
        ├── HandlerFailed        30   a node's handler raised an exception, so the numbers may be wrong
        ├── ImplausibleCounts    31   a node reports impossible message counts
        ├── ServiceDied          32   a service of the launcher has ended
        ├── NodeLost             33   a node was unexpectedly lost in lock-step
        ├── ResourcesExhausted   34   there is too little memory, or too few file descriptors
        └── Interrupted         130   Ctrl-C, SIGTERM or SIGHUP

A usage error on the command line exits with 2, as usual.
"""

from __future__ import annotations

import difflib
import errno
import traceback
from collections.abc import Collection, Iterable


class MastError(Exception):
    """Base of all errors that this package raises."""

    exit_code = 1


class ConfigurationError(MastError):
    """A scenario or study is invalid.

    Names the file, the path inside it, the value found and the value expected.
    """

    exit_code = 10


class WiringError(ConfigurationError):
    """A key-expression map, a rewrite or the resulting wiring is invalid."""

    exit_code = 11


class NodeFileError(ConfigurationError):
    """A node's file is missing or does not define the node."""

    exit_code = 12


class PluginError(ConfigurationError):
    """A plugin is missing, cannot be imported, or has a class named like another one.

    Names the plugin, its distribution and the cause.
    """

    exit_code = 35


class SceneError(MastError):
    """A scene's data is missing, truncated or inconsistent, or its code has failed.

    Names the file, the line and the reason.
    """

    exit_code = 13


class MessageError(MastError):
    """Bytes are not a message of the expected schema.

    The message is dropped; the node continues.
    """

    exit_code = 14


class RunFolderError(MastError):
    """A run folder is missing, incomplete or already in use."""

    exit_code = 15


class NotComparable(RunFolderError):
    """Two runs cannot be compared.

    Names the difference in scene or length, or the run without results.
    """

    exit_code = 17


class UntrustedCode(RunFolderError):
    """A run folder names code, a host or containers that the user has not confirmed.

    Names them; nothing of it was run. `--trust` confirms all.
    """

    exit_code = 19


class CredentialsError(MastError):
    """A certificate or key is missing, expired or refused.

    Names the file or the endpoint, and the reason.
    """

    exit_code = 16


class ExportError(MastError):
    """A run cannot be written in another format.

    Names the missing package, or the file that is in the way.
    """

    exit_code = 18


class RunError(MastError):
    """A run failed."""

    exit_code = 20


class StartError(RunError):
    """At least one node did not start in time."""

    exit_code = 21


class NodeDied(RunError):
    """A node whose `on_exit` policy is `fail` ended before the run."""

    exit_code = 22


class StallError(RunError):
    """Lock-step made no progress in time: names the nodes that it waited for."""

    exit_code = 23


class TrialsFailed(RunError):
    """Some trials of a study failed.

    Names each, with the command that runs it alone. The others are kept.
    """

    exit_code = 24


class BackendError(RunError):
    """This machine or runtime cannot carry out a fault.

    Names what is missing and what to install.
    """

    exit_code = 25


class NotRunning(RunError):
    """The run to be changed or shown is over, in one process, or does not answer; or what is outside it does not."""

    exit_code = 26


class EngineError(RunError):
    """An engine, a host or an image is missing, unreachable or has failed.

    Names it, and what to do.
    """

    exit_code = 27


class DiskFull(RunError):
    """There is no space for the files of a run.

    Names the place, the free and the required space.
    """

    exit_code = 28


class VersionMismatch(RunError):
    """A node has another mast-zenoh than the launcher; names both."""

    exit_code = 29


class HandlerFailed(RunError):
    """A node's handler raised an exception, so the numbers may be wrong.

    Names node, frames, exception and line.
    """

    exit_code = 30


class ImplausibleCounts(RunError):
    """A node reports impossible message counts, so lock-step cannot rely on them.

    Names the node.
    """

    exit_code = 31


class ServiceDied(RunError):
    """A service of the launcher has ended: requests and results of nodes are lost.

    Names the service.
    """

    exit_code = 32


class NodeLost(RunError):
    """A node was lost in lock-step although the scenario did not plan it.

    Names the node and the frame.
    """

    exit_code = 33


class ResourcesExhausted(RunError):
    """There is too little memory, or too few file descriptors.

    Names what is missing, and how much is needed if that is known.
    """

    exit_code = 34


class Interrupted(RunError):
    """The run was stopped by Ctrl-C, SIGTERM or SIGHUP.

    Everything recorded up to then is kept.
    """

    exit_code = 130


#: Out of space, out of quota, and file larger than the process may write.
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def is_disk_full(error: BaseException) -> bool:
    """Whether the operating system reports that there is no space for a file."""
    return isinstance(error, OSError) and error.errno in _NO_ROOM


#: What dynamic linkers and modules say when memory does not suffice for a library.
_NO_MEMORY = ("cannot allocate memory", "failed to map segment", "out of memory", "memoryerror")


def is_out_of_resources(error: BaseException) -> bool:
    """Whether there was too little memory, or too few file descriptors."""
    if isinstance(error, OSError) and error.errno in (errno.ENOMEM, errno.EMFILE, errno.ENFILE):
        return True
    if isinstance(error, ImportError):
        return any(words in str(error).lower() for words in _NO_MEMORY)
    return isinstance(error, MemoryError)


def is_from_outside(error: BaseException) -> bool:
    """Whether an error is not of the code that raised it: a signal, a full disk, or too few resources."""
    return isinstance(error, Interrupted) or is_out_of_resources(error) or is_disk_full(error)


def plural(count: float, noun: str) -> str:
    """`1 seed`, `20 seeds`."""
    return f"{count:.0f} {noun}{'' if count == 1 else 's'}"


def place_of(error: BaseException, modules: Collection[str]) -> str:
    """FILE:LINE of the last call in any of these modules that led to an error; "": none did."""
    trace = traceback.walk_tb(error.__traceback__)
    places = [
        f"{frame.f_code.co_filename}:{line}" for frame, line in trace if frame.f_globals.get("__name__") in modules
    ]
    return places[-1] if places else ""


def nearest(name: str, known: Iterable[str]) -> str:
    """A hint for messages: `; did you mean 'x'?`, or the known names if none is similar."""
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    if close:
        return f"; did you mean {close[0]!r}?"
    return f"; known: {', '.join(names)}" if names else ""
