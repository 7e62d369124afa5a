"""Author API for matchers, solvers, initializers and calibrators: problems, normal equations, pairing, evidence.

Names are declared once, below, and imported on first use. `tests/author_api.json` freezes them.
"""

# isort: skip_file

from __future__ import annotations

from typing import TYPE_CHECKING

from p2o.runtime.lazy import attach

if TYPE_CHECKING:
    from p2o.arrays import checked as checked
    from p2o.calibration.search_box import SearchBox as SearchBox
    from p2o.frames.accumulate import accumulated as accumulated, one_per_voxel as one_per_voxel
    from p2o.frames.lidar_odometry import poses_by_gicp as poses_by_gicp, poses_by_kiss_icp as poses_by_kiss_icp
    from p2o.frames.scale import image_at_scale as image_at_scale
    from p2o.geometry.visibility import hidden as hidden
    from p2o.problems.problem import left_from_chart as left_from_chart, pose_from_chart as pose_from_chart
    from p2o.problems.directed_cost import DirectedCost as DirectedCost
    from p2o.problems.pairing import fit_lines as fit_lines
    from p2o.problems.normal_equations import MIN_PAIRS as MIN_PAIRS, checked_solution as checked_solution
    from p2o.problems.normal_equations import linearise as linearise, normal_equations as normal_equations
    from p2o.problems.normal_equations import require_residuals as require_residuals
    from p2o.problems.pairing import PairingOptions as PairingOptions, Pairs as Pairs, assemble as assemble
    from p2o.problems.pairing import pair as pair
    from p2o.problems.picked_pairs import PickedPairs as PickedPairs, read_pairs as read_pairs
    from p2o.problems.picked_pose import PickedFrame as PickedFrame, PickedPose as PickedPose
    from p2o.problems.picked_pose import picks_off_px as picks_off_px, solve_picks as solve_picks
    from p2o.problems.point_to_line import PointToLine as PointToLine
    from p2o.problems.points_on_rays import PointsOnRays as PointsOnRays, consensus as consensus
    from p2o.problems.problem import LeastSquares as LeastSquares, Objective as Objective, Problem as Problem
    from p2o.problems.problem import swarmed as swarmed
    from p2o.results.evidence import Accuracy as Accuracy
    from p2o.results.evidence import Agreement as Agreement, Judged as Judged, Rival as Rival
    from p2o.results.result import Round as Round, TimeOffset as TimeOffset
    from p2o.results.verdict import Doubt as Doubt, Reason as Reason, Trust as Trust, Verdict as Verdict
    from p2o.run.pipeline import Pipeline as Pipeline
    from p2o.runtime.native import cores as cores, has_gpu_driver as has_gpu_driver
    from p2o.runtime.native import import_keeping_signals as import_keeping_signals, ipp_disabled as ipp_disabled

__getattr__, __dir__, __all__ = attach(__name__, __file__)
