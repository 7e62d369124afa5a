"""Simulator of cameras and LiDARs: all sensors observe the same scene, with exact ground truth."""

from p2o_sim.version import VERSION as VERSION
