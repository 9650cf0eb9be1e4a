"""Commands on the folder of a run: report, export, films, logs, interception and replay."""

from __future__ import annotations

import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from mast_zenoh.cli import completion, options, ros2, standard_streams
from mast_zenoh.cli.options import err as _err
from mast_zenoh.cli.options import out as _out
from mast_zenoh.errors import ConfigurationError, ExportError
from mast_zenoh.launch import stop_signals
from mast_zenoh.show.formats import FORMATS, GONE, check

if TYPE_CHECKING:
    from mast_zenoh.show.film.takes import Look


_POLL_S = 0.2  # for new lines of logs

FinishedRun = Annotated[Path, options.run_argument("The folder of a finished run.")]
RunningRun = Annotated[Path, options.run_argument("The folder of a running run.")]

# Options of films and stills
Agent = Annotated[str | None, typer.Option(help="Whose estimates to show. Default: the main agent.")]
Estimates = Annotated[
    list[str] | None,
    typer.Option("--estimate", metavar="NAME", help="Up to two, side by side: local, picture, mission, truth, …"),
]
Beside = Annotated[
    Path | None, typer.Option("--against", metavar="OTHER", help="Another run, beside the first at the same time.")
]
Camera = Annotated[bool, typer.Option("--camera", help="Add the agent's camera view.")]
Window = Annotated[
    str, typer.Option(metavar="fit|follow[:HALF]|X,Y,HALF", help="Which part of the scene; HALF its shorter side, m.")
]
Theme = Annotated[str, typer.Option(metavar="dark|light", help="The ground.")]
Size = Annotated[str | None, typer.Option(metavar="WIDTHxHEIGHT[px|in|cm|mm]", help="Of the image: 1280x720, 18x10cm.")]
Dpi = Annotated[int, typer.Option(help="Pixels per inch; text keeps its size in points.")]
Plain = Annotated[bool, typer.Option("--plain", help="Panels and legend alone: no title, numbers, strips or caption.")]
Title = Annotated[str | None, typer.Option(help="In place of the run's name and the agent's.")]
Captions = Annotated[
    list[str] | None,
    typer.Option("--caption", metavar="FRAME:TEXT", help="A caption from this frame until the next event."),
]


def report(
    run_folder: options.RunPath,
    frame: Annotated[int | None, typer.Option(min=0, help="The frame that figures show.")] = None,
    against: options.Against = None,
    measure: Annotated[bool, typer.Option("--measure", help="Measure the run again, from its recording.")] = False,
    figures: Annotated[list[Path] | None, typer.Option(help="A Python file whose figures are added.")] = None,
    confirmed: options.Confirmed = False,
) -> None:
    """Write the report of a run again, compared with another run if one is named.

    A run without metrics is measured first, if it was recorded.
    """
    from mast_zenoh.launch import measurement
    from mast_zenoh.show import html, terminal

    options.check_reference(against)
    if missing := next((file for file in figures or () if not file.is_file()), None):
        raise ConfigurationError(f"no file {str(missing)!r}: --figures expects a Python file")
    allowed = options.allowed_code(*(figures or ()), confirmed=confirmed)
    if measure or measurement.can_fill_in(run_folder):
        for refused in measurement.measure(run_folder, allowed):
            _err().plain(f"warning: {refused}")
        _out().plain(f"measured: {run_folder / measurement.METRICS}")
    other = None if against is None else options.reference_folder(run_folder, against, allowed)
    with options.reporting(run_folder):
        if other is not None:
            terminal.show_run(_out(), run_folder, other)
        _out().plain(f"report: {html.write_report(run_folder, frame, other, figures or ())}")
    if warning := terminal.failure(run_folder):
        _err().warn(warning)


def _checked_format(name: str) -> str:
    """The name of a format; any other is a usage error, unless it is of one that is gone."""
    try:
        check(name)
    except ExportError as error:
        options.refuse(name not in GONE, str(error), "--to")
        raise
    return name


Format = Annotated[
    str,
    typer.Option(
        metavar="|".join(FORMATS),
        help="The format, see docs/how-to-export.md.",
        autocompletion=completion.formats,
        callback=_checked_format,
    ),
]


def export(
    run_folder: FinishedRun,
    to: Format,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="PATH", help="The new file or folder. Required.")
    ] = None,
) -> None:
    """Write a finished run in another format."""
    from mast_zenoh.run_folder import reading
    from mast_zenoh.runs.recorded import open_recorded
    from mast_zenoh.show import export as formats

    with reading(run_folder):
        if out is None:
            open_recorded(run_folder)  # a wrong folder is named first
            raise typer.BadParameter("missing: expected the new file or folder", param_hint="--out / -o")
        exported = formats.export(run_folder, to, out)
    for path in exported.paths:
        _out().plain(f"exported: {path}")
    for sentence in exported.missing:
        _err().warn(sentence)


def animate(
    run_folder: FinishedRun,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="A new file: .mp4, .gif or .webm.")],
    agent: Agent = None,
    estimates: Estimates = None,
    against: Beside = None,
    camera: Camera = False,
    window: Window = "fit",
    theme: Theme = "dark",
    size: Size = None,
    dpi: Dpi = 100,
    plain: Plain = False,
    title: Title = None,
    captions: Captions = None,
    start: Annotated[int | None, typer.Option("--from", metavar="FRAME", help="The first frame.")] = None,
    end: Annotated[
        int | None, typer.Option("--to", metavar="FRAME", help="The last frame. Default: at most 3000 frames.")
    ] = None,
    speed: Annotated[float, typer.Option(help="Speed over that of the scene.")] = 1.0,
    fps: Annotated[float | None, typer.Option(help="Images per second. Default: every frame, at most 30.")] = None,
) -> None:
    """Write a film of a finished run."""
    from mast_zenoh.run_folder import reading
    from mast_zenoh.show.film import writing  # drawing libraries are slow to load

    look = _look(locals())
    with reading(run_folder):
        images = writing.animate(run_folder, out, look, against, start=start, end=end, speed=speed, fps=fps)
    _out().plain(f"film: {out} ({images} images, {out.stat().st_size / 1e6:.1f} MB)")


def snapshot(
    run_folder: FinishedRun,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="A new file: .pdf, .svg or .png.")],
    frame: Annotated[int | None, typer.Option(help="The frame. Default: the one that the report shows.")] = None,
    agent: Agent = None,
    estimates: Estimates = None,
    against: Beside = None,
    camera: Camera = False,
    window: Window = "fit",
    theme: Theme = "light",
    size: Size = None,
    dpi: Dpi = 100,
    plain: Plain = False,
    title: Title = None,
    captions: Captions = None,
) -> None:
    """Write one frame of a finished run as a figure."""
    from mast_zenoh.run_folder import reading
    from mast_zenoh.show.film import writing

    look = _look(locals())
    with reading(run_folder):
        shown = writing.snapshot(run_folder, out, look, frame, against)
    _out().plain(f"frame {shown}: {out}")


_LOOK = ("agent", "camera", "window", "theme", "size", "dpi", "plain", "title")


def _look(values: Mapping[str, Any]) -> Look:
    """What a film or a still shows, by the options of its command."""
    from mast_zenoh.show.film.takes import Look

    estimates, captions = (tuple(values[name] or ()) for name in ("estimates", "captions"))
    chosen = {name: values[name] for name in _LOOK}
    return Look(estimates=estimates or None, captions=captions, **chosen)


def logs(
    run_folder: options.RunPath,
    node: Annotated[
        str | None,
        typer.Argument(metavar="[NODE]", help="The node. Default: all.", autocompletion=completion.logged_nodes),
    ] = None,
    follow: Annotated[
        bool, typer.Option("--follow", "-f", help="Continue with new lines until the run ends, or Ctrl-C.")
    ] = False,
) -> None:
    """Print the logs of a run's nodes, in the order of time; of all nodes with their names."""
    from mast_zenoh.cli.console import escaped
    from mast_zenoh.launch.log_reading import RunLogs

    run_logs = RunLogs(run_folder, node)
    printed = False
    received: list[int] = []  # no exception: it could come while a line is being written, and repeat it
    with suppress(KeyboardInterrupt), stop_signals.second_interrupts(received):
        running = True
        while running and not received and standard_streams.is_read():
            running = follow and run_logs.running  # asked first: a node may log until the run ends
            for line in run_logs.new_lines(partial=not running):
                prefix = f"{line.node}  " if node is None else ""
                sys.stdout.write(f"{escaped(prefix + line.text)}\n")
                printed = True
                if received:
                    break
            sys.stdout.flush()
            if running and not received:
                threading.Event().wait(_POLL_S)
    if not (printed or run_logs.problems or received):
        sentence = "no node has written to its log" if node is None else f"{node} has not written to its log"
        _err().plain(sentence)
    for log, problem in run_logs.problems.items():
        _err().warn(f"{run_folder / log}: {problem}")


_BETWEEN = "Between two ROS 2 nodes"


def intercept(
    run_folder: Annotated[Path | None, options.run_argument("The folder of a running run.")] = None,
    wire: Annotated[str, typer.Option(help="The wire to intercept: agent/infra_2/tracks.")] = "",
    node: Annotated[
        str,
        typer.Option(
            "--with", metavar="NODE.py|ATTACK", help="A node's file; or an attack: its name, FILE.py or FILE.py:CLASS."
        ),
    ] = "",
    name: Annotated[str | None, typer.Option(help="Name of the new node. Default: its file's, with a number.")] = None,
    before: Annotated[
        str, typer.Option(metavar="NODE", help="The only subscriber before which it comes. Default: all of them.")
    ] = "",
    input: Annotated[str | None, typer.Option(metavar="PORT", help="Its input port for the wire's messages.")] = None,
    output: Annotated[str | None, typer.Option(metavar="PORT", help="Its output port for the wire's messages.")] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="A parameter of the node, or a dotted path.")
    ] = None,
    confirmed: options.Confirmed = False,
    topic: Annotated[
        str,
        typer.Option(
            "--ros2",
            metavar="TOPIC",
            help="Instead of a run: publish TOPIC as the node wants it, from what its publisher, remapped, says on "
            "TOPIC/before.",
            rich_help_panel=_BETWEEN,
        ),
    ] = "",
    type_name: Annotated[
        str,
        typer.Option("--type", help="Of its messages; or vision_msgs/msg/Detection3DArray.", rich_help_panel=_BETWEEN),
    ] = "autoware_perception_msgs/msg/TrackedObjects",
    odometry: Annotated[
        str,
        typer.Option(
            metavar="TOPIC",
            help="Where the publisher is, in the frame of its objects. Default: at the origin.",
            rich_help_panel=_BETWEEN,
        ),
    ] = "",
    launch: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write a launch file that starts another one with the topic remapped.",
            rich_help_panel=_BETWEEN,
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of its random draws.", rich_help_panel=_BETWEEN)] = 0,
    router: ros2.Router = ros2.ROUTER,
    domain: ros2.Domain = 0,
    tls_ca: ros2.TlsCa = None,
    tls_certificate: ros2.TlsCertificate = None,
    tls_key: ros2.TlsKey = None,
) -> None:
    """Insert a node into a wire during a run; no message is lost or duplicated. Or put it between two ROS 2 nodes."""
    options.refuse(not node, "expected a node or an attack", "--with")
    if topic:
        of_runs = {"RUN": run_folder, "--wire": wire, "--name": name, "--before": before, "--input": input}
        given = [option for option, value in {**of_runs, "--output": output}.items() if value]
        options.refuse(given, f"found {', '.join(given)} and --ros2: there is no run between two ROS 2 nodes")
        config = ros2.connection_config(router, domain, tls_ca, tls_certificate, tls_key)
        chosen: dict[str, Any] = {"type_name": type_name, "odometry": odometry, "seed": seed, "launch": launch}
        ros2.plugin().between(topic, node, settings or [], config=config, **chosen)
        return
    options.refuse(run_folder is None or not wire, "expected the folder of a running run and --wire, or --ros2 TOPIC")
    options.refuse(launch or odometry, "--launch and --odometry are for --ros2")
    assert run_folder is not None
    from mast_zenoh.launch import live_interception

    result = live_interception.intercept(
        run_folder,
        wire,
        node,
        name=name,
        before=before,
        input=input,
        output=output,
        settings=settings or (),
        allowed=options.allowed_code(node.partition(":")[0], confirmed=confirmed),
    )
    _show_result(f"{result['node']} is on", result)


def release(
    run_folder: RunningRun,
    name: Annotated[str | None, typer.Option(help="The node to release.")] = None,
    wire: Annotated[
        str | None, typer.Option(help="Instead of a name: the wire whose only inserted node is released.")
    ] = None,
    confirmed: options.Confirmed = False,
) -> None:
    """Release a node from its wires during a run, after its messages are forwarded."""
    from mast_zenoh.launch import live_interception

    options.refuse((name is None) == (wire is None), "expected either --name or --wire", "--name / --wire")
    result = live_interception.release(
        run_folder, name=name, wire=wire, allowed=options.allowed_code(confirmed=confirmed)
    )
    _show_result(f"{result['node']} is off", result)


def _show_result(subject: str, result: dict[str, Any]) -> None:
    wires = ", ".join(result["wires"])
    _out().plain(f"{subject} {wires} from frame {result['frame']} on ({result['took_ms']:.1f} ms)")


def replay(
    run_folder: Annotated[Path, options.run_argument("The folder of a recorded run.")],
    place: Annotated[
        Literal["agents", "simulator"],
        typer.Option("--from", help="Play what the agents sent, or what the simulator sent. All after it is live."),
    ] = "agents",
    scenario: Annotated[
        str | None,
        typer.Option(
            metavar="FILE", help="A scenario file; its broker, command centre, evaluator and agents are live."
        ),
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="A setting of a live node, as a dotted path.")
    ] = None,
    frames: options.Frames = None,
    loop: Annotated[bool, typer.Option("--loop", help="Repeat the recording until Ctrl-C, or --times.")] = False,
    times: Annotated[int | None, typer.Option(min=1, help="How often to play the recording.")] = None,
    runtime: options.Runtime = "mesh",
    mode: options.Mode = None,
    rate: options.Rate = None,
    out: options.Out = None,
    endpoint: options.RouterEndpoint = None,
    secure: options.Secure = "open",
    report: options.Report = True,
    record: options.Record = True,
    allow_failures: options.AllowFailures = False,
    allow_churn: options.AllowChurn = False,
    against: Annotated[
        str | None, typer.Option(metavar="RUN", help="Compare with another run, such as the recorded one.")
    ] = None,
    confirmed: options.Confirmed = False,
) -> None:
    """Play a recorded run to live nodes, such as a changed command centre.

    Lock-step, or real time with --rate. Without changes, a lock-step recording gives the recorded picture.
    """
    from mast_zenoh.launch import replay as replays
    from mast_zenoh.launch import run as launcher

    options.refuse(against == "twin", "a replay has no twin: expected the recorded run, or another one", "--against")
    options.check_reference(against)
    exact = mode == "lockstep" and rate is not None
    options.refuse(exact, "lock-step waits for every node: expected --mode realtime", "--rate")
    chosen = mode or ("lockstep" if rate is None else "realtime")
    options.check_environment(runtime, chosen, secure, endpoint)
    files = [value for _, is_set, value in (item.partition(".file=") for item in settings or ()) if is_set]
    prepared = replays.resolve(
        run_folder,
        place,
        scenario=scenario,
        settings=settings or (),
        frames=frames,
        repeats=times or (None if loop else 1),
        mode=chosen,
        rate=1.0 if rate is None else rate,
        record=record,
        allowed=options.allowed_code(scenario, *files, confirmed=confirmed),
    )
    for line in prepared.lines():
        _out().plain(line)
    for notice in prepared.notices:
        _err().warn(notice)
    environment: dict[str, Any] = {"runtime": runtime, "endpoint": endpoint, "secure": secure}
    allowed: dict[str, Any] = {"allow_failures": allow_failures, "allow_churn": allow_churn}
    finished = launcher.run(prepared.resolved, out, **environment, **allowed, console=_out(), replay=prepared.record())
    options.conclude(finished, report=report, against=against, allow_failures=allow_failures)
