"""p2o finds the rigid transform between a camera and a LiDAR from ordinary scenes. Public names live here.

Names are imported when they are first used, so that `import p2o` and `p2o --help` stay quick.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from p2o import occlusion as occlusion
    from p2o import se3 as se3
    from p2o.accuracy import Accuracy as Accuracy
    from p2o.camera import Camera as Camera
    from p2o.cloud import Cloud as Cloud
    from p2o.directed_cost import DirectedCost as DirectedCost
    from p2o.errors import InputError as InputError
    from p2o.errors import MethodUnavailable as MethodUnavailable
    from p2o.errors import P2OError as P2OError
    from p2o.errors import PluginError as PluginError
    from p2o.errors import UnknownNameError as UnknownNameError
    from p2o.features import CloudEdges as CloudEdges
    from p2o.features import CloudFeatures as CloudFeatures
    from p2o.features import ImageEdges as ImageEdges
    from p2o.features import ImageFeatures as ImageFeatures
    from p2o.frame import Dataset as Dataset
    from p2o.frame import Frame as Frame
    from p2o.hookspecs import hookimpl as hookimpl
    from p2o.image import Image as Image
    from p2o.method import Kind as Kind
    from p2o.method import Method as Method
    from p2o.metrics import PoseError as PoseError
    from p2o.metrics import pose_error as pose_error
    from p2o.options import Options as Options
    from p2o.options import field as field
    from p2o.pipeline import Pipeline as Pipeline
    from p2o.problem import Objective as Objective
    from p2o.problem import PointToLine as PointToLine
    from p2o.problem import Problem as Problem
    from p2o.radial_error import RadialError as RadialError
    from p2o.recipe import Recipe as Recipe
    from p2o.registry import Registry as Registry
    from p2o.result import CameraCheck as CameraCheck
    from p2o.result import Result as Result
    from p2o.result import Round as Round
    from p2o.result import Solution as Solution
    from p2o.result import Status as Status
    from p2o.result import SweepMotion as SweepMotion
    from p2o.run import Row as Row
    from p2o.run import Run as Run
    from p2o.run import calibrate as calibrate
    from p2o.side import SIDES as SIDES
    from p2o.side import Side as Side
    from p2o.stages import Calibrator as Calibrator
    from p2o.stages import CloudExtractor as CloudExtractor
    from p2o.stages import Exporter as Exporter
    from p2o.stages import ImageExtractor as ImageExtractor
    from p2o.stages import Initializer as Initializer
    from p2o.stages import Matcher as Matcher
    from p2o.stages import Solver as Solver
    from p2o.trainer import Trainer as Trainer
    from p2o.trainer import TrainingGroup as TrainingGroup
    from p2o.trainer import TrainingProgress as TrainingProgress
    from p2o.view import View as View
    from p2o.visibility import hidden as hidden

_HOME = {
    "accuracy": ["Accuracy"],
    "camera": ["Camera"],
    "cloud": ["Cloud"],
    "directed_cost": ["DirectedCost"],
    "errors": ["InputError", "MethodUnavailable", "P2OError", "PluginError", "UnknownNameError"],
    "features": ["CloudEdges", "CloudFeatures", "ImageEdges", "ImageFeatures"],
    "frame": ["Dataset", "Frame"],
    "hookspecs": ["hookimpl"],
    "image": ["Image"],
    "method": ["Kind", "Method"],
    "metrics": ["PoseError", "pose_error"],
    "options": ["Options", "field"],
    "pipeline": ["Pipeline"],
    "problem": ["Objective", "PointToLine", "Problem"],
    "radial_error": ["RadialError"],
    "recipe": ["Recipe"],
    "registry": ["Registry"],
    "result": ["CameraCheck", "Result", "Round", "Solution", "Status", "SweepMotion"],
    "run": ["Row", "Run", "calibrate"],
    "side": ["SIDES", "Side"],
    "stages": [
        "Calibrator",
        "CloudExtractor",
        "Exporter",
        "ImageExtractor",
        "Initializer",
        "Matcher",
        "Solver",
    ],
    "trainer": ["Trainer", "TrainingGroup", "TrainingProgress"],
    "view": ["View"],
    "visibility": ["hidden"],
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

_MODULES = ["occlusion", "se3"]

__all__ = sorted([*_MODULE_OF, *_MODULES])


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return importlib.import_module(f"p2o.{name}")
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'p2o' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"p2o.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
