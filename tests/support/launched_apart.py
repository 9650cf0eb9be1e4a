"""An engine with remote nodes simulated as processes without shared files."""

import sys
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.launch.context import Mesh, RunContext
from mast_zenoh.launch.engine import Engine
from mast_zenoh.launch.processes import Processes
from mast_zenoh.mesh.security import levels
from mast_zenoh.mesh.session import open_router


class BesideProcesses(Processes):
    """Processes of mast-node; `code` is executed in each beforehand."""

    def __init__(self, *arguments: Any, code: str = "", patience_s: float = 10.0, **more: Any) -> None:
        super().__init__(*arguments, **more)
        self.code = code
        self.patience_s = patience_s

    def command(self, name: str, spec: NodeSpec) -> list[str]:
        code = f"from mast_zenoh.deploy import remote_node\n{self.code}\nremote_node.main()"
        words = ["--name", name, "--run", self.run, "--endpoint", self.endpoint, "--patience", str(self.patience_s)]
        return [sys.executable, "-c", code, *words, *self.extra_arguments(name), *self.inside(name)]


class Beside(Engine):
    """code: by node, Python executed in its process beforehand."""

    name = "beside"

    def __init__(self, code: Mapping[str, str] | None = None, patience_s: float = 10.0) -> None:
        self.code = "".join(f"if {name!r} in __import__('sys').argv: {line}\n" for name, line in (code or {}).items())
        self.patience_s = patience_s

    def check(self, resolved: Resolved, secure: str) -> None:
        pass

    def join(self, context: RunContext, stack: ExitStack) -> Mesh:
        deployment = stack.enter_context(context.make_deployment(["127.0.0.1"]))
        listen = levels.endpoint(context.secure, "tcp/127.0.0.1:0")
        session, endpoint = open_router(listen, security=deployment.router)
        context.record |= {"endpoint": endpoint, "deployment": {"engine": self.name}}
        processes = BesideProcesses(
            context.folder,
            context.run_id,
            endpoint,
            extra_arguments=deployment.arguments,
            code=self.code,
            patience_s=self.patience_s,
        )
        return Mesh(stack.enter_context(session), processes, deployment)

    @classmethod
    def status(cls, folder: Path, record: dict[str, Any]) -> list[dict[str, str]]:
        return []

    @classmethod
    def logs(cls, folder: Path, record: dict[str, Any], node: str | None, *, follow: bool) -> None:
        pass

    @classmethod
    def down(cls, folder: Path, record: dict[str, Any]) -> None:
        pass
