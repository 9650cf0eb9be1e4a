"""ROS 2 messages without an installation of ROS: the format of rmw_zenoh, and conversions from and to our columns.

Bytes, names and arrays in, the same out. Nothing here opens a session.

definitions       message types that rosbags does not have: vision_msgs and autoware_perception_msgs
type_store        classes of all message types, their CDR bytes and hashes
connection        how to reach a router of rmw_zenoh, as scenarios say it
names             names of topics, nodes and types, and how keys write them
data_keys         the key expression of a topic's messages
qos               quality of service in tokens
liveliness_tokens tokens that make nodes, publishers and subscriptions known
attachments       sequence number, time and publisher of a message

spatial           parts of messages: headers, poses, covariances
object_messages   objects as Detection3DArray, TrackedObjects and PredictedObjects
object_markers    objects as a MarkerArray, for RViz
pose_messages     poses as TFMessage and Odometry; Clock
trust_messages    trust as a DiagnosticArray
received_objects  Detection3DArray, DetectedObjects and TrackedObjects as our objects
altered_objects   messages of objects some of which an interposer has altered
received_poses    Odometry and TFMessage as our poses

outside           the interface of a node's link to nodes of ROS 2; needs no rosbags
frame_transforms  where frames of reference are in the world, from /tf
frame_exchange    questions about frames and their answers: stamps, waiting, counts
agent_exchange, center_exchange, adversary_exchange    what nodes of these roles send and receive
"""
