"""ROS 2 for mast-zenoh, without an installation of ROS: a plugin.

The first two groups are functions of their arguments alone: bytes, names and arrays in, the same out. The third has
state: what nodes of a run have asked nodes of ROS 2, and what they wait for. Only the fourth opens sessions.

Keys, tokens and bytes of rmw_zenoh:

connection        how to reach a router, as scenarios say it, and what they say of the bridge
names             names of topics, nodes and types, and how keys write them
data_keys         the key expression of a topic's messages
qos               quality of service in tokens
liveliness_tokens tokens that make nodes, publishers and subscriptions known
attachments       sequence number, time and publisher of a message
definitions       message types that rosbags does not have: vision_msgs and autoware_perception_msgs
type_store        classes of all message types, their CDR bytes and hashes

Messages from our columns, and back:

spatial           parts of messages: times, headers, poses, covariances
object_ids        ids of objects: our whole numbers, and texts and UUIDs
object_messages   objects as Detection3DArray, TrackedObjects and PredictedObjects
object_markers    objects as a MarkerArray, for RViz
pose_messages     poses as TFMessage and Odometry; times as Clock
trust_messages    trust as a DiagnosticArray
received_objects  Detection3DArray, DetectedObjects and TrackedObjects as our objects
received_poses    Odometry and TFMessage as our poses
altered_objects   messages of objects some of which an interposer has altered

Nodes of a run that exchange messages with nodes of ROS 2:

frame_transforms  where frames of reference are in the world, from /tf and /tf_static
frame_exchange    questions about frames and their answers: stamps, waiting, counts
agent_exchange    what an agent sends, and its tracks, detections or pose that come back
center_exchange   what a command centre sends, and the picture that comes back
adversary_exchange what an adversary sends, and what it forwards instead

Programs, sessions and files:

mesh              what a scenario says of ROS 2
participant       a node of ROS 2 on a router of rmw_zenoh
nodes/            the nodes of a run, which scenarios name by their files
run_messages      the topics of a run and the messages of its frames, for the bridge and bags
bridge            publishes the frames of a run
layouts           layouts of the bridge's topics for RViz and Foxglove
rosbag2           a bag, for `mast export`
interception      an adversary between two nodes of ROS 2
commands          what `mast ros2` and `mast intercept --ros2` do
"""

from mast_ros2.mesh import Ros2Mesh

__all__ = ["Ros2Mesh"]
