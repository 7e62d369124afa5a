"""The simulator: one scene, seen by any camera and any LiDAR, with exact truth."""

from __future__ import annotations

from p2o.geometry.perturb import parse_perturbation as parse_perturbation
from p2o.geometry.perturb import wrong_start as wrong_start
from p2o.simulate.board_places import Rig as Rig
from p2o.simulate.board_places import boards_in_view as boards_in_view
from p2o.simulate.boards import CHECKERBOARDS as CHECKERBOARDS
from p2o.simulate.boards import Board as Board
from p2o.simulate.boards import target_of as target_of
from p2o.simulate.boards import thing_of as thing_of
from p2o.simulate.classes import Class as Class
from p2o.simulate.labels import labels as labels
from p2o.simulate.lidar import Beams as Beams
from p2o.simulate.lidar import Lidar as Lidar
from p2o.simulate.lidar import Rosette as Rosette
from p2o.simulate.lighting import Inside as Inside
from p2o.simulate.lighting import Lamp as Lamp
from p2o.simulate.lighting import Lighting as Lighting
from p2o.simulate.mesh import Mesh as Mesh
from p2o.simulate.odometry import odometry as odometry
from p2o.simulate.photo import Photo as Photo
from p2o.simulate.photo import develop as develop
from p2o.simulate.photo import metered_gain as metered_gain
from p2o.simulate.places import INDOORS as INDOORS
from p2o.simulate.places import PLACES as PLACES
from p2o.simulate.places import place_of as place_of
from p2o.simulate.places import scene_of as scene_of
from p2o.simulate.places import street as street
from p2o.simulate.render import Picture as Picture
from p2o.simulate.render import render as render
from p2o.simulate.scene import Hits as Hits
from p2o.simulate.scene import Material as Material
from p2o.simulate.scene import Mover as Mover
from p2o.simulate.scene import Part as Part
from p2o.simulate.scene import Scene as Scene
from p2o.simulate.sensors import LIDARS as LIDARS
from p2o.simulate.sweep import sweep as sweep
from p2o.simulate.trajectory import LIDAR_HEIGHT_M as LIDAR_HEIGHT_M
from p2o.simulate.trajectory import Moment as Moment
from p2o.simulate.trajectory import Swing as Swing
from p2o.simulate.trajectory import drive as drive
