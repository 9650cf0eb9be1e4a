"""Complete pipelines of an agent and of the command centre."""

from mast_zenoh.fusion.pipelines.agent import AgentPipeline, OwnSensor, Pose
from mast_zenoh.fusion.pipelines.command_center import CommandCenterPipeline, Pipeline
from mast_zenoh.fusion.pipelines.mission import FreeSpaceVeto, MissionEstimator, OwnAndPicture, PictureFirst

__all__ = [
    "AgentPipeline",
    "CommandCenterPipeline",
    "FreeSpaceVeto",
    "MissionEstimator",
    "OwnAndPicture",
    "OwnSensor",
    "PictureFirst",
    "Pipeline",
    "Pose",
]
