import sys
import threading

from mast_ros2.type_store import DETECTIONS, STORE, type_hash
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber, ZenohSession

where = dict(router_ip=sys.argv[1], router_port=int(sys.argv[2]))
session = ZenohSession.get_instance(**where)
session.store, session._registered_types = STORE, {name: name for name in STORE.types}  # asks no server for them


def answer(message):
    near = [each for each in message.detections if abs(each.bbox.center.position.x) < 20.0]
    publisher.publish(header=message.header, detections=near)


kind = dict(type_hash=type_hash(DETECTIONS), **where)
publisher = ROS2Publisher("/mast/infra_1/received_detections", DETECTIONS, **kind)
subscriber = ROS2Subscriber("/mast/infra_1/detections", DETECTIONS, answer, **kind)
threading.Event().wait()
