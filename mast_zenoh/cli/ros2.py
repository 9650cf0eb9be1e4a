"""`mast ros2`: the bridge that publishes a run, running or finished, in ROS 2; also the one that a scenario names."""

from __future__ import annotations

import os
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mast_zenoh.cli import observers
from mast_zenoh.cli.observers import LAST_LINE, print_line
from mast_zenoh.cli.options import Confirmed, allowed_code, refuse, run_argument
from mast_zenoh.cli.options import err as _err
from mast_zenoh.errors import ConfigurationError, HandlerFailed
from mast_zenoh.ros2.connection import ROUTER, Connection
from mast_zenoh.run_folder import reading

if TYPE_CHECKING:
    from mast_zenoh.config.allowed_code import AllowedCode
    from mast_zenoh.launch.context import RunContext
    from mast_zenoh.runs.frame import Frame
    from mast_zenoh.runtime.mesh.ros2_participant import Participant
    from mast_zenoh.viewer.ros2_bridge import Ros2Bridge

_READY_S = 60.0  # for a bridge to be ready, for which a run waits
_LAST_FRAMES_S = 20.0  # for a bridge to send the rest of a run that has ended
_INTERRUPTED_S = 2.0  # for a bridge to end after an interrupt


Router = Annotated[str, typer.Option(metavar="ENDPOINT", help="The router of rmw_zenoh.")]
Domain = Annotated[int, typer.Option(help="ROS_DOMAIN_ID.")]
TlsCa = Annotated[
    Path | None, typer.Option("--tls-ca", help="The router demands TLS: certificate of its authority, PEM.")
]
TlsCertificate = Annotated[
    Path | None, typer.Option("--tls-certificate", help="The own certificate, if the router demands one.")
]
TlsKey = Annotated[Path | None, typer.Option("--tls-key", help="The key of that certificate.")]


def ros2(
    target: Annotated[str, run_argument("The folder of a run, finished or running; or its router, tcp/HOST:PORT.")],
    router: Router = ROUTER,
    domain: Domain = 0,
    namespace: Annotated[str, typer.Option(help="Before the topics of objects and odometry.")] = "/",
    tls_ca: TlsCa = None,
    tls_certificate: TlsCertificate = None,
    tls_key: TlsKey = None,
    rate: Annotated[float, typer.Option(min=0.01, max=100.0, help="Finished run: s of the scene per s.")] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="Finished run: begin again at the end.")] = False,
    every_frame: Annotated[
        bool,
        typer.Option(
            "--every-frame",
            help="Running run in lock-step: send all frames, not only as many as cost the run nothing. It then waits "
            "for copies of all messages, and shares its processors with the bridge.",
        ),
    ] = False,
    run: Annotated[str, typer.Option(metavar="ID", help="Which run of the router, if there are several.")] = "",
    confirmed: Confirmed = False,
    attached: Annotated[bool, typer.Option("--attached", hidden=True)] = False,
) -> None:
    """Publish a run in ROS 2, while it is running or afterwards: objects, markers, poses, transforms, clock.

    Nothing of ROS needs to be installed here, but a router of rmw_zenoh must be running. Ctrl-C ends the bridge, never
    the run.
    """
    config = connection_config(router, domain, tls_ca, tls_certificate, tls_key)
    connection = Connection.of(config, "ros2")
    if attached:
        _observe(target, run, allowed_code(confirmed=confirmed), connection, namespace, every_frame=every_frame)
        return
    shown = observers.target_of(target, run)
    refuse(
        shown.running and (rate != 1.0 or loop), "found a running run, expected a finished one for --rate and --loop"
    )
    refuse(not shown.running and every_frame, "--every-frame is for running runs: of a finished one, all are sent")
    if shown.running:
        words = [*_words(config), f"--namespace={namespace}", *([f"--run={run}"] if run else [])]
        words += [word for word, is_set in (("--every-frame", every_frame), ("--trust", confirmed)) if is_set]
        raise typer.Exit(observers.observe_apart("ros2", shown, allowed_code(confirmed=confirmed), words))
    _play(shown.folder, connection, namespace, rate=rate, loop=loop)


def between(
    topic: str,
    file: str,
    settings: list[str],
    *,
    type_name: str,
    odometry: str,
    seed: int,
    launch: Path | None,
    connection: Connection,
) -> None:
    """Put a node or an attack between two ROS 2 nodes until Ctrl-C, see `mast_zenoh.launch.ros2_interception`.

    launch: a new file for the launch file that remaps the publisher

    Raises HandlerFailed at the end if the node has failed.
    """
    from mast_zenoh.run_folder import write_new

    with bridge_modules():
        from mast_zenoh.launch.ros2_interception import (
            BEFORE,
            check_interception,
            intercept_topic,
            interposer_of,
            launch_fragment,
        )
    check_interception(topic, type_name, odometry)
    interposer = interposer_of(file, topic, settings, seed)
    if launch is not None:
        write_new(launch, lambda path: path.write_text(launch_fragment(topic), encoding="utf-8"))
        print_line(f"publisher: ros2 launch {launch} file:=ITS_LAUNCH_FILE")
    print_line(f"publisher: ros2 run PACKAGE NODE --ros-args -r {topic}:={topic}{BEFORE}")

    def ready() -> None:
        print_line(f"{file} is between {topic}{BEFORE} and {topic} on {connection.router}, domain {connection.domain}")
        print_line(LAST_LINE)

    counts = intercept_topic(
        connection, topic, type_name, interposer, threading.Event(), odometry=odometry, ready=ready, warn=_err.warn
    )
    print_line("")
    print_line(f"messages: {counts['messages']}, changed: {counts['changed']}, published: {counts['published']}")
    for reason, number in counts["unattacked"].items():
        _err.warn(f"{number} messages were passed on unchanged: {reason}")
    for reason, number in counts["refused"].items():
        _err.warn(f"{number} messages were refused: {reason}")
    if counts["failed"]:
        raise HandlerFailed(f"{counts['failed']}: it was on {topic}, and what it failed on was passed on as it was")


def connection_config(
    router: str, domain: int, tls_ca: Path | None, tls_certificate: Path | None, tls_key: Path | None
) -> dict[str, Any]:
    """A connection as a scenario has it."""
    tls = {"ca": tls_ca, "certificate": tls_certificate, "key": tls_key}
    tls = {name: value for name, value in tls.items() if value is not None}
    return {"router": router, "domain": domain, **({"tls": tls} if tls else {})}


def _words(config: Mapping[str, Any]) -> list[str]:
    """A connection as options of this command."""
    words = {"router": config.get("router", ROUTER), "domain": config.get("domain", 0)}
    words |= {f"tls-{name}": value for name, value in (config.get("tls") or {}).items() if value is not None}
    return [f"--{name}={value}" for name, value in words.items()]


def _play(folder: Path, connection: Connection, namespace: str, *, rate: float, loop: bool) -> None:
    """Publish a finished run until its end, or Ctrl-C."""
    with bridge_modules():
        from mast_zenoh.runs.recorded import open_recorded
        from mast_zenoh.viewer.ros2_bridge import Ros2Bridge, played

    with reading(folder):
        run = open_recorded(folder)
    frames = played(run, rate=rate, loop=loop)
    with _participant(connection, namespace) as participant:
        _publish(Ros2Bridge(run, participant, namespace), frames, lambda: run.files.missing)


def _observe(
    target: str, run: str, allowed: AllowedCode, connection: Connection, namespace: str, *, every_frame: bool
) -> None:
    """Publish a running run until its end, or until standard input ends."""
    with bridge_modules():
        from mast_zenoh.runs.live import priority
        from mast_zenoh.runs.live.every_frame import EveryFrame
        from mast_zenoh.runs.live.observer import Observer
        from mast_zenoh.viewer.ros2_bridge import Ros2Bridge, frames_to_the_end

    with ExitStack() as stack:
        participant = stack.enter_context(_participant(connection, namespace))
        running, session, stop = observers.join(stack, target, run, allowed)
        nodes = running.resolved.nodes
        partners = {name: spec.config for name, spec in nodes.items() if "ros2" in spec.config}
        if every_frame or running.resolved.mode == "realtime":
            every = EveryFrame(running, session)
            stack.callback(every.close)
            # In real time the run waits for nobody, and on a busy machine a process of low priority would lose frames.
            restore = priority.yield_to_nodes() if running.resolved.mode == "lockstep" else lambda: None
            stack.callback(restore)
            bridge = Ros2Bridge(every.observer.run, participant, namespace, partners)
            frames = every.frames(stop, lambda: bridge.shows_outcomes, restore)
            _publish(bridge, frames, lambda: [*every.tally.sentences(), *every.observer.meter.notes])
        else:
            observer = Observer(running, session)
            stack.callback(observer.close)
            restore = priority.yield_processors()
            stack.callback(restore)
            bridge = Ros2Bridge(observer.run, participant, namespace, partners)
            frames = frames_to_the_end(bridge, observer, stop, restore)
            _publish(bridge, frames, lambda: observer.meter.notes, lambda: max(observer.frame, bridge.newest) + 1)


def _publish(
    bridge: Ros2Bridge,
    frames: Iterator[Frame],
    sentences: Callable[[], Iterable[str]],
    played: Callable[[], int] | None = None,
) -> None:
    """Publish frames, and say what is missing.

    sentences: about the frames;  played: number of frames that the run had up to now, if only some of them are sent
    """
    from mast_zenoh.viewer.export.ros2_layouts import write_layouts

    with _folder_of_process() as folder:
        layouts = write_layouts(bridge.messages, folder)
        print_line(f"rviz: {layouts.rviz}")
        print_line(f"foxglove: {layouts.foxglove}")
        print_line(LAST_LINE)
        try:
            for frame in frames:
                bridge.publish(frame)
        except KeyboardInterrupt:
            print_line("")
    number = f"{bridge.sent} of {played()}" if played is not None else str(bridge.sent)
    reason = ": in lock-step as many as cost the run nothing; every_frame sends all" if played is not None else ""
    print_line(f"sent: {number} frames{reason}")
    for sentence in (*sentences(), *bridge.sentences()):
        _err.warn(sentence)


@contextmanager
def _folder_of_process() -> Iterator[Path]:
    """A temporary folder that is there as long as this process, also if that is killed."""
    folder = tempfile.mkdtemp(prefix="mast-ros2-")
    # Whatever ends this process closes the pipe.
    command = ["/bin/sh", "-c", 'cat >/dev/null; rm -rf -- "$0"', folder]
    quiet = subprocess.DEVNULL
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=quiet, stderr=quiet, cwd="/", start_new_session=True):
        yield Path(folder)


class _BridgeProcess:
    """A bridge that was started with a run. ready: set when it receives the run, or has ended"""

    def __init__(self, process: subprocess.Popen[bytes], context: RunContext) -> None:
        self.ready = threading.Event()
        self._process = process
        self._context = context
        self._last_frame = -1  # of the run, when the bridge ended
        self._interrupted = False
        self._reader = threading.Thread(target=self._relay, daemon=True)
        self._reader.start()

    def interrupt(self) -> None:
        """Have it end at once; kill it if it does not."""
        self._interrupted = True
        observers.end(self._process, _INTERRUPTED_S)

    def finish(self) -> None:
        """Wait until it has sent the last frames; an interrupt ends it at once, a second one kills it."""
        from mast_zenoh.runs.live import priority

        process, signals = self._process, self._context.signals
        if process.poll() is None:  # the run is over, so nothing of it waits for a processor
            priority.restore(process.pid, os.getpriority(os.PRIO_PROCESS, 0))
        try:
            if signals:
                if len(signals) > 1:
                    process.kill()
                self.interrupt()
            process.wait(_LAST_FRAMES_S)
        except subprocess.TimeoutExpired:
            _err.warn(f"the bridge to ROS 2 has not sent the last frames within {_LAST_FRAMES_S:g} s")
            observers.end(process)
        except KeyboardInterrupt:
            self.interrupt()
            raise
        else:
            if process.returncode and not self._interrupted:
                _err.warn(f"the bridge to ROS 2 has ended with exit code {process.returncode}{self._since()}")
        finally:
            self._reader.join()

    def _since(self) -> str:
        """What the run had of the bridge when that ended."""
        frame, frames = self._last_frame, self._context.resolved.frames
        return ": the run had none" if frame < 0 else f" at frame {frame} of {frames}: the run had none from then on"

    def _relay(self) -> None:
        """Print what it prints."""
        for line in self._process.stdout or ():
            if line.startswith(LAST_LINE.encode()):
                self.ready.set()
            else:
                print_line(line.decode().rstrip())
        self._last_frame = self._context.frame
        self.ready.set()


@contextmanager
def bridge_process(config: Mapping[str, Any] | None) -> Iterator[Callable[[RunContext], None]]:
    """Yield a callback that starts a bridge process for a run on a mesh, if its scenario has `ros2`.

    The run begins when the bridge receives it. The context waits until the bridge has sent the last frames.
    """
    bridges: list[_BridgeProcess] = []

    def prepare(context: RunContext) -> None:
        if config is None:
            return
        context.viewer = True
        # --trust: this process's own run
        words = [*_words(config), "--trust", *(["--every-frame"] if config.get("every_frame") else [])]
        process = observers.start("ros2", str(context.folder), *words, stdout=subprocess.PIPE)
        bridge = _BridgeProcess(process, context)
        bridges.append(bridge)
        context.awaited.append(lambda: _wait_for(bridge.ready, context))

    try:
        yield prepare
    except KeyboardInterrupt:  # after the run
        for bridge in bridges:
            bridge.interrupt()
        raise
    finally:
        for bridge in bridges:
            bridge.finish()


def _wait_for(ready: threading.Event, context: RunContext) -> None:
    """Wait until a bridge receives the run, has failed or takes too long, or a signal ends the run."""
    for _ in range(round(10 * _READY_S)):
        if ready.wait(0.1) or context.signals:
            return
    _err.warn(f"the bridge to ROS 2 was not ready within {_READY_S:g} s: it lacks the first frames")


@contextmanager
def _participant(connection: Connection, namespace: str) -> Iterator[Participant]:
    """The bridge's node, which is named; what it lacks is loaded first."""
    with bridge_modules():
        from mast_zenoh.runtime.mesh.ros2_participant import Participant
        from mast_zenoh.viewer.ros2_bridge import NODE
    try:
        participant = Participant(connection, NODE, namespace)
    except ValueError as error:
        raise ConfigurationError(f"ros2: {error}") from None
    with participant:
        print_line(f"ros2: {namespace.rstrip('/')}/{NODE} on {connection.router}, domain {connection.domain}")
        yield participant


@contextmanager
def bridge_modules() -> Iterator[None]:
    """Raise ExportError if an import in this context fails because the extra `ros2` is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        from mast_zenoh.viewer.export import not_installed

        raise not_installed(error, "ros2") from None
