"""A detector: finds objects in the points of a lidar, as a process between the sensor and its agent.

It gets the points alone, of simulated and of recorded lidars alike, and never the truth.
"""

from __future__ import annotations

from collections import deque
from typing import Any

from mast_zenoh.arrays.checks import check
from mast_zenoh.mesh.hosting import main
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.sensing import LidarSensor
from mast_zenoh.sensing.free_space import swept
from mast_zenoh.sensing.point_detector import PointDetector, detected_or_nothing, nothing_detected


class DetectorNode(Node):
    """Detects objects in the scans of an agent's lidar, and measures how far each direction is free in them.

    detector:    the algorithm
    agent:       whose lidar it is
    lidar:       that lidar
    late_frames: frames after which it publishes detections, with the time of their scan, as a slow detector does. In
                 lock-step nothing else makes it late; in real time, its own time comes on top.
    """

    role = "detector"
    inputs = {"clock": "clock", "points": "points"}
    outputs = {"detections": "detections", "sweep": "sweep"}

    def __init__(self, detector: PointDetector, agent: str, lidar: LidarSensor, late_frames: int = 0) -> None:
        check("0 or more", late_frames=late_frames)
        self.detector, self.agent, self.lidar, self.late_frames = detector, agent, lidar, late_frames
        self.affects = {"points": {"detections": late_frames, "sweep": 0}}  # type: ignore[misc]  # depends on how it is configured
        self.waiting: deque[tuple[int, dict[str, Any]]] = deque()  # detections: time of the scan, columns
        self.counts = {"scans": 0, "points": 0, "detections": 0}
        self.oldest_ns = 0

    def on_clock(self, received: Received, context: Context) -> None:
        """A frame begins: from now on, `context` tells the time."""

    def on_points(self, received: Received, context: Context) -> None:
        """Detect objects in a scan, and publish those of the scan that is due; free space is never late.

        A detector that fails, which fails the run, detects nothing.
        """
        if context.connected("sweep"):
            free = swept(received.body, self.lidar)
            context.publish("sweep", free, frame=received.frame, time_ns=received.time_ns)
        columns = detected_or_nothing(self.detector, received.body, context.failed)
        self.counts["scans"] += 1
        self.counts["points"] += len(received.body["position"])
        self.counts["detections"] += len(columns["yaw"])
        self.waiting.append((received.time_ns, columns))
        if len(self.waiting) > self.late_frames:
            time_ns, columns = self.waiting.popleft()
        else:  # those of the first scan are not due yet
            time_ns, columns = self.waiting[0][0], nothing_detected(received.body)
        self.oldest_ns = max(self.oldest_ns, context.now_ns + context.elapsed_ns - time_ns)
        context.publish("detections", columns, frame=received.frame, time_ns=time_ns)

    def finish(self, context: Context) -> dict[str, Any]:
        """Numbers of scans, points and detections; s, the greatest age of detections when they were sent.

        In real time this includes the time that the detector takes.
        """
        return {**self.counts, "oldest_s": self.oldest_ns * 1e-9}


if __name__ == "__main__":
    main(DetectorNode)
