import json
from collections import Counter
from functools import partial

import zenoh
from agent import WORLD, Agent

from mast_zenoh.arrays.geometry import states_to_local
from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.errors import MessageError, NotRunning
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header
from mast_zenoh.outside import OutsideTally, OutsideTopic, OutsideTopics

MOUNT = {"mount_position": WORLD["origin"], "mount_rotation": WORLD["rotation"]}  # the sensor frame is the world's


class ZenohSession:
    """A session with programs that listen at an endpoint of Zenoh. Topics are keys, messages are bytes."""

    def __init__(self, endpoint, node):
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        try:
            self.session = zenoh.open(config)
        except zenoh.ZError as error:
            raise NotRunning(f"{endpoint}: {error}: expected the program of {node}, start it first") from None
        self.refused, self.alive, self.declared, self.publishers = Counter(), set(), [], {}

    def announce(self, topic, type_name):
        self.publishers[topic] = self.session.declare_publisher(topic)

    def send(self, topic, message):
        self.publishers[topic].put(message)

    def heard(self, topic):
        return bool(self.publishers[topic].matching_status.matching)

    def receive(self, topic, keep):
        def on_sample(sample):
            if len(sample.payload) > topic.most_bytes:
                self.refused["size"] += 1
            else:
                keep(sample.payload.to_bytes(), b"")

        def on_token(sample):  # the program has one while it publishes on the topic
            (self.alive.add if sample.kind == zenoh.SampleKind.PUT else self.alive.discard)(topic.name)

        self.declared.append(self.session.declare_subscriber(topic.name, on_sample))
        tokens = self.session.liveliness()
        self.declared.append(tokens.declare_subscriber(topic.name, on_token, history=True))

    def is_published(self, topic):
        return topic in self.alive

    def absence(self, topic):
        return "" if self.is_published(topic) else "no program has a token for it"

    def close(self):
        self.session.close()


class ZenohAgent(Agent):
    """An agent whose tracks a program outside the run makes.

    endpoint: of the program;  wait_s: s, how long a frame waits for its tracks in lock-step
    others: the parameters of `Agent`
    """

    def __init__(self, endpoint: str, wait_s: float = 1.0, **others):
        super().__init__(**others)
        self.endpoint, self.wait_s = endpoint, wait_s
        self.unanswered = set()  # frames

    def outside_topics(self, context):
        self.sent, self.answers = f"{context.name}/sent", f"{context.name}/tracks"
        self.tally = OutsideTally([self.answers])
        return OutsideTopics(partial(ZenohSession, self.endpoint), (OutsideTopic(self.answers),))

    def start(self, context):
        super().start(context)
        for schema in ("picture", "detections"):
            context.outside.announce(f"{self.sent}/{schema}", schema)
        context.outside.wait(10.0, lambda: context.outside.present(self.answers))

    def send(self, schema, frame, time_ns, columns, context):
        message = codec.conform(Header(schema, context.name, frame, time_ns, 0), columns)
        context.outside.send(f"{self.sent}/{schema}", codec.encode(message))

    def on_picture(self, received, context):
        super().on_picture(received, context)
        self.send("picture", received.frame, received.time_ns, received.body, context)

    def estimate(self, perceived, context):
        frame, outside, found = perceived.frame, context.outside, []
        self.unanswered.add(frame)
        self.tally.counts["asked"] += 1
        self.send("detections", frame, perceived.time_ns, perceived.detections().columns() | MOUNT, context)

        def answered():
            for arrival in outside.take():
                self.tally.note_publisher(arrival)
                try:
                    header, columns = codec.decode(arrival.message, "tracks")
                    if header.frame not in self.unanswered:
                        raise MessageError("no question: not asked, or answered already")
                except MessageError as error:
                    self.tally.refuse(error)
                    continue
                self.unanswered.remove(header.frame)
                self.tally.note_answer(arrival.topic, header.frame, late=header.frame != frame)
                if header.frame == frame:
                    found.append(ObjectStates.from_columns(columns))
            return bool(found)

        if not outside.wait(self.wait_s if outside.waits else 0.0, answered, [self.answers]):
            self.tally.note_missing(outside, [self.answers], frame)
        world = found[0] if found else ObjectStates.empty()
        tracks = states_to_local(world, *self.pipeline.reference(perceived.pose))
        self.publish_tracks(perceived, tracks, context)
        self.publish_mission(perceived, tracks, context)

    def finish(self, context):
        return {"outside": self.tally.results(context.outside)}
