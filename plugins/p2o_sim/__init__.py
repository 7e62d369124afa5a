"""Simulator of cameras and LiDARs: all sensors observe the same scene, with exact ground truth.

Public names are declared once, below, and imported on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from p2o import attach

if TYPE_CHECKING:
    from p2o_sim.places.catalog import DIFFICULT as DIFFICULT
    from p2o_sim.places.catalog import INDOORS as INDOORS
    from p2o_sim.places.catalog import PLACES as PLACES
    from p2o_sim.places.catalog import place_of as place_of
    from p2o_sim.places.catalog import scene_of as scene_of
    from p2o_sim.sensing.lidar import Air as Air
    from p2o_sim.sensing.lidar import Beams as Beams
    from p2o_sim.sensing.lidar import Lidar as Lidar
    from p2o_sim.sensing.lidar import Rosette as Rosette
    from p2o_sim.sensing.photo import Photo as Photo
    from p2o_sim.sensing.photo import develop as develop
    from p2o_sim.sensing.photo import metered_gain as metered_gain
    from p2o_sim.sensing.rendering import RenderedImage as RenderedImage
    from p2o_sim.sensing.rendering import labels as labels
    from p2o_sim.sensing.rendering import render as render
    from p2o_sim.sensing.rig_sampling import RandomRig as RandomRig
    from p2o_sim.sensing.rig_sampling import random_rig as random_rig
    from p2o_sim.sensing.rig_sampling import random_vehicle as random_vehicle
    from p2o_sim.sensing.scanning import sweep as sweep
    from p2o_sim.sensing.sensors import LIDARS as LIDARS
    from p2o_sim.sensing.trajectory import LIDAR_HEIGHT_M as LIDAR_HEIGHT_M
    from p2o_sim.sensing.trajectory import Moment as Moment
    from p2o_sim.sensing.trajectory import Swing as Swing
    from p2o_sim.sensing.trajectory import drive as drive
    from p2o_sim.sensing.trajectory import odometry as odometry
    from p2o_sim.sensing.weather import WEATHERS as WEATHERS
    from p2o_sim.sensing.weather import Weather as Weather
    from p2o_sim.sensing.weather import headlights as headlights
    from p2o_sim.sensing.weather import in_weather as in_weather
    from p2o_sim.sensing.weather import lit_near as lit_near
    from p2o_sim.sensing.weather import rained_on as rained_on
    from p2o_sim.sensing.weather import weather_of as weather_of
    from p2o_sim.things.board_places import Rig as Rig
    from p2o_sim.things.board_places import boards_in_view as boards_in_view
    from p2o_sim.things.boards import BOXES as BOXES
    from p2o_sim.things.boards import CHECKERBOARDS as CHECKERBOARDS
    from p2o_sim.things.boards import SPHERES as SPHERES
    from p2o_sim.things.boards import Board as Board
    from p2o_sim.things.boards import target_of as target_of
    from p2o_sim.things.boards import thing_of as thing_of
    from p2o_sim.version import VERSION as VERSION
    from p2o_sim.world.lighting import Inside as Inside
    from p2o_sim.world.lighting import Lamp as Lamp
    from p2o_sim.world.lighting import Lighting as Lighting
    from p2o_sim.world.mesh import Mesh as Mesh
    from p2o_sim.world.scene import Class as Class
    from p2o_sim.world.scene import Hits as Hits
    from p2o_sim.world.scene import Material as Material
    from p2o_sim.world.scene import Mover as Mover
    from p2o_sim.world.scene import Part as Part
    from p2o_sim.world.scene import Scene as Scene

__getattr__, __dir__, __all__ = attach(__name__, __file__)
