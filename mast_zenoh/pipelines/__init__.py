"""Complete pipelines of an agent and of the command centre."""

from mast_zenoh.pipelines.agent import AgentPipeline, MissionEstimator, OwnAndPicture, PictureFirst, Pose
from mast_zenoh.pipelines.command_center import CommandCenterPipeline, Pipeline
from mast_zenoh.pipelines.veto import FreeSpaceVeto

__all__ = [
    "AgentPipeline",
    "CommandCenterPipeline",
    "FreeSpaceVeto",
    "MissionEstimator",
    "OwnAndPicture",
    "PictureFirst",
    "Pipeline",
    "Pose",
]
