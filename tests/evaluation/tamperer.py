"""An adversary for tests: random manipulations of messages, no reports."""

import numpy as np

from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Message
from mast_zenoh.node import Context, Node, Received


class Tamperer(Node):
    """agent: whose wires it is on; rate: probability of each manipulation."""

    role = "adversary"
    inputs = {"clock": "clock", "detections": "detections", "tracks": "tracks", "picture": "picture"}
    outputs = {f"{name}_out": name for name in ("detections", "tracks", "picture")}

    def __init__(self, agent: str, rate: float = 0.12) -> None:
        self.agent = agent
        self.rate = rate

    def on_clock(self, received: Received, context: Context) -> None:
        """Begin a frame."""

    def on_detections(self, received: Received, context: Context) -> None:
        self.tamper(received, context)

    def on_tracks(self, received: Received, context: Context) -> None:
        self.tamper(received, context)

    def on_picture(self, received: Received, context: Context) -> None:
        self.tamper(received, context)

    def tamper(self, received: Received, context: Context) -> None:
        """Manipulate one message."""
        header = received.message.header
        port = f"{header.schema}_out"
        rng = context.rng(header.schema, header.frame, header.seq, context.frame)
        what = rng.permutation(
            ["drop", "repeat", "again", "delay", "restamp", "rubbish", "damage", "forge", "reframe", "speak", "crash"]
        )
        what = {str(name) for name in what[rng.random(len(what)) < self.rate][:2]}
        body = changed(received.body, rng, self.rate, context.frame) if rng.random() < 0.7 else None
        if "crash" in what:
            raise RuntimeError("the handler fails before anything is sent on")
        if "rubbish" in what:
            context.relay(port, received, payload=bytes(rng.integers(0, 256, 40, np.uint8)))
        if "speak" in what:
            context.publish(port, received.body)
        if "forge" in what:
            other = header._replace(seq=header.seq + 1000)
            context.relay(port, received, payload=codec.encode(Message(other, received.body)))
        if "damage" in what:
            context.relay(port, received, payload=codec.encode(received.message)[:-3])
            return
        if "drop" in what:
            return
        if "reframe" in what and "origin" in received.body:
            body = {**(body or received.body), "origin": received.body["origin"] + np.array([1.0, 2.0, 0.0])}
        time_ns = header.time_ns + int(rng.integers(1, 10**8)) if "restamp" in what else None
        after_s = float(rng.choice([0.04, 0.1, 0.25])) if "delay" in what else 0.0
        for _ in range(2 if "repeat" in what else 1):
            context.relay(port, received, body, time_ns=time_ns, after_s=after_s)
        if "again" in what:
            context.relay(port, received, changed(received.body, rng, 1.0, context.frame), after_s=after_s)


def changed(body, rng: np.random.Generator, rate: float, frame: int):
    """The columns with rows removed, moved, altered, inserted and shuffled."""
    n = len(body["position"])
    names = [name for name, column in body.items() if column.shape[:1] == (n,) and name not in ("origin", "rotation")]
    names = [name for name in names if not name.startswith("mount")]
    rows = {name: body[name].copy() for name in names}
    moved = rng.random(n) < rate
    rows["position"][moved] += rng.normal(0.0, 4.0, (moved.sum(), 3))
    scored = ~moved & (rng.random(n) < rate)
    rows["score"][scored] *= 0.5
    replaced = ~moved & ~scored & (rng.random(n) < rate)
    rows["position"][replaced] += rng.normal(0.0, 0.3, (replaced.sum(), 3))
    rows["size"][replaced] *= 1.1
    if "id" in rows:
        renamed = ~moved & ~scored & ~replaced & (rng.random(n) < rate)
        rows["id"][renamed] += 5000
    keep = rng.random(n) >= rate
    rows = {name: column[keep] for name, column in rows.items()}
    if n and keep.any():
        fakes = int(rng.poisson(0.7))
        for k in range(fakes):
            fake = {name: column[:1].copy() for name, column in rows.items()}
            fake["position"] = fake["position"] + rng.normal(0.0, 1.0, (1, 3)) + np.array([200.0 + 40.0 * k, 0.0, 0.0])
            fake["size"] = rng.uniform(1.0, 9.0, (1, 3))
            if "id" in fake:
                fake["id"] = np.array([100_000 + 100 * frame + k])
            rows = {name: np.concatenate([column, fake[name]]) for name, column in rows.items()}
    order = rng.permutation(len(rows["position"]))
    return {**body, **{name: column[order] for name, column in rows.items()}}
