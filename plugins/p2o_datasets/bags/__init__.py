"""ROS bags: topics, messages as they are in ROS 1 and 2, and the tree of frames. The package `rosbags` opens files."""
