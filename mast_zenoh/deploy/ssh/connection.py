"""SSH connections to hosts: programs, files, readable errors; and installing packages: this one, and others.

    FOLDER/environments/KEY/      a virtual environment with the wheels of third parties, once per set of versions
    FOLDER/releases/KEY/          this package, as it is here
    FOLDER/runs/RUN/HOST/         a run's supervisor, while it lasts

The launcher sends the wheels: a host needs no index, no pip and no compiler, and all hosts have the same versions. The
event loop runs in its own thread.

The launcher's connections to wardens: one that stays, and single commands.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import hashlib
import itertools
import json
import os
import secrets
import shlex
import signal
import threading
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import asyncssh

from mast_zenoh import version as release
from mast_zenoh.deploy import wheel
from mast_zenoh.deploy.ssh import onhost
from mast_zenoh.deploy.ssh.hostsfile import SshHost
from mast_zenoh.deploy.ssh.warden import NOT_THERE
from mast_zenoh.errors import DiskFull, EngineError, Interrupted, VersionMismatch

T = TypeVar("T")

#: Disk space for an environment (250 MB were measured), a release, and the files of a run.
_NEEDED_BYTES = {"environment": 400 << 20, "release": 16 << 20, "run": 64 << 20}

_OLDEST = (3, 11)

_CONNECT_S = 10.0
_LOGIN_S = 30.0
_PROGRAM_S = 300.0
_KEEPALIVE_S = 3.0  # after three without an answer the connection is lost
_POLL_S = 0.05


class Loop:
    """An event loop in a thread, and waiting for its tasks; a context manager.

    signals: the signals received so far; another one ends the waiting
    """

    def __init__(self, signals: Sequence[int] = ()) -> None:
        self._signals = signals
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="ssh", daemon=True)

    def __enter__(self) -> Loop:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        asyncio.run_coroutine_threadsafe(self._cancel_all(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _cancel_all(self) -> None:
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

    def begin(self, coroutine: Coroutine[Any, Any, T]) -> concurrent.futures.Future[T]:
        """Start a coroutine; cancelling the future cancels it."""
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop)

    def run(self, coroutine: Coroutine[Any, Any, T], *, whole: bool = False) -> T:
        """Run a coroutine and wait for it; raises Interrupted if a signal arrives.

        whole: after a signal, wait until the coroutine has finished
        """
        n_signals, future = len(self._signals), self.begin(coroutine)
        while True:
            with contextlib.suppress(concurrent.futures.TimeoutError):
                return future.result(_POLL_S)
            if future.done():
                return future.result()  # its own TimeoutError
            if len(self._signals) > n_signals:
                if whole:
                    future.result()
                future.cancel()
                raise Interrupted("stopped by Ctrl-C or SIGTERM")


async def together(*coroutines: Coroutine[Any, Any, T]) -> list[T]:
    """Run all concurrently; the first error is raised after all have finished."""
    results = await asyncio.gather(*coroutines, return_exceptions=True)
    for result in results:
        if isinstance(result, BaseException):
            raise result
    return [result for result in results if not isinstance(result, BaseException)]


@contextlib.asynccontextmanager
async def connected(host: SshHost) -> AsyncIterator[asyncssh.SSHClientConnection]:
    """Open a connection to a host with a known key; raises EngineError on failure."""
    known_hosts = Path(host.known_hosts).expanduser()
    key = Path(host.key).expanduser() if host.key else None
    for what, file in (("known_hosts", known_hosts), ("key", key)):
        if file is not None and not os.access(file, os.R_OK):
            raise EngineError(f"{host.called}: {what}: {file} is missing or cannot be read")
    options: dict[str, Any] = {"client_keys": [str(key)], "agent_path": None} if key else {}
    options |= {"username": host.user} if host.user else {}
    try:
        connection = await asyncssh.connect(
            host.address,
            host.port,
            known_hosts=str(known_hosts),
            config=None,
            preferred_auth="publickey",
            connect_timeout=_CONNECT_S,
            login_timeout=_LOGIN_S,
            keepalive_interval=_KEEPALIVE_S,
            keepalive_count_max=3,
            **options,
        )
    except (asyncssh.Error, OSError, ValueError, TimeoutError) as error:
        raise EngineError(f"{host.called}: {_why(error, known_hosts, key)}") from None
    try:
        yield connection
    finally:
        connection.abort()


def _why(error: BaseException, known_hosts: Path, key: Path | None) -> str:
    if isinstance(error, asyncssh.HostKeyNotVerifiable):
        return (
            f"its host key is not the one in {known_hosts} ({error.reason}): the host is new, or another one answers; "
            "compare its fingerprint (ssh-keygen -lf on the host), then add the output of ssh-keyscan"
        )
    if isinstance(error, asyncssh.PermissionDenied):
        return f"refuses our login with {key or 'any key of the agent or of ~/.ssh'}: add the key to authorized_keys"
    if isinstance(error, (asyncssh.KeyImportError, asyncssh.KeyEncryptionError)):
        return f"key: {key}: {error}; load a key with a passphrase into the SSH agent"
    if isinstance(error, TimeoutError):
        return f"out of reach: no answer within {_CONNECT_S:.0f} s"
    return f"out of reach: {getattr(error, 'strerror', None) or error or type(error).__name__}"


async def run(
    ssh: asyncssh.SSHClientConnection,
    host: SshHost,
    words: Sequence[str],
    input_: str = "",
    seconds: float = _PROGRAM_S,
) -> str:
    """Run a program on the host; returns its output, raises EngineError if it fails."""
    try:
        done = await ssh.run(shlex.join(words), input=input_, timeout=seconds, errors="replace")
    except (asyncssh.Error, OSError) as error:
        raise EngineError(f"{host.called}: {words[0]}: {error or type(error).__name__}") from None
    if done.exit_status == 127:
        raise EngineError(f"{host.called}: there is no {words[0]}: install it, or name another in hosts.toml (python)")
    if done.exit_status:
        lines = str(done.stderr).strip().splitlines() or [f"exit code {done.exit_status}"]
        raise EngineError(f"{host.called}: {lines[-1]}")
    return str(done.stdout)


async def messages_of(process: asyncssh.SSHClientProcess[str]) -> AsyncIterator[dict[str, Any]]:
    """The lines of JSON that a process writes, without a truncated last one."""
    async for line in process.stdout:
        if line.endswith("\n"):
            yield json.loads(line)


async def ask(ssh: asyncssh.SSHClientConnection, host: SshHost, *words: str) -> dict[str, Any]:
    """Run `onhost` on the host; returns its answer. Raises EngineError."""
    output = await run(ssh, host, [host.python, "-", *words], Path(onhost.__file__).read_text(encoding="utf-8"))
    try:
        answer: dict[str, Any] = json.loads(output.strip().rpartition("\n")[2])
    except ValueError:
        raise EngineError(f"{host.called}: {host.python} printed {output.strip()[-200:]!r}, expected JSON") from None
    return answer


async def make_folder(sftp: asyncssh.SFTPClient, path: str) -> None:
    """Make a folder that only its owner may enter."""
    await sftp.mkdir(path, asyncssh.SFTPAttrs(permissions=0o700))


async def write_file(sftp: asyncssh.SFTPClient, path: str, content: bytes) -> None:
    """Write a new file that only its owner can ever read."""
    async with sftp.open(path, "xb", asyncssh.SFTPAttrs(permissions=0o600)) as file:
        await file.write(content)


# -- packages ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Installed:
    """Absolute paths on a host; python: the environment's."""

    folder: str
    python: str
    release: str


class Packages:
    """The packages to install: wheels of ours and of plugins, built into a folder, and the others' names."""

    def __init__(self, folder: Path) -> None:
        self.version = release.version_string()  # of the sources in the wheel
        self.wheels = [wheel.build(folder), *wheel.build_plugins(folder)]
        self.release = hashlib.sha256(b"".join(path.read_bytes() for path in self.wheels)).hexdigest()[:12]
        self._requirements = wheel.requirements()

    def environment(self, python: str, machine: str) -> str:
        """The name of the environment for a host of this interpreter and processor."""
        digest = hashlib.sha256("\n".join(self._requirements).encode()).hexdigest()[:12]
        return f"{python}-{machine}-{digest}"


async def probe(ssh: asyncssh.SSHClientConnection, host: SshHost, packages: Packages) -> dict[str, Any]:
    """Properties and installed packages of a host.

    Raises EngineError, DiskFull or VersionMismatch if it is unsuitable.
    """
    output = await run(ssh, host, [host.python, "-c", _PRINT_PLATFORM])
    python, machine = output.split()
    if tuple(map(int, python.split("."))) < _OLDEST:
        oldest = ".".join(map(str, _OLDEST))
        raise EngineError(f"{host.called}: {host.python} is Python {python}, expected {oldest} or newer (python)")
    environment = packages.environment(python, machine)
    facts = await ask(ssh, host, "probe", host.folder, environment, packages.release)
    if facts["system"] != "Linux":
        raise EngineError(f"{host.called}: runs {facts['system']}, expected Linux")
    if facts["refused"]:
        raise EngineError(f"{host.called}: {facts['folder']}: {facts['refused']} (folder)")
    missing = [kind for kind in ("environment", "release") if not facts[kind]]
    needed = sum(_NEEDED_BYTES[kind] for kind in (*missing, "run"))
    if facts["free"] < needed:
        raise DiskFull(f"{host.called}: {facts['folder']} has {_mib(facts['free'])} free, needs {_mib(needed)}")
    if not missing:
        _compare(host, packages, facts["version"], facts["folder"])
    return {**facts, "python": python, "key": environment, "lacks": missing}


async def install(ssh: asyncssh.SSHClientConnection, host: SshHost, packages: Packages) -> Installed:
    """Install missing packages; raises what `probe` raises."""
    facts = await probe(ssh, host, packages)
    folder = facts["folder"]
    environment = f"{folder}/environments/{facts['key']}"
    target = f"{folder}/releases/{packages.release}"
    if "environment" in facts["lacks"]:
        wheels = wheel.third_party(
            wheel.cache(facts["python"], facts["machine"]), python=facts["python"], machine=facts["machine"]
        )
        await _copy_and_unpack(ssh, host, wheels, environment, venv=True)
    if "release" in facts["lacks"]:
        await _copy_and_unpack(ssh, host, packages.wheels, target, venv=False)
    if facts["lacks"]:
        answer = await ask(ssh, host, "verify", environment, target)
        _compare(host, packages, answer["version"], folder)
    return Installed(folder, f"{environment}/bin/python", target)


async def _copy_and_unpack(
    ssh: asyncssh.SSHClientConnection, host: SshHost, wheels: list[Path], target: str, *, venv: bool
) -> None:
    new = f"{target}.{secrets.token_hex(4)}"
    try:
        async with ssh.start_sftp_client() as sftp:
            await make_folder(sftp, new)  # otherwise its wheels could be replaced
            await sftp.put([str(path) for path in wheels], new)
        await ask(ssh, host, "unpack", new, target, "1" if venv else "0")
    except (asyncssh.Error, OSError) as error:
        await run(ssh, host, ["rm", "-rf", new])
        raise EngineError(f"{host.called}: {target}: {error}") from None


def _compare(host: SshHost, packages: Packages, remote: str, folder: str) -> None:
    if remote != packages.version:
        raise VersionMismatch(
            f"{host.called}: its copy is mast-zenoh {remote}, the launcher {packages.version}: remove {folder} there"
        )


def _mib(count: int) -> str:
    return f"{count >> 20} MiB"


_PRINT_PLATFORM = "import platform, sys; print('%d.%d' % sys.version_info[:2], platform.machine())"


LEAVE_S = 20.0  #: for a host to end what it still runs and to remove its folder

_ALIVE_EVERY_S = 2.0
_AGAIN_S = 0.5
_NOT_STARTED = 127  # as from a shell


def attaching(place: Mapping[str, Any]) -> str:
    """The command that attaches to a warden; place: the host's entry in run.json."""
    words = [place["python"], "-m", "mast_zenoh.deploy.ssh.warden", place["run_folder"]]
    return shlex.join(["env", f"PYTHONPATH={place['release']}", *words])


async def ask_warden(host: SshHost, place: Mapping[str, Any], do: str, **more: Any) -> dict[str, Any] | None:
    """The warden's answer; None without a warden or installation. Raises EngineError."""
    answer: dict[str, Any] | None = None
    try:
        async with connected(host) as ssh, ssh.create_process(attaching(place)) as process:
            process.stdin.write(json.dumps({"id": os.urandom(8).hex(), "do": do, **more}) + "\n")
            async with asyncio.timeout(LEAVE_S):
                async for message in messages_of(process):
                    answer = message if "answer" in message else answer
                    if answer and do != "leave":  # a leaving warden ends the connection itself, at its end
                        break
                else:
                    await process.wait()
                    if process.exit_status is None:
                        raise EngineError(f"{host.called}: the connection was lost")
            return answer
    except (asyncssh.Error, OSError, TimeoutError) as error:
        raise EngineError(f"{host.called}: {error or type(error).__name__}") from None


class WardenAttachment:
    """The launcher's view of one warden. Commands are repeated until it has answered; a lost connection is restored.

    command: the command from `attaching`
    changed: notified after every change of the known state; shared by all hosts of a run
    on_log:  called with new output of a process: name, offset in its log, bytes
    reattached: number of reconnections; trouble: why it is not attached, if known
    attached: whether there is a connection now; gone: there is no warden
    """

    def __init__(
        self, host: SshHost, command: str, changed: threading.Condition, on_log: Callable[[str, int, bytes], None]
    ) -> None:
        self.host = host
        self.states: dict[str, dict[str, Any]] = {}
        self.attached = self.gone = False
        self.reattached = -1
        self.trouble = ""
        self._command = command
        self._changed = changed
        self._on_log = on_log
        self._offsets: dict[str, int] = {}
        self._ids = map("{}-{}".format, itertools.repeat(secrets.token_hex(4)), itertools.count())
        self._unanswered: dict[str, dict[str, Any]] = {}
        self._answers: dict[str, dict[str, Any]] = {}
        self._wake = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._last = ""

    # From the launcher's thread:

    def tell(self, do: str, **more: Any) -> str:
        """Queue a command for the warden; returns the command's id."""
        with self._changed:
            command_id = next(self._ids)
            self._unanswered[command_id] = {"id": command_id, "do": do, **more}
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._wake.set)
        return command_id

    def answer(self, command_id: str, seconds: float) -> dict[str, Any] | None:
        """The answer to a command; None after `seconds`, or if the warden is gone."""
        with self._changed:
            self._changed.wait_for(lambda: command_id in self._answers or self.gone, max(0.0, seconds))
            return self._answers.get(command_id)

    def leave(self, grace_s: float) -> None:
        """Command the warden to end all nodes, remove its folder, and exit."""
        self._last = self.tell("leave", grace_s=grace_s)

    def has_left(self, seconds: float) -> bool:
        """Wait until the warden is gone; False after `seconds`."""
        with self._changed:
            return self._changed.wait_for(lambda: self.gone, max(0.0, seconds))

    def state(self, name: str, start: str) -> dict[str, Any] | None:
        """The known state of a process, if the command with the id `start` has started it."""
        with self._changed:
            state = self.states.get(name)
            if state is not None and state["start"] == start:
                return state
            answer = self._answers.get(start)
        if answer is None:
            return None
        return {"pid": answer.get("pid"), "exit": _NOT_STARTED if "error" in answer else None}

    def exit(self, name: str, start: str) -> int | None:
        """Exit code of a process; killed if the host has lost its warden."""
        state = self.state(name, start)
        if state is not None and state["exit"] is not None:
            return int(state["exit"])
        return -int(signal.SIGKILL) if self.gone else None

    # In the event loop:

    async def stay(self) -> None:
        """Keep the connection until it is cancelled or the warden is gone."""
        self._loop = asyncio.get_running_loop()
        while not self.gone:
            try:
                async with connected(self.host) as ssh, ssh.create_process(self._command) as process:
                    await self._attend(process)
            except (EngineError, OSError, asyncssh.Error) as error:
                self.trouble = str(error)
            with self._changed:
                self.attached = False
                self._changed.notify_all()
            await asyncio.sleep(_AGAIN_S)

    async def _attend(self, process: Any) -> None:
        def send(*messages: dict[str, Any]) -> None:
            process.stdin.write("".join(json.dumps(message) + "\n" for message in messages))

        with self._changed:
            pending = dict(self._unanswered)
        send({"as": "launcher", "logs": self._offsets}, *pending.values())
        sending = asyncio.create_task(self._send(send, set(pending)))
        try:
            async for message in messages_of(process):
                self._take(message)
            done = await process.wait(timeout=_AGAIN_S)
            if done.exit_status == NOT_THERE or self._last in self._answers:
                with self._changed:
                    self.gone = True
                    self._changed.notify_all()
        except (asyncssh.Error, OSError, TimeoutError):
            pass
        finally:
            sending.cancel()

    async def _send(self, send: Callable[..., None], sent: set[str]) -> None:
        while True:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._wake.wait(), _ALIVE_EVERY_S)
            self._wake.clear()
            with self._changed:
                pending = {id_: command for id_, command in self._unanswered.items() if id_ not in sent}
            sent |= pending.keys()
            send(*pending.values(), {"do": "alive"})

    def _take(self, message: dict[str, Any]) -> None:
        if "log" in message:
            piece = message["text"].encode("latin-1")
            if message["offset"] == self._offsets.get(message["log"], 0):
                self._offsets[message["log"]] = message["offset"] + len(piece)
                self._on_log(message["log"], message["offset"], piece)
        with self._changed:
            if not self.attached:
                self.attached = True
                self.reattached += 1
            if "node" in message:
                self.states[message["node"]] = message
            if "answer" in message:
                self._unanswered.pop(message["answer"], None)
                self._answers[message["answer"]] = message
            self._changed.notify_all()
