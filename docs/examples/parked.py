import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_yaw_pitch
from mast_zenoh.arrays.states import CLASS_INDEX, ObjectStates
from mast_zenoh.scenario import load
from mast_zenoh.scenes import Recording, Scene, SceneAgent
from mast_zenoh.scenes.making.observe import World, detect, lidar_visibility, make_recording
from mast_zenoh.sensing import Camera, CleanDetector, Detector, LidarSensor

DETECTOR = CleanDetector()


class Parked(Scene):
    """The ego drives past parked cars at 10 m/s. A pole watches.

    n_cars:   parked cars, 8 m apart
    detector: generates the detections
    """

    def __init__(self, *, n_cars: int = 4, detector: Detector = DETECTOR) -> None:
        self.n_cars = n_cars
        self.detector = detector

    def record(self, seed: int, frames: int | None) -> Recording:
        frames = frames or 60
        n = 1 + self.n_cars  # the ego is object 0
        time_s = 0.1 * np.arange(frames)
        position = np.zeros((frames, n, 3))
        position[:, 0, 0] = 10.0 * time_s
        position[:, 1:, 0] = 10.0 + 8.0 * np.arange(self.n_cars)
        position[:, 1:, 1] = 4.0
        position[:, :, 2] = 0.8
        velocity = np.zeros((frames, n, 3))
        velocity[:, 0, 0] = 10.0
        truth = ObjectStates.of(
            position.reshape(-1, 3),
            id=np.tile(np.arange(n), frames),
            velocity=velocity.reshape(-1, 3),
            size=np.tile([4.5, 1.8, 1.6], (frames * n, 1)),
            class_id=np.full(frames * n, CLASS_INDEX["car"], np.uint8),
        )
        ego = SceneAgent("ego", "mobile", 0, LidarSensor(), Camera())
        pole = SceneAgent("infra_1", "static", -1, LidarSensor.infrastructure(), Camera())
        agent_position = np.zeros((frames, 2, 3))
        agent_position[:, 0, 0] = position[:, 0, 0]
        agent_position[:, 1] = 20.0, -15.0, 15.0
        agent_rotation = np.tile(np.eye(3), (frames, 2, 1, 1))
        agent_rotation[:, 1] = rotation_from_yaw_pitch(np.pi / 2, np.radians(30.0))
        agent_velocity = np.zeros((frames, 2, 3))
        agent_velocity[:, 0] = velocity[:, 0]
        world = World(
            name="parked",
            agents=(ego, pole),
            period_ns=100_000_000,
            times_ns=np.arange(frames) * 100_000_000,
            truth=truth,
            truth_start=np.arange(frames + 1) * n,
            agent_position=agent_position,
            agent_rotation=agent_rotation,
            agent_velocity=agent_velocity,
        )
        points = lidar_visibility(world)
        return make_recording(world, points, *detect(world, points, self.detector, seed))


def scenario(n_cars=4):
    _, base = load("baseline")
    return base | dict(name="parked", scene=dict(type="Parked", n_cars=n_cars))
