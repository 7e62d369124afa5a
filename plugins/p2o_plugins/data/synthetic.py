"""Synthetic roads, halls and rooms with exact truth: cameras and LiDAR look at the same triangles."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from p2o import Camera, Frame, Image, InputError, Method, Options, field, se3
from p2o.arrays import Float, UInt8
from pydantic import BeforeValidator, Field

from p2o_plugins.data.lazy_frames import LazyFrames

if TYPE_CHECKING:
    from p2o.simulate import Board, Moment, Picture, Scene, Weather

BASELINE_M = 0.54
_KITTI_MOUNT = (0.27, 0.06, -0.08, 0.458, -0.63, 0.344)
_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
# No dataset names more frames. What a frame takes of memory, measured on places full of trees: what is always there, a
# metre of the way (two places are kept), and a million pixels of the picture.
_MOST_FRAMES = 100_000
_MOST_MB, _ALWAYS_MB, _PER_METRE_MB, _PER_MEGAPIXEL_MB = 1500, 320, 3.2, 180
# One stream of random numbers for each of these, so that more noise or another camera leaves the place as it was.
# The number of the places is one with which the very first of them is a street.
_PLACE, _DRIVE, _LIDAR, _CAMERA, _GRAIN, _START, _DRIFT, _ODOMETRY, _BOARDS = 31, 1, 2, 3, 4, 5, 6, 7, 8
_HEIGHT, _WEATHER, _RAIN, _RIG = 9, 10, 11, 12
_ROAD_M_S = 8.0
_USUAL_M_S = {"hall": 1.0, "room": 0.5}
"""Speeds of rigs that are not cars on roads."""
_INDOORS_M = (0.6, 1.4)
"""How high the LiDAR of a robot is that drives through halls and rooms."""


_Shift = Annotated[float, Field(ge=-100, le=100)]
_Side = Annotated[float, Field(gt=0, le=4)]
_Turn = Annotated[float, Field(ge=-360, le=360)]
_Word = Literal["front", "left", "right", "back"]
_TO_THE_LEFT_DEG: dict[str, float] = {"": 0, "front": 0, "left": 60, "right": -60, "back": 180}
"""How far the mounting of each camera of a rig is turned to the left about the upright axis of the LiDAR."""


def _words(value: Any) -> Any:
    return tuple(value.split(",")) if isinstance(value, str) else value


class SyntheticOptions(Options):
    """What the dataset `synthetic` shows."""

    scenes: int = field(1, ge=1, le=100_000, help="Number of places; each gives one frame, or a drive.")
    frames_per_scene: int = field(1, ge=1, le=1000, help="Frames of the drive through each place.")
    period_s: float = field(0.1, gt=0, le=60, help="Time from one frame of a drive to the next in seconds.")
    seed: int = field(0, ge=0, lt=2**63, help="Seed of the places, of all noise and of the wrong start.")
    place: Literal["mixed", "anywhere", "street", "suburb", "highway", "trees", "yard", "hall", "room"] = field(
        "mixed",
        help="Kind of place; mixed draws a road for each scene, a third of them with trees and banks; anywhere draws "
        "among all: roads, a yard (an open floor between halls, for boards), and inside a hall or a room.",
    )
    weather: Literal["clear", "overcast", "rain", "fog", "night", "any"] = field(
        "clear",
        help="Weather in the picture and in the sweep; any draws one for each scene. In halls and rooms it is seen "
        "through the windows.",
    )
    speed_m_s: float | None = field(
        None,
        ge=0,
        le=60,
        help="Speed of the car in metres a second; other traffic has about the same. Null is 8, in a hall 1, in a room "
        "0.5, and 0 with targets.",
    )
    lidar_height_m: float | None = field(
        None,
        ge=0.2,
        le=10,
        help="Height of the LiDAR above the ground in metres; null is 1.73, in halls and rooms 0.6 to 1.4, drawn.",
    )
    swing_deg: float = field(
        0.0, ge=0, le=60, help="How far a drive turns to the left and right of its road as it swings along it."
    )
    tilt_deg: float = field(0.0, ge=0, le=20, help="How far a drive pitches and rolls on uneven ground.")
    sway: float = field(
        1.0,
        ge=0,
        le=10,
        help="How much the car sits differently on its springs from frame to frame, times 0.3 degrees and 5 cm; 0 for "
        "a drive whose poses lie on one smooth way.",
    )
    odometry_noise_deg: float = field(
        0.0, ge=0, le=10, help="Deviation of each step of the odometry in degrees an axis, camera and LiDAR each."
    )
    odometry_noise_m: float = field(
        0.0, ge=0, le=10, help="Deviation of each step of the odometry in metres an axis, camera and LiDAR each."
    )
    targets: Literal["none", "checkerboard", "holes", "sphere", "box"] = field(
        "none",
        help="Boards, balls or boxes ahead of the car, in another pose in each frame; frames then tell their geometry.",
    )
    boards: int = field(1, ge=1, le=8, help="Number of targets in view, all of one kind; balls and boxes by colour.")
    holder: Literal["person", "stand"] = field(
        "person", help="Who or what holds each board; balls and boxes are always on a pole."
    )
    board: Literal["a0", "a1", "a2"] = field("a0", help="Named size of the targets, which the next options change.")
    columns: int | None = field(None, ge=1, le=40, help="Inner corners, or holes, along a row; null is the board's.")
    rows: int | None = field(None, ge=1, le=40, help="Inner corners, or holes, down a column; null is the board's.")
    square_m: float | None = field(
        None, gt=0, le=2, help="Side of a square, or distance between holes, in metres; null is the board's."
    )
    hole_radius_m: float | None = field(None, gt=0, le=1, help="Radius of the holes in metres; null is the board's.")
    board_width_m: float | None = field(
        None, gt=0, le=4, help="Width of the board in metres; null is the named one's, or fits a changed pattern."
    )
    board_height_m: float | None = field(
        None, gt=0, le=4, help="Height of the board in metres; null is the named one's, or fits a changed pattern."
    )
    sphere_radius_m: float | None = field(None, gt=0, le=2, help="Radius of balls in metres; null is the named one's.")
    box_size_m: tuple[_Side, _Side, _Side] | None = field(
        None, help="Width, height, depth of boxes in metres; null is the named one's."
    )
    rig: Literal["fixed", "random", "random-rings"] = field(
        "fixed",
        help="fixed is what the other options say; with random each scene has its own camera, width_px, height_px, "
        "focal_px, mount and lidar, drawn by the seed, in place of those of the options, and its own wrong start; "
        "with random-rings every LiDAR has rings.",
    )
    megapixels: float = field(
        2.0,
        ge=0.01,
        le=6,
        help="Random rigs: pictures of more million pixels are made smaller, with their focal lengths.",
    )
    camera: Literal["pinhole", "opencv-distorted", "fisheye"] = field(
        "pinhole", help="Camera model: KITTI-like pinhole with a right picture, distorted OPENCV, or OPENCV_FISHEYE."
    )
    width_px: int = field(
        1242, ge=64, le=8192, help="Width of the image; the focal length scales with it unless focal_px is given."
    )
    height_px: int = field(375, ge=64, le=8192, help="Height of the image; its field of view follows.")
    focal_px: float | None = field(
        None,
        ge=50,
        le=10_000,
        help="Focal length in pixels; null is 0.581 of the width (as KITTI), for a fisheye 0.386 of it.",
    )
    exposure_ev: float | None = field(
        None, ge=-8, le=8, help="Stops that the picture is too bright (+) or too dark (-); null draws -1.2 to 1.5."
    )
    grain: float = field(
        2.0, ge=0, le=64, help="Read noise of the image in grey levels of 255; shot noise grows with it."
    )
    blur_px: float = field(0.5, ge=0, le=20, help="Deviation of the lens's spot in pixels.")
    vignetting: float = field(0.3, ge=0, le=1, help="Share of light that the corners of the image lose.")
    jpeg_quality: int = field(95, ge=0, le=100, help="Quality of JPEG compression, 0 for none.")
    right: bool = field(True, help="Whether a pinhole camera has a right picture.")
    lidar: Literal["hdl-64e", "hdl-32e", "vlp-16", "os1-64", "os1-128", "pandar64", "mid-40"] = field(
        "hdl-64e", help="The LiDAR; mid-40 is a rosette without rings, all others turn."
    )
    noise_m: float | None = field(None, ge=0, le=1, help="Deviation of the range in metres; null is the sensor's own.")
    angle_noise_deg: float = field(0.02, ge=0, le=5, help="Deviation of the angles of each beam in degrees.")
    max_range_m: float | None = field(None, gt=1, le=1000, help="Farthest return in metres; null is the sensor's own.")
    divergence_mrad: float | None = field(
        None, ge=0, le=50, help="Full divergence of a beam in mrad; null is the sensor's own, 0 a thin ray."
    )
    keeps: Literal["strongest", "first"] = field(
        "strongest", help="Which return of a pulse that meets several surfaces."
    )
    deskew: bool = field(True, help="Compensate the sweep for the motion of the car, which is known exactly.")
    mount: tuple[_Shift, _Shift, _Shift, _Turn, _Turn, _Turn] = field(
        _KITTI_MOUNT,
        help="Camera in the LiDAR frame: x, y, z in metres, then its pitch, yaw, roll in degrees from straight ahead.",
    )
    cameras: Annotated[tuple[_Word, ...], BeforeValidator(_words)] = field(
        (),
        max_length=4,
        help="Cameras of a rig, such as front,left,right: each moment gives a frame for each, with the same sweep and "
        "`mount` turned about the LiDAR by 60 degrees to the left or right, or half around; none is one camera.",
    )
    drift: str = field("0.5deg 0.03m", help="How far the camera's mounting slips, as for --perturb.")
    drift_at_frame: int | None = field(
        None, ge=0, help="Frame of each drive from which on it has slipped; null is never."
    )
    start_error: str = field(
        "2deg 0.15m", help="How wrong the start is that frames offer, the same for all; --perturb draws one for each."
    )
    mask_foliage: bool = field(False, help="Mask pixels that show leaves, so that extractors leave their edges out.")


@dataclass(frozen=True, eq=False)
class View:
    """Everything there is to know about one frame: its `scene`, `moment`, `picture` and `boards` with all truth."""

    frame: Frame
    scene: Scene
    moment: Moment
    picture: Picture
    boards: tuple[Board, ...] = ()


def camera_from_lidar(mount: tuple[float, ...] = _KITTI_MOUNT) -> Float:
    """Return the extrinsic (4, 4) of a mounting: x, y, z in metres; pitch, yaw, roll in degrees in camera axes."""
    turn = np.radians([mount[3], mount[4], mount[5]])
    rotation = se3.exp(np.concatenate([turn, np.zeros(3)]))[:3, :3] @ _AXES
    return se3.make(rotation, -rotation @ np.array(mount[:3]))


def camera_of(options: SyntheticOptions) -> Camera:
    """Return the camera of the options, in proportion to KITTI's 1242x375 px with a focal length of 721.5 px.

    `focal_px` changes the focal length alone: the principal point and the distortion, which is of the angle, stay.
    """
    width, height = options.width_px, options.height_px
    scale = width / 1242
    focal = (480.0 if options.camera == "fisheye" else 721.5) * scale if options.focal_px is None else options.focal_px
    tall = 722.5 * scale if options.focal_px is None else options.focal_px * 722.5 / 721.5
    cx, cy = (609.6 + 0.5) * scale - 0.5, (172.9 + 0.5) * height / 375 - 0.5
    match options.camera:
        case "pinhole":
            return Camera.pinhole(focal, focal, cx, cy, width, height)
        case "opencv-distorted":
            distortion = (-0.28, 0.08, 0.001, -0.0015)
            return Camera("OPENCV", width, height, (focal, tall, cx, cy, *distortion))
        case "fisheye":
            distortion = (0.02, -0.006, 0.001, -0.0002)
            return Camera("OPENCV_FISHEYE", width, height, (focal, focal, cx, cy, *distortion))


def truth_at(options: SyntheticOptions, scene: int, number: int, camera: str = "") -> Float:
    """Return the true extrinsic (4, 4) of frame `number` of a scene: that of the mounting, until it slips."""
    options = _with_rig(options, scene)
    about_z = np.radians([0, 0, -_TO_THE_LEFT_DEG[camera], 0, 0, 0])
    truth = camera_from_lidar(options.mount) @ se3.exp(about_z)
    if options.drift_at_frame is None or number < options.drift_at_frame:
        return truth
    return _displaced(truth, options.drift, _stream(options, _DRIFT, scene))


def _with_rig(options: SyntheticOptions, scene_number: int) -> SyntheticOptions:
    """Return the options with the rig of a scene: their own, or the one that is drawn for it."""
    if options.rig == "fixed":
        return options
    from p2o.simulate import random_rig

    rng = _stream(options, _RIG, scene_number)
    drawn = random_rig(rng, megapixels=options.megapixels, rings=options.rig == "random-rings")
    changes = {
        "camera": drawn.model,
        "width_px": drawn.width,
        "height_px": drawn.height,
        "focal_px": drawn.focal_px,
        "mount": drawn.mount,
        "lidar": drawn.lidar,
    }
    return options.model_copy(update=changes)


def _displaced(truth: Float, size: str, rng: np.random.Generator) -> Float:
    """Return the pose (4, 4) displaced by a size such as "2deg 0.15m" in a random direction."""
    from p2o.simulate import parse_perturbation, wrong_start

    wanted = parse_perturbation(size)
    return wrong_start(truth, wanted.angle_deg, wanted.distance_m, rng)


def view(options: SyntheticOptions, scene_number: int, number: int = 0, camera: str = "") -> View:
    """Return frame `number` of a scene with all its truth, seen by one of `cameras` where there are any.

    It is the same bytes for the same options.
    """
    from p2o import simulate

    options = _with_rig(options, scene_number)
    names = ("seed", "place", "frames_per_scene", "period_s", "swing_deg", "tilt_deg", "lidar_height_m", "weather")
    still = options.targets != "none" and not options.speed_m_s
    weather = _weather(options, scene_number)
    scene, moments = _drive(
        scene_number,
        **{name: getattr(options, name) for name in names},
        around=options.rig != "fixed",
        speed_m_s=0.0 if still else options.speed_m_s,
        sway=0.0 if still else options.sway,
    )
    moment = moments[number]
    truth = truth_at(options, scene_number, number, camera)
    if weather.name == "night":
        # A robot in a building has no headlights.
        own = () if scene.lighting.inside else simulate.headlights(moment.world_from_lidar, _height_m(options))
        scene = simulate.lit_near(scene, moment.world_from_lidar, own)
    scene, boards = _with_boards(options, scene, moment, scene_number, number)
    # Beside the picture: each of them has stretches that keep one core busy only.
    with ThreadPoolExecutor(1) as beside:
        noise = _stream(options, _LIDAR, scene_number, number)
        swept = beside.submit(
            simulate.sweep,
            scene,
            _lidar(options),
            moment.world_from_lidar,
            noise,
            twist=moment.twist,
            time_s=moment.time_s,
            air=weather.air if scene.lighting.inside is None else simulate.Air(),
        )
        image, picture = _seen(options, scene, moment, truth, weather, (scene_number, number, *_nth(options, camera)))
        cloud = swept.result()
    frame = Frame(
        _name(options, scene_number, number, camera),
        image,
        cloud.untwisted(moment.twist) if options.deskew else cloud,
        camera_from_lidar=truth,
        start=_displaced(truth, options.start_error, _stream(options, _START, *_own(options, scene_number))),
        twist=moment.twist,
        targets=tuple(board.target for board in boards),
        camera_name=camera,
        **_of_drive(options, moments, scene_number, number, camera),
    )
    return View(frame, scene, moment, picture, boards)


def _weather(options: SyntheticOptions, scene_number: int) -> Weather:
    """Return the weather of a scene: the first that its stream of random numbers gives."""
    from p2o.simulate import weather_of

    return weather_of(options.weather, _stream(options, _WEATHER, scene_number))


def _height_m(options: SyntheticOptions) -> float:
    """Return the height of the LiDAR on a car."""
    from p2o.simulate import LIDAR_HEIGHT_M

    return LIDAR_HEIGHT_M if options.lidar_height_m is None else options.lidar_height_m


def _most_speed_m_s(options: SyntheticOptions) -> float:
    """Return the speed of the options, the largest one where it depends on the place that is drawn."""
    if options.speed_m_s is None:
        return _USUAL_M_S.get(options.place, _ROAD_M_S) if options.targets == "none" else 0.0
    return options.speed_m_s


def _own(options: SyntheticOptions, scene_number: int) -> tuple[int, ...]:
    """Return the number of a scene with a rig of its own; nothing where all have the same one, and the same start."""
    return () if options.rig == "fixed" else (scene_number,)


def _nth(options: SyntheticOptions, camera: str) -> tuple[int, ...]:
    """Return the number of a camera of a rig, after which its grain is drawn; nothing where there is one only."""
    return (options.cameras.index(camera),) if camera else ()  # type: ignore[arg-type]


def _of_drive(
    options: SyntheticOptions, moments: tuple[Moment, ...], scene_number: int, number: int, camera_name: str
) -> dict[str, Any]:
    """Return what a frame of a drive tells of it; a frame that stands alone has no sequence."""
    from p2o import simulate

    if options.frames_per_scene == 1:
        return {}
    lidar = [moment.world_from_lidar for moment in moments]
    truths = (truth_at(options, scene_number, at, camera_name) for at in range(len(moments)))
    camera = [pose @ se3.inverse(truth) for pose, truth in zip(lidar, truths, strict=True)]
    noise = {"noise_deg": options.odometry_noise_deg, "noise_m": options.odometry_noise_m}
    lidar_poses, camera_poses = (
        simulate.odometry(poses, _stream(options, _ODOMETRY, scene_number, sensor), **noise)
        for sensor, poses in enumerate((lidar, camera))
    )
    return {
        "sequence": _scene_name(scene_number),
        "time_s": moments[number].time_s,
        "lidar_world_from_lidar": lidar_poses[number],
        "camera_world_from_camera": camera_poses[number],
    }


def _with_boards(
    options: SyntheticOptions, scene: Scene, moment: Moment, scene_number: int, number: int
) -> tuple[Scene, tuple[Board, ...]]:
    """Return the scene with the boards of a frame, and where they are.

    They are placed for the mounting that the documentation tells, whatever the true one is: nothing in the frame but
    the picture depends on that.
    """
    from p2o import simulate

    target = _target(options)
    if target is None:
        return scene, ()
    lidar_from_camera = se3.inverse(camera_from_lidar())
    rig = simulate.Rig(camera_of(options), moment.world_from_lidar @ lidar_from_camera, moment.world_from_lidar)
    seed = (options.seed, _BOARDS, scene_number)
    targets = (target,) * options.boards
    boards, things = simulate.boards_in_view(scene, rig, targets, options.holder, number=number, seed=seed)
    return scene.plus(things), boards


def _target(options: SyntheticOptions) -> Any:
    """Return what the boards are, None for none."""
    from p2o.simulate import target_of

    if options.targets == "none":
        return None
    return target_of(
        options.targets,
        options.board,
        columns=options.columns,
        rows=options.rows,
        square_m=options.square_m,
        hole_radius_m=options.hole_radius_m,
        width_m=options.board_width_m,
        height_m=options.board_height_m,
        radius_m=options.sphere_radius_m,
        size_m=options.box_size_m,
    )


def _travel_m(speed_m_s: float, period_s: float, frames: int) -> float:
    """Return how long a drive is; part of the layout, so that all of up to 10 frames pass through the same place."""
    return speed_m_s * period_s * (10 * -(-frames // 10))


@lru_cache(maxsize=2)
def _drive(
    scene_number: int,
    *,
    seed: int,
    place: str,
    weather: str,
    around: bool,
    speed_m_s: float | None,
    lidar_height_m: float | None,
    frames_per_scene: int,
    period_s: float,
    swing_deg: float,
    tilt_deg: float,
    sway: float,
) -> tuple[Scene, tuple[Moment, ...]]:
    """Return a scene and the drive through it; kept, because frames share them."""
    from p2o import simulate

    layout, shake = (np.random.default_rng([seed, stream, scene_number]) for stream in (_PLACE, _DRIVE))
    drawn = simulate.place_of(place, layout)
    speed_m_s = _USUAL_M_S.get(drawn, _ROAD_M_S) if speed_m_s is None else speed_m_s
    travel = _travel_m(speed_m_s, period_s, frames_per_scene)
    scene, twist = simulate.scene_of(drawn, layout, speed_m_s=speed_m_s, travel_m=travel, around=around)
    drawn_weather = np.random.default_rng([seed, _WEATHER, scene_number])
    scene = simulate.in_weather(scene, simulate.weather_of(weather, drawn_weather), drawn_weather)
    if lidar_height_m is None:
        low, high = _INDOORS_M
        rolled = np.random.default_rng([seed, _HEIGHT, scene_number]).uniform(low, high)
        lidar_height_m = float(rolled) if drawn in simulate.INDOORS else simulate.LIDAR_HEIGHT_M
    swing = simulate.Swing(swing_deg, tilt_deg)
    moments = simulate.drive(
        twist, frames_per_scene, shake, period_s=period_s, height_m=lidar_height_m, sway=sway, swing=swing
    )
    return scene.prepare(), moments


def _seen(
    options: SyntheticOptions, scene: Scene, moment: Moment, truth: Float, weather: Weather, numbers: tuple[int, ...]
) -> tuple[Image, Picture]:
    """Return what the camera sees, as it takes it and before its electronics.

    `numbers` are those of the scene, of its frame and, on a rig, of the camera.
    """
    from p2o import simulate

    camera, world_from_camera = camera_of(options), moment.world_from_lidar @ se3.inverse(truth)
    picture = simulate.render(scene, camera, world_from_camera, moment.time_s)

    grain = _stream(options, _GRAIN, *numbers)
    photo, right_photo = _photos(options, numbers[0], picture, weather)

    def developed(seen: Picture, pose: Float, photo: Any) -> UInt8:
        light = seen.light
        if weather.rain and scene.lighting.inside is None:
            drops = _stream(options, _RAIN, *numbers, int(seen is not picture))
            light = simulate.rained_on(light, seen.depth_m, camera, se3.inverse(pose), weather, drops)
        return simulate.develop(light, photo, grain)

    rgb, right = developed(picture, world_from_camera, photo), None
    if camera.is_pinhole and options.right:
        shifted = world_from_camera @ se3.make(translation=(BASELINE_M, 0.0, 0.0))
        right = developed(simulate.render(scene, camera, shifted, moment.time_s), shifted, right_photo)
    masked = ~picture.seen | picture.foliage if options.mask_foliage else ~picture.seen
    image = Image(
        rgb,
        camera,
        right=right,
        baseline_m=None if right is None else BASELINE_M,
        depth_m=picture.depth_m,
        masked=masked if masked.any() else None,
    )
    return image, picture


def _photos(options: SyntheticOptions, scene_number: int, picture: Picture, weather: Weather) -> tuple[Any, Any]:
    """Return how the left and the right camera take pictures; the right one is a little brighter or darker.

    In weather with little light they are darker and noisier, unless their exposure is given.
    """
    from p2o import simulate

    drawn = _stream(options, _CAMERA, scene_number)
    exposure_ev, mismatch = drawn.uniform(-1.2, 1.5) + weather.exposure_ev, 1 + 0.05 * drawn.normal()
    if options.exposure_ev is not None:
        exposure_ev = options.exposure_ev
    photo = simulate.Photo(
        gain=simulate.metered_gain(picture.light, exposure_ev, whole=options.rig != "fixed"),
        blur_px=options.blur_px,
        vignetting=options.vignetting,
        grain=options.grain * weather.grain,
        jpeg_quality=options.jpeg_quality,
    )
    return photo, photo.brighter(mismatch)


def _lidar(options: SyntheticOptions) -> Any:
    """Return the LiDAR of the options, with what they change about it."""
    from p2o import simulate

    given = {
        "range_noise_m": options.noise_m,
        "max_range_m": options.max_range_m,
        "divergence_mrad": options.divergence_mrad,
    }
    changes: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    return replace(
        simulate.LIDARS[options.lidar], angle_noise_deg=options.angle_noise_deg, keeps=options.keeps, **changes
    )


def _stream(options: SyntheticOptions, purpose: int, *numbers: int) -> np.random.Generator:
    return np.random.default_rng([options.seed, purpose, *numbers])


def _name(options: SyntheticOptions, scene_number: int, number: int, camera: str) -> str:
    in_drive = f"/{number:04d}" if options.frames_per_scene > 1 else ""
    return _scene_name(scene_number) + in_drive + (f"/{camera}" if camera else "")


def _scene_name(scene_number: int) -> str:
    return f"scene-{scene_number:04d}"


def build(options: SyntheticOptions) -> LazyFrames:
    """Return the frames scene-0000, scene-0001, ... or, for drives, scene-0000/0000, scene-0000/0001, ...

    Frames of a rig have the camera's name behind that: scene-0000/front. Each is made when it is asked for, from its
    own seed.

    Raises InputError if drift or start_error cannot be read, a drive is over before its mounting slips, a car that
    stands shall turn, the boards do not hold their pattern or are before a random rig, or the frames are too many or
    too large for memory.
    """
    from p2o.simulate import parse_perturbation

    for text in (options.drift, options.start_error):
        parse_perturbation(text)
    if options.drift_at_frame is not None and options.drift_at_frame >= options.frames_per_scene:
        raise InputError(
            "the mounting slips after the drive is over",
            where="drift_at_frame",
            expected=f"0 to {options.frames_per_scene - 1}",
            got=options.drift_at_frame,
            hint="raise frames_per_scene",
        )
    if (options.swing_deg or options.tilt_deg) and not _most_speed_m_s(options):
        raise InputError(
            "a car that stands does not turn",
            where="swing_deg, tilt_deg",
            expected="speed_m_s > 0",
            got=options.speed_m_s,
            hint="set speed_m_s=5; with targets the car stands unless told",
        )
    if options.targets != "none" and options.rig != "fixed":
        raise InputError(
            "a random rig may look away from the boards",
            where="rig, targets",
            expected="rig=fixed with targets",
            got=f"rig={options.rig}",
        )
    if len(set(options.cameras)) < len(options.cameras):
        raise InputError(
            "a camera is named twice", where="cameras", expected="each once", got=",".join(options.cameras)
        )
    _target(options)
    _require_bounded(options)
    entries = {
        _name(options, scene, number, camera): (scene, number, camera)
        for scene in range(options.scenes)
        for number in range(options.frames_per_scene)
        for camera in options.cameras or ("",)
    }
    return LazyFrames(entries, lambda entry: view(options, *entry).frame)


def _require_bounded(options: SyntheticOptions) -> None:
    """Raise InputError for more frames than can be listed, and drives and pictures that do not fit into memory."""
    frames = options.scenes * options.frames_per_scene * max(1, len(options.cameras))
    if frames > _MOST_FRAMES:
        raise InputError(
            "too many frames", where="scenes, frames_per_scene", expected=f"at most {_MOST_FRAMES} in all", got=frames
        )
    travel_m = _travel_m(_most_speed_m_s(options), options.period_s, options.frames_per_scene)
    megapixels = options.width_px * options.height_px / 1e6 if options.rig == "fixed" else options.megapixels
    needed = _ALWAYS_MB + _PER_METRE_MB * travel_m * min(options.scenes, 2) + _PER_MEGAPIXEL_MB * megapixels
    if needed > _MOST_MB:
        raise InputError(
            "a frame would take too much memory",
            where="frames_per_scene, speed_m_s, period_s, width_px, height_px",
            expected=f"at most {_MOST_MB} MB",
            got=f"about {needed:.0f} MB for drives of {travel_m:.0f} m and pictures of {megapixels:.1f} million pixels",
            hint="make the drive shorter or the picture smaller",
        )


METHOD = Method(
    name="synthetic",
    build=build,
    options=SyntheticOptions,
    summary="Synthetic roads, halls, rooms with exact truth: image, right image, depth, seven LiDARs, targets.",
    gives=frozenset({"right", "depth", "truth", "rings", "intensity", "time", "twist"}),
)
