import shutil
import sys

from mast_zenoh.errors import EngineError
from mast_zenoh.launch.context import Mesh
from mast_zenoh.launch.engine import Engine
from mast_zenoh.launch.processes import Processes
from mast_zenoh.mesh.security import levels
from mast_zenoh.mesh.session import open_router


class NodeProcesses(Processes):
    """Processes of mast-node."""

    def command(self, name, spec):
        words = ["--run", self.run, "--name", name, "--endpoint", self.endpoint, "--patience", "10"]
        node = [sys.executable, "-m", "mast_zenoh.deploy.remote_node", *words, *self.extra_arguments(name)]
        return [*self.inside(name), *node]


class Polite(Engine):
    """Processes of this machine that leave the processor to others.

    niceness: 0 to 19, how low their priority is
    """

    def __init__(self, *, niceness: int = 5) -> None:
        if not 0 <= niceness <= 19:
            raise ValueError(f"niceness: found {niceness}, expected 0 to 19")
        self.niceness = niceness

    def check(self, resolved, secure):
        if shutil.which("nice") is None:
            raise EngineError("there is no `nice` on this machine: install coreutils")

    def join(self, context, stack):
        deployment = stack.enter_context(context.make_deployment(["127.0.0.1"]))
        listen = levels.endpoint(context.secure, "tcp/127.0.0.1:0")
        session, endpoint = open_router(listen, security=deployment.router)
        stack.enter_context(session)
        context.record |= {"endpoint": endpoint, "deployment": {"engine": self.name}}
        supervisor = NodeProcesses(
            context.folder,
            context.run_id,
            endpoint,
            inside=lambda name: ["nice", "-n", str(self.niceness)],
            extra_arguments=deployment.arguments,
        )
        return Mesh(session, supervisor, deployment)

    @classmethod
    def status(cls, folder, record):
        exits = {name: node["exit"] for name, node in record["nodes"].items()}
        states = {name: "running" if code is None else f"exited with {code}" for name, code in exits.items()}
        return [dict(node=name, state=state, where="this machine") for name, state in states.items()]

    @classmethod
    def logs(cls, folder, record, node, *, follow):
        for file in sorted((folder / "logs").glob(f"{node or '*'}.log")):
            print(file.read_text(), end="")

    @classmethod
    def down(cls, folder, record):
        """Do nothing: the nodes leave by themselves 10 s after the launcher has gone."""
