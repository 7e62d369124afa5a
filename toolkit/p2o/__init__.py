"""p2o finds the rigid transform between a camera and a LiDAR from ordinary scenes. Public names live here.

Names are imported when they are first used, so that `import p2o` and `p2o --help` stay quick.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from p2o.moved import forward_moved_modules

if TYPE_CHECKING:
    from p2o.calibration.pipeline import Pipeline as Pipeline
    from p2o.errors import InputError as InputError
    from p2o.errors import MethodUnavailable as MethodUnavailable
    from p2o.errors import P2OError as P2OError
    from p2o.errors import PluginError as PluginError
    from p2o.errors import UnknownNameError as UnknownNameError
    from p2o.features import occlusion as occlusion
    from p2o.features.edges import CloudEdges as CloudEdges
    from p2o.features.edges import ImageEdges as ImageEdges
    from p2o.features.feature import CloudFeature as CloudFeature
    from p2o.features.feature import Feature as Feature
    from p2o.features.feature import ImageFeature as ImageFeature
    from p2o.features.maps import GreyMap as GreyMap
    from p2o.features.maps import ImageMap as ImageMap
    from p2o.features.points import CloudPoints as CloudPoints
    from p2o.features.remarks import CloudRemarks as CloudRemarks
    from p2o.features.sets import CloudFeatures as CloudFeatures
    from p2o.features.sets import ImageFeatures as ImageFeatures
    from p2o.features.side import SIDES as SIDES
    from p2o.features.side import Side as Side
    from p2o.features.view import View as View
    from p2o.frames.cloud import Cloud as Cloud
    from p2o.frames.frame import Dataset as Dataset
    from p2o.frames.frame import Frame as Frame
    from p2o.frames.image import Image as Image
    from p2o.frames.scale import image_at_scale as image_at_scale
    from p2o.frames.target import Box as Box
    from p2o.frames.target import Checkerboard as Checkerboard
    from p2o.frames.target import HoleBoard as HoleBoard
    from p2o.frames.target import Sphere as Sphere
    from p2o.frames.target import Target as Target
    from p2o.geometry import se3 as se3
    from p2o.geometry.camera import Camera as Camera
    from p2o.geometry.pose_error import PoseError as PoseError
    from p2o.geometry.pose_error import pose_error as pose_error
    from p2o.geometry.radial_error import RadialError as RadialError
    from p2o.geometry.visibility import hidden as hidden
    from p2o.host.hookspecs import hookimpl as hookimpl
    from p2o.host.method import Example as Example
    from p2o.host.method import Kind as Kind
    from p2o.host.method import Method as Method
    from p2o.host.registry import Registry as Registry
    from p2o.host.stages import Accumulator as Accumulator
    from p2o.host.stages import Calibrator as Calibrator
    from p2o.host.stages import CloudExtractor as CloudExtractor
    from p2o.host.stages import Exporter as Exporter
    from p2o.host.stages import ImageExtractor as ImageExtractor
    from p2o.host.stages import Initializer as Initializer
    from p2o.host.stages import Matcher as Matcher
    from p2o.host.stages import Solver as Solver
    from p2o.host.trainer import Trainer as Trainer
    from p2o.host.trainer import TrainingGroup as TrainingGroup
    from p2o.host.trainer import TrainingProgress as TrainingProgress
    from p2o.options import Options as Options
    from p2o.options import field as field
    from p2o.problems.directed_cost import DirectedCost as DirectedCost
    from p2o.problems.point_to_line import PointToLine as PointToLine
    from p2o.problems.problem import LeastSquares as LeastSquares
    from p2o.problems.problem import Objective as Objective
    from p2o.problems.problem import Problem as Problem
    from p2o.results.accuracy import Accuracy as Accuracy
    from p2o.results.check import AxisCheck as AxisCheck
    from p2o.results.check import Check as Check
    from p2o.results.check import Holding as Holding
    from p2o.results.check import Slip as Slip
    from p2o.results.check import Watch as Watch
    from p2o.results.check import WatchedFrame as WatchedFrame
    from p2o.results.evidence import Agreement as Agreement
    from p2o.results.evidence import Judged as Judged
    from p2o.results.evidence import Rival as Rival
    from p2o.results.evidence import StartWeight as StartWeight
    from p2o.results.result import CameraCheck as CameraCheck
    from p2o.results.result import Result as Result
    from p2o.results.result import Round as Round
    from p2o.results.result import Solution as Solution
    from p2o.results.result import SolverStatus as SolverStatus
    from p2o.results.result import Status as Status
    from p2o.results.result import SweepMotion as SweepMotion
    from p2o.results.result import TimeOffset as TimeOffset
    from p2o.results.verdict import Doubt as Doubt
    from p2o.results.verdict import Reason as Reason
    from p2o.results.verdict import Trust as Trust
    from p2o.results.verdict import Verdict as Verdict
    from p2o.run.check import check as check
    from p2o.run.check import watch as watch
    from p2o.run.recipe import Recipe as Recipe
    from p2o.run.run import FailedFrame as FailedFrame
    from p2o.run.run import Row as Row
    from p2o.run.run import Run as Run
    from p2o.run.run import calibrate as calibrate

_HOME = {
    "results.accuracy": ["Accuracy"],
    "geometry.camera": ["Camera"],
    "frames.cloud": ["Cloud"],
    "problems.directed_cost": ["DirectedCost"],
    "errors": ["InputError", "MethodUnavailable", "P2OError", "PluginError", "UnknownNameError"],
    "features.edges": ["CloudEdges", "ImageEdges"],
    "features.feature": ["CloudFeature", "Feature", "ImageFeature"],
    "features.maps": ["GreyMap", "ImageMap"],
    "features.points": ["CloudPoints"],
    "features.remarks": ["CloudRemarks"],
    "features.sets": ["CloudFeatures", "ImageFeatures"],
    "frames.frame": ["Dataset", "Frame"],
    "host.hookspecs": ["hookimpl"],
    "frames.image": ["Image"],
    "frames.scale": ["image_at_scale"],
    "host.method": ["Example", "Kind", "Method"],
    "geometry.pose_error": ["PoseError", "pose_error"],
    "options": ["Options", "field"],
    "calibration.pipeline": ["Pipeline"],
    "problems.point_to_line": ["PointToLine"],
    "problems.problem": ["LeastSquares", "Objective", "Problem"],
    "geometry.radial_error": ["RadialError"],
    "run.check": ["check", "watch"],
    "run.recipe": ["Recipe"],
    "host.registry": ["Registry"],
    "frames.target": ["Box", "Checkerboard", "HoleBoard", "Sphere", "Target"],
    "results.check": ["AxisCheck", "Check", "Holding", "Slip", "Watch", "WatchedFrame"],
    "results.evidence": ["Agreement", "Judged", "Rival", "StartWeight"],
    "results.result": [
        "CameraCheck",
        "Result",
        "Round",
        "Solution",
        "SolverStatus",
        "Status",
        "SweepMotion",
        "TimeOffset",
    ],
    "results.verdict": ["Doubt", "Reason", "Trust", "Verdict"],
    "run.run": ["FailedFrame", "Row", "Run", "calibrate"],
    "features.side": ["SIDES", "Side"],
    "host.stages": [
        "Accumulator",
        "Calibrator",
        "CloudExtractor",
        "Exporter",
        "ImageExtractor",
        "Initializer",
        "Matcher",
        "Solver",
    ],
    "host.trainer": ["Trainer", "TrainingGroup", "TrainingProgress"],
    "features.view": ["View"],
    "geometry.visibility": ["hidden"],
}
forward_moved_modules()

_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

_MODULES = {"occlusion": "features.occlusion", "se3": "geometry.se3"}

__all__ = sorted([*_MODULE_OF, *_MODULES])


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return importlib.import_module(f"p2o.{_MODULES[name]}")
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'p2o' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"p2o.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
