"""What `mast ros2` and `mast intercept --ros2` do, and the bridge that a scenario names.

The options of these commands are in `mast_zenoh.cli.ros2`.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from mast_ros2.mesh import ROUTER, Connection
from mast_zenoh.cli import observers
from mast_zenoh.cli.observers import LAST_LINE, print_line
from mast_zenoh.cli.options import allowed_code, refuse
from mast_zenoh.cli.options import err as _err
from mast_zenoh.errors import ConfigurationError, HandlerFailed
from mast_zenoh.run_folder import reading

if TYPE_CHECKING:
    from mast_ros2.bridge import Ros2Bridge
    from mast_ros2.participant import Participant
    from mast_zenoh.config.loading import AllowedCode
    from mast_zenoh.launch.context import RunContext
    from mast_zenoh.runs.frame import Frame

_READY_S = 60.0  # for a bridge to be ready, for which a run waits
_LAST_FRAMES_S = 20.0  # for a bridge to send the rest of a run that has ended
_INTERRUPTED_S = 2.0  # for a bridge to end after an interrupt


def publish(
    target: str,
    config: Mapping[str, Any],
    namespace: str,
    *,
    rate: float,
    loop: bool,
    every_frame: bool,
    run: str,
    confirmed: bool,
    attached: bool,
) -> None:
    """Publish a run in ROS 2, while it is running or afterwards; Ctrl-C ends the bridge, never the run.

    config: the connection, as a scenario has it;  attached: whether this is the process that observes a running run
    others: the options of `mast ros2`
    """
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
    config: Mapping[str, Any],
) -> None:
    """Put a node or an attack between two ROS 2 nodes until Ctrl-C, see `mast_ros2.interception`.

    launch: a new file for the launch file that remaps the publisher;  config: the connection, as a scenario has it

    Raises HandlerFailed at the end if the node has failed.
    """
    from mast_ros2.interception import BEFORE, check_interception, intercept_topic, interposer_of, launch_fragment
    from mast_zenoh.run_folder import write_new

    connection = Connection.of(config, "ros2")
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
        connection, topic, type_name, interposer, threading.Event(), odometry=odometry, ready=ready, warn=_err().warn
    )
    print_line("")
    print_line(f"messages: {counts['messages']}, changed: {counts['changed']}, published: {counts['published']}")
    for reason, number in counts["unattacked"].items():
        _err().warn(f"{number} messages were passed on unchanged: {reason}")
    for reason, number in counts["refused"].items():
        _err().warn(f"{number} messages were refused: {reason}")
    if counts["failed"]:
        raise HandlerFailed(f"{counts['failed']}: it was on {topic}, and what it failed on was passed on as it was")


def _words(config: Mapping[str, Any]) -> list[str]:
    """A connection as options of this command."""
    words = {"router": config.get("router", ROUTER), "domain": config.get("domain", 0)}
    words |= {f"tls-{name}": value for name, value in (config.get("tls") or {}).items() if value is not None}
    return [f"--{name}={value}" for name, value in words.items()]


def _play(folder: Path, connection: Connection, namespace: str, *, rate: float, loop: bool) -> None:
    """Publish a finished run until its end, or Ctrl-C."""
    from mast_ros2.bridge import Ros2Bridge, played
    from mast_zenoh.runs.recorded import open_recorded

    with reading(folder):
        run = open_recorded(folder)
    frames = played(run, rate=rate, loop=loop)
    with _participant(connection, namespace) as participant:
        _publish(Ros2Bridge(run, participant, namespace), frames, lambda: run.files.missing)


def _observe(
    target: str, run: str, allowed: AllowedCode, connection: Connection, namespace: str, *, every_frame: bool
) -> None:
    """Publish a running run until its end, or until standard input ends."""
    from mast_ros2.bridge import Ros2Bridge, frames_to_the_end
    from mast_zenoh.runs.live import priority
    from mast_zenoh.runs.live.observer import Observer

    with ExitStack() as stack:
        participant = stack.enter_context(_participant(connection, namespace))
        running, session, stop = observers.join(stack, target, run, allowed)
        nodes = running.resolved.nodes
        partners = {name: spec.config for name, spec in nodes.items() if "ros2" in spec.config}
        lockstep = running.resolved.mode == "lockstep"
        every = every_frame or not lockstep
        observer = Observer(running, session, every=every)
        stack.callback(observer.close)
        bridge = Ros2Bridge(observer.run, participant, namespace, partners)
        if every:
            # In real time the run waits for nobody, and on a busy machine a process of low priority would lose frames.
            restore = priority.yield_to_nodes() if lockstep else lambda: None
            stack.callback(restore)
            frames = observer.frames(stop, restore, lambda: bridge.shows_outcomes)
            _publish(bridge, frames, lambda: [*observer.tally.sentences(), *observer.meter.notes])
        else:
            restore = priority.yield_processors()
            stack.callback(restore)
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
    from mast_ros2.layouts import write_layouts

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
        _err().warn(sentence)


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
            _err().warn(f"the bridge to ROS 2 has not sent the last frames within {_LAST_FRAMES_S:g} s")
            observers.end(process)
        except KeyboardInterrupt:
            self.interrupt()
            raise
        else:
            if process.returncode and not self._interrupted:
                _err().warn(f"the bridge to ROS 2 has ended with exit code {process.returncode}{self._since()}")
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
    _err().warn(f"the bridge to ROS 2 was not ready within {_READY_S:g} s: it lacks the first frames")


@contextmanager
def _participant(connection: Connection, namespace: str) -> Iterator[Participant]:
    """The bridge's node, which is named; what it lacks is loaded first."""
    from mast_ros2.bridge import NODE
    from mast_ros2.participant import Participant

    try:
        participant = Participant(connection, NODE, namespace)
    except ValueError as error:
        raise ConfigurationError(f"ros2: {error}") from None
    with participant:
        print_line(f"ros2: {namespace.rstrip('/')}/{NODE} on {connection.router}, domain {connection.domain}")
        yield participant
