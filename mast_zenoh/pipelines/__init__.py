"""Complete pipelines of an agent and of the command centre."""

from mast_zenoh.pipelines.agent import AgentPipeline, AgentSensor, Pose
from mast_zenoh.pipelines.command_center import CommandCenterPipeline, Pipeline
from mast_zenoh.pipelines.mission import FreeSpaceVeto, MissionEstimator, OwnAndPicture, PictureFirst

__all__ = [
    "AgentPipeline",
    "AgentSensor",
    "CommandCenterPipeline",
    "FreeSpaceVeto",
    "MissionEstimator",
    "OwnAndPicture",
    "PictureFirst",
    "Pipeline",
    "Pose",
]
