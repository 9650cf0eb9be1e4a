"""The options of `mast ros2`, and those of `mast intercept --ros2`. The plugin mast-zenoh-ros2 does what they say."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from mast_zenoh.cli.options import Confirmed, run_argument
from mast_zenoh.config import plugins

#: Where rmw_zenohd listens.
ROUTER = "tcp/127.0.0.1:7447"

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
    shown: dict[str, Any] = {"rate": rate, "loop": loop, "every_frame": every_frame, "run": run}
    plugin().publish(target, config, namespace, **shown, confirmed=confirmed, attached=attached)


def plugin() -> Any:
    """What the commands do; raises PluginError if the plugin, or what it requires, is not installed."""
    plugins.required("mast_ros2.type_store", plugins.ROS2_PLUGIN)
    return plugins.required("mast_ros2.commands", plugins.ROS2_PLUGIN)


def connection_config(
    router: str, domain: int, tls_ca: Path | None, tls_certificate: Path | None, tls_key: Path | None
) -> dict[str, Any]:
    """A connection as a scenario has it."""
    tls = {"ca": tls_ca, "certificate": tls_certificate, "key": tls_key}
    tls = {name: value for name, value in tls.items() if value is not None}
    return {"router": router, "domain": domain, **({"tls": tls} if tls else {})}
