"""What a scenario says of ROS 2: the part `ros2`, the parameter of that name, and the bridge.

How to reach a router of rmw_zenoh, as scenarios and commands say it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Self

from mast_ros2.liveliness_tokens import check_domain, ros2_name
from mast_zenoh.config.outside_meshes import OutsideMesh
from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.errors import ConfigurationError, nearest

#: Where rmw_zenohd listens.
ROUTER = "tcp/127.0.0.1:7447"

_ENDPOINT = re.compile(r"(tcp|tls|udp|quic|ws)/[^\s/?#]+:[0-9]{1,5}")


@dataclass(frozen=True, slots=True)
class Tls:
    """The certificates of a router that demands TLS, as PEM files.

    ca:   of the authority that has signed the router's certificate
    certificate, key: of this side, for a router that demands one; None: none
    """

    ca: Path
    certificate: Path | None = None
    key: Path | None = None


@dataclass(frozen=True, slots=True)
class Connection:
    """A router of rmw_zenoh, and the domain in which to take part there.

    router: its endpoint;  domain: ROS_DOMAIN_ID;  tls: None: the router demands no TLS
    """

    router: str = ROUTER
    domain: int = 0
    tls: Tls | None = None

    @classmethod
    def of(cls, config: Any, place: str) -> Self:
        """From the part of a scenario that says `ros2`.

        config: a dict of `router`, `domain` and `tls`, each optional; `tls` is one of `ca`, `certificate` and `key`
        place:  where that part is, for errors

        Raises ConfigurationError for other keys and values, and for files that do not exist.
        """
        given = _dict(config, [field.name for field in fields(cls)], place)
        router, domain = given.get("router", ROUTER), given.get("domain", 0)
        if not isinstance(router, str) or not _ENDPOINT.fullmatch(router):
            raise ConfigurationError(f"{place}.router: found {router!r:.120}, expected a form such as {ROUTER!r}")
        if type(domain) is not int:
            raise ConfigurationError(f"{place}.domain: found {domain!r:.120}, expected a whole number, ROS_DOMAIN_ID")
        try:
            check_domain(domain)
        except ValueError as error:
            raise ConfigurationError(f"{place}.{error}") from None
        tls = None if given.get("tls") is None else _tls(given["tls"], f"{place}.tls")
        if (tls is not None) != router.startswith(("tls/", "quic/")):
            expected = "certificates in `tls` for it" if tls is None else "tls/HOST:PORT, because there is `tls`"
            raise ConfigurationError(f"{place}.router: found {router!r}, expected {expected}")
        return cls(router, domain, tls)

    def to_json(self) -> dict[str, Any]:
        """A dict from which `of` makes it again, wherever that is: files have absolute paths."""
        tls = None if self.tls is None else {key: str(path) for key, path in asdict(self.tls).items() if path}
        return {"router": self.router, "domain": self.domain, **({"tls": tls} if tls else {})}


def connection_of_scenario(config: Any, place: str) -> Connection:
    """The connection in the part `ros2` of a scenario, which is also that of its nodes of ROS 2.

    config: a dict of the keys of a connection and of one more, each optional
    every_frame: whether in lock-step the bridge sends all frames, and not only as many as cost the run nothing

    Raises ConfigurationError as `Connection.of` does.
    """
    known = [*(field.name for field in fields(Connection)), "every_frame"]
    given = dict(_dict(config, known, place))
    every_frame = given.pop("every_frame", False)
    if type(every_frame) is not bool:
        raise ConfigurationError(f"{place}.every_frame: found {every_frame!r:.120}, expected True or False")
    return Connection.of(given, place)


def _tls(config: Any, place: str) -> Tls:
    given = _dict(config, [field.name for field in fields(Tls)], place)
    files: dict[str, Path] = {}
    for name, value in given.items():
        if value is None:
            continue
        if not isinstance(value, (str, Path)) or not Path(value).is_file():
            raise ConfigurationError(f"{place}.{name}: found {str(value)!r:.300}, expected a file (PEM)")
        files[name] = Path(value).resolve()
    if "ca" not in files:
        raise ConfigurationError(f"{place}: found no `ca`, expected the certificate of the router's authority")
    if ("certificate" in files) != ("key" in files):
        raise ConfigurationError(f"{place}: found one of `certificate` and `key`, expected both or neither")
    return Tls(**files)


def _dict(config: Any, known: list[str], place: str) -> Mapping[str, Any]:
    if not isinstance(config, Mapping):
        raise ConfigurationError(f"{place}: found {config!r:.120}, expected a dict of {', '.join(known)}")
    for name in config:
        if name not in known:
            raise ConfigurationError(f"{place}: {name!r:.80}: unknown key{nearest(str(name), known)}")
    return config


_CLOCK = "/clock"


class Ros2Mesh(OutsideMesh):
    """A router of rmw_zenoh, see `connection_of_scenario`."""

    key = "ros2"
    no_bridge = "ros2: no bridge: a single process has no mesh to observe; `mast ros2 RUN` plays the finished run"

    @staticmethod
    def parameter(config: Any, place: str) -> Mapping[str, Any]:
        """The connection of nodes that name none."""
        return connection_of_scenario(config, place).to_json()

    @staticmethod
    def prepare(path: Path, nodes: Mapping[str, NodeSpec], partners: Mapping[str, NodeSpec]) -> None:
        """Check that ROS 2 can tell the names of all nodes apart, and have one node send the clock.

        The first that can: of two, one may be behind, and the clock goes back.
        """
        from mast_zenoh.scenario.nodes import takes  # which the processes of nodes do not need

        names: dict[str, str] = {}
        for name in nodes:
            if (other := names.setdefault(ros2_name(name), name)) != name:
                raise ConfigurationError(
                    f"{path}: {name} and {other}: both are {ros2_name(name)} in ROS 2, which allows letters, digits "
                    "and _: rename one"
                )
        topic = _CLOCK
        for spec in partners.values():
            if takes(spec, "clock"):
                topic = "" if spec.config.setdefault("clock", topic) else topic

    @staticmethod
    def bridge(config: Any) -> AbstractContextManager[Callable[[Any], None]]:
        """A process that publishes a run, if the scenario has `ros2`."""
        from mast_ros2.commands import bridge_process

        return bridge_process(config)
