"""``zmav ros2``: every vehicle a native ROS 2 node, with no ROS installed.

ROS 2's ``rmw_zenoh`` is Zenoh with conventions: which key a topic has, which liveliness tokens make the graph, what
goes with each message. Who keeps them *is* a node. What each message means is in docs/ros2.md.
"""
