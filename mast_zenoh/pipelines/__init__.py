"""Complete pipelines of an agent and of the command centre."""

from mast_zenoh.pipelines.agent import AgentPipeline, Pose
from mast_zenoh.pipelines.agent_sensor import AgentSensor
from mast_zenoh.pipelines.command_center import CommandCenterPipeline, Pipeline
from mast_zenoh.pipelines.mission import MissionEstimator, OwnAndPicture, PictureFirst
from mast_zenoh.pipelines.veto import FreeSpaceVeto

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
