"""Find the rigid transform between a camera and a LiDAR from ordinary scenes. The author API of plugins.

`p2o` holds data types, stages, results, options and errors; `p2o.solving` what matchers, solvers and calibrators need;
`p2o.reading` what readers of files need. Names are declared once, below, and imported on first use, so that
importing p2o loads no heavy packages. `tests/author_api.json` freezes names, fields and signatures.
"""

# isort: skip_file

from __future__ import annotations

from typing import TYPE_CHECKING

from p2o.runtime.lazy import attach as attach

if TYPE_CHECKING:
    from p2o import reading as reading, solving as solving
    from p2o.calibration.version import ALGORITHM as ALGORITHM
    from p2o.arrays import Bool as Bool, Float as Float, Int as Int, Int8 as Int8, UInt8 as UInt8
    from p2o.errors import InputError as InputError, MethodUnavailable as MethodUnavailable, P2OError as P2OError
    from p2o.errors import PluginError as PluginError, UnknownNameError as UnknownNameError
    from p2o.features import occlusion as occlusion
    from p2o.features.edges import CloudEdges as CloudEdges, ImageEdges as ImageEdges
    from p2o.features.feature import CloudFeature as CloudFeature, ImageFeature as ImageFeature
    from p2o.features.sets import GreyMap as GreyMap, ImageMap as ImageMap
    from p2o.features.sets import CloudPoints as CloudPoints
    from p2o.features.sets import CloudRemarks as CloudRemarks
    from p2o.features.sets import CloudFeatures as CloudFeatures, ImageFeatures as ImageFeatures
    from p2o.features.side import SIDES as SIDES, Side as Side
    from p2o.features.view import View as View
    from p2o.frames.cloud import Cloud as Cloud
    from p2o.frames.frame import Dataset as Dataset, Frame as Frame
    from p2o.frames.image import Image as Image
    from p2o.frames.frame import Box as Box, Checkerboard as Checkerboard, HoleBoard as HoleBoard, Sphere as Sphere
    from p2o.frames.frame import Target as Target
    from p2o.geometry import se3 as se3
    from p2o.geometry.camera import Camera as Camera
    from p2o.geometry.pose_error import PoseError as PoseError, pose_error as pose_error
    from p2o.host.hookspecs import hookimpl as hookimpl
    from p2o.host.method import PLUGIN_API as PLUGIN_API, Example as Example, Kind as Kind, Method as Method
    from p2o.host.method_index import methods_at as methods_at
    from p2o.host.registry import Registry as Registry
    from p2o.host.stages import Accumulator as Accumulator, Calibrator as Calibrator, CloudExtractor as CloudExtractor
    from p2o.host.stages import Exporter as Exporter, ImageExtractor as ImageExtractor, Initializer as Initializer
    from p2o.host.stages import InitializerBase as InitializerBase, Judge as Judge, JudgeBase as JudgeBase
    from p2o.host.stages import Matcher as Matcher
    from p2o.host.stages import MatcherBase as MatcherBase, Solver as Solver
    from p2o.host.method import Trainer as Trainer, TrainingGroup as TrainingGroup
    from p2o.host.method import TrainingProgress as TrainingProgress
    from p2o.runtime.lazy import attach as attach
    from p2o.training_loop import TrainingState as TrainingState, cosine_rate as cosine_rate
    from p2o.training_loop import StepOptions as StepOptions, run_steps as run_steps
    from p2o.options import Options as Options, field as field
    from p2o.results.result import Result as Result, Solution as Solution, SolverStatus as SolverStatus
    from p2o.results.result import Status as Status
    from p2o.run.check import check as check, watch as watch
    from p2o.run.recipe import Recipe as Recipe
    from p2o.run.run import calibrate as calibrate

__getattr__, __dir__, __all__ = attach(__name__, __file__)
