"""The simulator: one scene, seen by any camera and any LiDAR, with exact truth."""

from __future__ import annotations

from p2o.simulate.lidar import HDL64E as HDL64E
from p2o.simulate.lidar import SpinningLidar as SpinningLidar
from p2o.simulate.lidar import sweep as sweep
from p2o.simulate.mesh import Mesh as Mesh
from p2o.simulate.render import Picture as Picture
from p2o.simulate.render import render as render
from p2o.simulate.scene import Hits as Hits
from p2o.simulate.scene import Material as Material
from p2o.simulate.scene import Part as Part
from p2o.simulate.scene import Scene as Scene
from p2o.simulate.street import street as street
