"""ROS 2 for mast-zenoh, without an installation of ROS: a plugin.

The first two groups are functions of their arguments alone: bytes, names and arrays in, the same out. The third has
state: what nodes of a run have asked nodes of ROS 2, and what they wait for. Only the fourth opens sessions.

Keys, tokens and bytes of rmw_zenoh:

liveliness_tokens keys of rmw_zenoh: names, topics, quality of service, and tokens that make nodes known
attachments       sequence number, time and publisher of a message
type_store        classes of all message types, also those that rosbags lacks; CDR bytes and hashes

Messages from our columns, and back:

spatial           times, headers, poses, covariances; TFMessage, Odometry, Clock
object_messages   objects as arrays of vision_msgs and Autoware, and as markers; their ids
received_objects  Detection3DArray, DetectedObjects and TrackedObjects as our objects
received_poses    Odometry and TFMessage as our poses; where frames of reference are in the world
altered_objects   messages of objects some of which an interposer has altered

Nodes of a run that exchange messages with nodes of ROS 2:

frame_exchange    questions about frames and their answers: stamps, waiting, counts
node_exchanges    what agents, command centres and adversaries send, and what comes back

Programs, sessions and files:

mesh              what a scenario says of ROS 2, and how to reach a router
participant       a node of ROS 2 on a router of rmw_zenoh
nodes/            the nodes of a run, which scenarios name by their files
run_messages      the topics of a run and the messages of its frames, trust too; a bag, for `mast export`
bridge            publishes the frames of a run
layouts           layouts of the bridge's topics for RViz and Foxglove
interception      an adversary between two nodes of ROS 2
commands          what `mast ros2` and `mast intercept --ros2` do
"""

from mast_ros2.mesh import Ros2Mesh

__all__ = ["Ros2Mesh"]
