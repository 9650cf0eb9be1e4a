"""The base of nodes that fuse the tracks of many agents: command centre, regional centre and peer."""

from __future__ import annotations

from typing import Any

from mast_zenoh.fusion.pipelines.command_center import Pipeline
from mast_zenoh.integrity.views import check_view
from mast_zenoh.messages.schemas import Body, text
from mast_zenoh.node import Context, Node, Received


def is_view(received: Received, context: Context) -> bool:
    """Whether a message describes a field of view; rejects any other."""
    try:
        check_view(received.body)
    except ValueError as error:
        context.reject(f"implausible: view: {error}")
        return False
    return True


class FusingNode(Node):
    """Publishes the pictures of a pipeline, which never goes back in time, and its trust in agents and objects."""

    fuses = ("picture", "trust")
    pipeline: Pipeline
    newest_ns = 0  # time of the pipeline's last step

    def start(self, context: Context) -> None:
        """Give the pipeline its random streams."""
        self.pipeline.bind(context.seed, context.name)

    def advances(self, time_ns: int, context: Context, subject: str, least: str = "{}") -> bool:
        """Whether a time is not before that of the last step, and is from now on; rejects an older message.

        subject: what has the time; least: what is expected, with a place for the last step's time
        """
        if time_ns < self.newest_ns:
            context.reject(f"old: {subject}: time_ns is {time_ns}, expected {least.format(self.newest_ns)}")
            return False
        self.newest_ns = time_ns
        return True

    def publish_trust(self, frame: int, time_ns: int, context: Context) -> Body | None:
        """Publish the trust of the pipeline's last step; returns it. None: the pipeline judges nobody."""
        trust = self.pipeline.trust
        if trust is None:
            return None
        body = {**trust, **{name: text(list(trust[name])) for name in ("agents", "reason")}}
        context.publish("trust", body, frame=frame, time_ns=time_ns)
        return body

    def finish(self, context: Context) -> dict[str, Any]:
        """What the pipeline counted, and how far tracks were from what its tracker expected, if they tell."""
        return self.pipeline.results()
