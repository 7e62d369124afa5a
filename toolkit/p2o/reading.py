"""Author API for data sets and calibration files: checked input files, poses in text, calibration file formats.

Names are declared once, below, and imported on first use. `tests/author_api.json` freezes them.
"""

# isort: skip_file

from __future__ import annotations

from typing import TYPE_CHECKING

from p2o.runtime.lazy import attach

if TYPE_CHECKING:
    from p2o.calibration_files.calibration import CAMERA as CAMERA, EXTRINSIC as EXTRINSIC, Calibration as Calibration
    from p2o.calibration_files.number_text import digits as digits, listed as listed, matrix_rows as matrix_rows
    from p2o.calibration_files.number_text import plain as plain, quaternion_xyzw as quaternion_xyzw, spaced as spaced
    from p2o.calibration_files.calibration import CalibrationReader as CalibrationReader, FrameName as FrameName
    from p2o.calibration_files.calibration import Reading as Reading
    from p2o.calibration_files.calibration import Source as Source
    from p2o.errors import printable as printable
    from p2o.files.array_file import MAX_BYTES as MAX_BYTES, read_npy as read_npy, read_npz as read_npz
    from p2o.files.file_names import folder_name as folder_name
    from p2o.files.input_file import existing_folder as existing_folder, expanded as expanded, listing as listing
    from p2o.files.input_file import layout as layout, naming as naming, read_bytes as read_bytes
    from p2o.files.input_file import read_start as read_start, read_text as read_text
    from p2o.files.parsed_text import parse_json as parse_json, parse_yaml as parse_yaml
    from p2o.files.whole_file import write_whole as write_whole
    from p2o.frames.direction import check_direction as check_direction, unit_remark as unit_remark
    from p2o.frames.image_file import MAX_PIXELS as MAX_PIXELS, decode_rgb as decode_rgb, read_rgb as read_rgb
    from p2o.frames.image_file import eight_bit as eight_bit, read_uint16 as read_uint16
    from p2o.frames.frame import LazyFrames as LazyFrames
    from p2o.frames.rings import RingsUnknownError as RingsUnknownError, neighbour_gap as neighbour_gap
    from p2o.frames.rings import told_rings as told_rings
    from p2o.geometry.motion import adjoint as adjoint, moved as moved, pose_at as pose_at
    from p2o.geometry.perturb import parse_perturbation as parse_perturbation, wrong_start as wrong_start
    from p2o.geometry.pose_text import numbers as numbers, read_extrinsic as read_extrinsic, read_pose as read_pose
    from p2o.geometry.radial_error import RadialError as RadialError
    from p2o.geometry.rpy import rotation_of as rotation_of, rpy_of as rpy_of
    from p2o.host.calibration_file import names_file as names_file, read_calibration as read_calibration
    from p2o.host.weights import Weights as Weights, weights_of as weights_of
    from p2o.host.calibration_file import read_camera_file as read_camera_file
    from p2o.host.calibration_file import read_extrinsic_file as read_extrinsic_file
    from p2o.host.calibration_file import read_initial_guess as read_initial_guess
    from p2o.training_loop import read_tensors as read_tensors, write_tensors as write_tensors
    from p2o.options import validated as validated
    from p2o.results.figures import provenance as provenance
    from p2o.results.result_json import result_from_dict as result_from_dict, result_to_json as result_to_json

__getattr__, __dir__, __all__ = attach(__name__, __file__)
