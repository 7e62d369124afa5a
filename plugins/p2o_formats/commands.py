"""Commands that this package adds to `p2o`; their code is in `p2o_formats.cli`."""

COMMANDS = {"convert": "Convert a calibration file: ROS 2, Autoware, Kalibr, COLMAP, OpenCV, KITTI and others."}
"""Name and one-line help of every command."""
