import json
import sys

import numpy as np
import zenoh

from mast_zenoh.arrays.matching import greedy_matching, neighbours
from mast_zenoh.arrays.states import Detections, ObjectStates
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header

AGENT, ENDPOINT = "infra_1", sys.argv[1]
WORLD = {"origin": np.zeros(3), "rotation": np.array([1.0, 0.0, 0.0, 0.0])}
picture = ObjectStates.empty()


def answer(sample):
    global picture
    schema = str(sample.key_expr).rpartition("/")[2]
    header, columns = codec.decode(sample.payload.to_bytes(), schema)
    if schema == "picture":
        picture = ObjectStates.from_columns(columns)
        return
    if header.frame == 0:  # another run: it is repeated exactly if the program starts anew
        picture = ObjectStates.empty()
    seen = Detections.from_columns(columns)
    row, known, dx, dy = neighbours(seen.position, picture.position, np.full(len(seen), 2.0))
    near = greedy_matching(row, known, np.hypot(dx, dy))
    ids, velocity = 1_000_000 + np.arange(len(seen)), np.zeros((len(seen), 3))
    ids[row[near]], velocity[row[near]] = picture.id[known[near]], picture.velocity[known[near]]
    covariance = np.broadcast_to(0.1 * np.eye(9), (len(seen), 9, 9))
    same = dict(size=seen.size, yaw=seen.yaw, score=seen.score, class_id=seen.class_id)
    tracks = ObjectStates.of(seen.position, id=ids, velocity=velocity, covariance=covariance, **same)
    message = codec.conform(Header("tracks", AGENT, header.frame, header.time_ns, 0), tracks.columns() | WORLD)
    session.put(f"{AGENT}/tracks", codec.encode(message))


config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", json.dumps([ENDPOINT]))
session = zenoh.open(config)
subscriber = session.declare_subscriber(f"{AGENT}/sent/*", answer)
token = session.liveliness().declare_token(f"{AGENT}/tracks")
input("ready\n")  # until Enter is pressed
