"""Synthetic roads, halls and rooms with exact ground truth: camera and LiDAR observe the same triangles."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, Any, Literal

import numpy as np
from p2o import Camera, Float, Frame, Image, InputError, Method, Options, UInt8, field, se3
from p2o.reading import LazyFrames, adjoint, parse_perturbation, rotation_of, wrong_start
from pydantic import BeforeValidator, Field

import p2o_sim
from p2o_sim.places.catalog import INDOORS, place_of, scene_of
from p2o_sim.sensing.lidar import Air, Rosette
from p2o_sim.sensing.photo import Photo, develop, metered_gain
from p2o_sim.sensing.rendering import RenderedImage, render
from p2o_sim.sensing.rig_sampling import random_rig, random_vehicle
from p2o_sim.sensing.scanning import sweep
from p2o_sim.sensing.sensors import LIDARS
from p2o_sim.sensing.trajectory import LIDAR_HEIGHT_M, Moment, drive, odometry
from p2o_sim.sensing.weather import Weather, headlights, in_weather, lit_near, rained_on, weather_of
from p2o_sim.things.board_places import Rig, boards_in_view
from p2o_sim.things.boards import TARGETS, Board
from p2o_sim.world.scene import Scene

BASELINE_M = 0.54
_MEGAPIXELS = 2.0
"""Largest images of random rigs, unless the options set another limit."""
_KITTI_MOUNT = (0.27, 0.06, -0.08, 0.458, -0.63, 0.344)
_NOMINAL = (0.0,) * 6
_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
# The memory of a frame, measured in scenes with many trees: a constant, a term per metre of the path (two scenes are
# cached), and a term per million pixels of the image.
_MAX_FRAMES = 100_000
_MAX_MB, _ALWAYS_MB, _PER_METRE_MB, _PER_MEGAPIXEL_MB = 1500, 320, 3.2, 180
# Each purpose has its own stream of random numbers, so that more noise or another camera does not change the scene.
# The number of _PLACE was chosen such that the first scene is a street.
_PLACE, _DRIVE, _LIDAR, _CAMERA, _GRAIN, _START, _DRIFT, _ODOMETRY, _BOARDS = 31, 1, 2, 3, 4, 5, 6, 7, 8
_HEIGHT, _WEATHER, _RAIN, _RIG = 9, 10, 11, 12
_ROAD_M_S = 8.0
_USUAL_M_S = {"hall": 1.0, "room": 0.5}
"""Speeds of rigs on robots, in contrast to cars on roads."""
_OF_DRIVE = {
    "seed", "place", "weather", "rig", "speed_m_s", "lidar_height_m", "frames_per_scene", "sweep_s", "period_s",
    "swing_deg", "tilt_deg", "sway",
}  # fmt: skip
"""Options on which a scene and the drive through it depend."""
_INDOORS_M = (0.6, 1.4)
"""Range of LiDAR heights on robots in halls and rooms."""


_Shift = Annotated[float, Field(ge=-100, le=100)]
_Turn = Annotated[float, Field(ge=-360, le=360)]
_Word = Literal["front", "left", "right", "back", "back-left", "back-right"]
_TO_THE_LEFT_DEG: dict[str, float] = {
    "": 0, "front": 0, "left": 60, "right": -60, "back": 180, "back-left": 120, "back-right": -120
}  # fmt: skip
"""Yaw of the mounting of each camera of a rig, to the left about the vertical axis of the LiDAR."""


def _words(value: Any) -> Any:
    return tuple(value.split(",")) if isinstance(value, str) else value


class SyntheticOptions(Options):
    """Options of the data set `synthetic`."""

    scenes: int = field(1, ge=1, le=100_000, help="Number of scenes; each gives one frame, or a drive.")
    frames_per_scene: int = field(1, ge=1, le=1000, help="Number of frames of the drive through each scene.")
    period_s: float = field(0.1, gt=0, le=60, help="Time between successive frames of a drive in seconds.")
    seed: int = field(0, ge=0, lt=2**63, help="Seed of the scenes, of all noise and of the initial guess.")
    place: Literal[
        "mixed", "anywhere", "street", "suburb", "highway", "trees", "varied", "yard", "hall", "room",
        "repeated", "empty", "traffic",
    ] = field(
        "mixed",
        help="Kind of scene; mixed draws a road for each scene, a third of them with trees and banks; anywhere draws "
        "from roads, a yard (an open floor between halls, for boards), and inside a hall or a room; varied is a road "
        "with vehicles, walls, plants and posts close by, for training. Difficult: equal houses, "
        "fences or parked cars in rows (repeated), an empty road, and one with traffic alone.",
    )  # fmt: skip
    weather: Literal["clear", "overcast", "rain", "fog", "night", "any"] = field(
        "clear", help="Weather of image and sweep, through windows in halls and rooms; any draws one for each scene."
    )
    speed_m_s: float | None = field(
        None, ge=0, le=60, help="Speed in m/s, similar for traffic; null: 8, halls 1, rooms 0.5, with targets 0."
    )
    lidar_height_m: float | None = field(
        None, ge=0.2, le=10, help="Height of the LiDAR in m; null: 1.73, in halls and rooms drawn from 0.6 to 1.4."
    )
    swing_deg: float = field(0.0, ge=0, le=60, help="Largest yaw of the vehicle to both sides of its road in degrees.")
    tilt_deg: float = field(0.0, ge=0, le=20, help="Largest pitch and roll on uneven ground in degrees.")
    sway: float = field(
        1.0, ge=0, le=10, help="Variation of the pose between frames, times 0.3 degrees and 5 cm; 0: one smooth path."
    )
    odometry_noise_deg: float = field(0.0, ge=0, le=10, help="Sigma of each odometry step in degrees per axis.")
    odometry_noise_m: float = field(0.0, ge=0, le=10, help="Sigma of each odometry step in metres per axis.")
    targets: Literal["none", "checkerboard", "holes", "sphere", "box"] = field(
        "none", help="Boards, spheres or boxes ahead, in another pose in each frame; frames state their sizes."
    )
    boards: int = field(1, ge=1, le=8, help="Number of targets in view, of one kind; bodies differ by colour.")
    holder: Literal["person", "stand"] = field("person", help="Holder of each board; bodies are always on a pole.")
    board: Literal["a0", "a1", "a2"] = field("a0", help="Paper size of boards; bodies are about as large.")
    rig: Literal["fixed", "random", "random-rings", "random-vehicle"] = field(
        "fixed",
        help="random draws camera, width_px, height_px, focal_px, mount, lidar and initial guess for each scene; "
        "random-rings only LiDARs with rings, random-vehicle also their height, with cameras that mostly look ahead; "
        "fixed uses the other options.",
    )
    megapixels: float | None = field(
        None,
        ge=0.01,
        le=6,
        help="Larger images, and their focal lengths, are reduced to it; null: 2 for random rigs, else no limit.",
    )
    camera: Literal["pinhole", "opencv-distorted", "fisheye"] = field(
        "pinhole", help="Camera model: KITTI-like pinhole with a right image, distorted OPENCV, or OPENCV_FISHEYE."
    )
    width_px: int = field(1242, ge=64, le=8192, help="Width of the image; scales the focal length unless it is given.")
    height_px: int = field(375, ge=64, le=8192, help="Height of the image, and thus the vertical field of view.")
    focal_px: float | None = field(
        None, ge=50, le=10_000, help="Focal length in px; null: 0.581 of the width (as KITTI), 0.386 for a fisheye."
    )
    exposure_ev: float | None = field(
        None, ge=-8, le=8, help="Overexposure (+) or underexposure (-) in stops; null draws -1.2 to 1.5."
    )
    grain: float = field(2.0, ge=0, le=64, help="Read noise in grey levels of 255; shot noise is proportional to it.")
    blur_px: float = field(0.5, ge=0, le=20, help="Standard deviation of the lens blur in pixels.")
    vignetting: float = field(0.3, ge=0, le=1, help="Share of light that is lost in the corners of the image.")
    jpeg_quality: int = field(95, ge=0, le=100, help="Quality of JPEG compression, 0 for no compression.")
    right: bool = field(True, help="Whether a pinhole camera has a right image.")
    lidar: Literal[
        "hdl-64e", "hdl-32e", "vlp-16", "os1-64", "os1-128", "pandar64", "mid-40", "avia", "mid-360"
    ] = field(
        "hdl-64e", help="Model of the LiDAR; mid-40, avia and mid-360 have no rings, all others rotate."
    )  # fmt: skip
    sweep_s: Annotated[float, Field(ge=0.01, le=10)] | None = field(
        None, help="Duration of a sweep of a LiDAR without rings in seconds, around the time of the image; null: 0.1."
    )
    noise_m: float | None = field(None, ge=0, le=1, help="Standard deviation of the range in m; null: of the model.")
    angle_noise_deg: float = field(0.02, ge=0, le=5, help="Standard deviation of the angles of each beam in degrees.")
    divergence_mrad: float | None = field(
        None, ge=0, le=50, help="Full divergence of a beam in mrad; null: of the model, 0: a ray."
    )
    keeps: Literal["strongest", "first"] = field("strongest", help="Return of a pulse that hits several surfaces.")
    deskew: bool = field(True, help="Compensate the sweep for the motion of the vehicle, which is known exactly.")
    mount: tuple[_Shift, _Shift, _Shift, _Turn, _Turn, _Turn] = field(
        _KITTI_MOUNT,
        help="Camera in the LiDAR frame: x, y, z in metres, then pitch, yaw, roll in degrees from straight ahead.",
    )
    cameras: Annotated[tuple[_Word, ...], BeforeValidator(_words)] = field(
        (),
        max_length=6,
        help="Cameras of a rig, such as front,left,right: each time gives a frame per camera, with one sweep, and "
        "`mount` turned about the LiDAR by 60 degrees to the left or right, 120 (back-left) or 180; none: one camera.",
    )
    lidar_at: Annotated[tuple[_Shift, _Shift, _Shift, _Turn, _Turn, _Turn], BeforeValidator(_words)] = field(
        _NOMINAL,
        help="Another place of the LiDAR on the vehicle, in its nominal frame: x, y, z in metres, then roll, pitch, "
        "yaw in degrees; scene and cameras stay as they are, so that several data sets simulate several LiDARs.",
    )
    drift: str = field("0.5deg 0.03m", help="Size of the change of the camera's mounting, as for --perturb.")
    drift_at_frame: int | None = field(
        None, ge=0, help="First frame of each drive with the changed mounting; null: never."
    )
    start_error: str = field(
        "2deg 0.15m", help="Error of the initial guess, the same for all frames; --perturb draws one for each frame."
    )
    mask_foliage: bool = field(False, help="Mask pixels with leaves, so that extractors ignore their edges.")


@dataclass(frozen=True, eq=False)
class View:
    """A frame with its ground truth: `scene`, `moment`, `rendered` image and `boards`."""

    frame: Frame
    scene: Scene
    moment: Moment
    rendered: RenderedImage
    boards: tuple[Board, ...] = ()


def camera_from_lidar(mount: tuple[float, ...] = _KITTI_MOUNT) -> Float:
    """Return the extrinsic (4, 4) of a mounting: x, y, z in metres; pitch, yaw, roll in degrees in camera axes."""
    turn = np.radians([mount[3], mount[4], mount[5]])
    rotation = se3.exp(np.concatenate([turn, np.zeros(3)]))[:3, :3] @ _AXES
    return se3.make(rotation, -rotation @ np.array(mount[:3]))


def camera_of(options: SyntheticOptions) -> Camera:
    """Return the camera of the options, in proportion to KITTI's 1242x375 px with a focal length of 721.5 px.

    `focal_px` only changes the focal length, neither the principal point nor the distortion as a function of the angle.
    """
    width, height = options.width_px, options.height_px
    scale = width / 1242
    focal = (480.0 if options.camera == "fisheye" else 721.5) * scale if options.focal_px is None else options.focal_px
    tall = 722.5 * scale if options.focal_px is None else options.focal_px * 722.5 / 721.5
    cx, cy = (609.6 + 0.5) * scale - 0.5, (172.9 + 0.5) * height / 375 - 0.5
    if options.camera == "pinhole":
        return Camera.pinhole(focal, focal, cx, cy, width, height)
    if options.camera == "opencv-distorted":
        return Camera("OPENCV", width, height, (focal, tall, cx, cy, -0.28, 0.08, 0.001, -0.0015))
    return Camera("OPENCV_FISHEYE", width, height, (focal, focal, cx, cy, 0.02, -0.006, 0.001, -0.0002))


def body_from_lidar(options: SyntheticOptions) -> Float:
    """Return the pose (4, 4) of the LiDAR in its nominal frame, the body: roll, pitch, yaw about fixed axes."""
    return se3.make(rotation_of(*np.radians(options.lidar_at[3:])), options.lidar_at[:3])


def truth_at(options: SyntheticOptions, scene: int, number: int, camera: str = "") -> Float:
    """Return the true extrinsic (4, 4) of frame `number` of a scene, which changes at `drift_at_frame`."""
    truth = _camera_from_body(options, scene, number, camera)
    return truth if options.lidar_at == _NOMINAL else truth @ body_from_lidar(options)


def _camera_from_body(options: SyntheticOptions, scene: int, number: int, camera: str) -> Float:
    options = _with_rig(options, scene)
    about_z = np.radians([0, 0, -_TO_THE_LEFT_DEG[camera], 0, 0, 0])
    truth = camera_from_lidar(options.mount) @ se3.exp(about_z)
    if options.drift_at_frame is None or number < options.drift_at_frame:
        return truth
    return _displaced(truth, options.drift, _stream(options, _DRIFT, scene))


def _with_rig(options: SyntheticOptions, scene_number: int) -> SyntheticOptions:
    """Return the options with the rig of a scene: with images of at most `megapixels`, or drawn for the scene."""
    if options.rig == "fixed":
        return _reduced(options)
    rng = _stream(options, _RIG, scene_number)
    limit = _MEGAPIXELS if options.megapixels is None else options.megapixels
    if options.rig == "random-vehicle":
        drawn = random_vehicle(rng, megapixels=limit)
        return options.model_copy(update={**drawn, "lidar_height_m": float(rng.uniform(1.3, 2.6))})
    drawn = random_rig(rng, megapixels=limit, rings=options.rig == "random-rings")
    return options.model_copy(update=drawn)


def _reduced(options: SyntheticOptions) -> SyntheticOptions:
    """Return the options of a fixed rig with the image size, and the focal length if given, reduced to `megapixels`."""
    most, width, height = options.megapixels, options.width_px, options.height_px
    if most is None or width * height <= most * 1e6:
        return options
    scale = np.sqrt(most * 1e6 / (width * height))
    update = {"width_px": max(64, round(width * scale)), "height_px": max(64, round(height * scale))}
    focal_px = None if options.focal_px is None else options.focal_px * update["width_px"] / width
    return options.model_copy(update={**update, "focal_px": focal_px, "megapixels": None})


def _displaced(truth: Float, size: str, rng: np.random.Generator) -> Float:
    """Return the pose (4, 4) displaced by a size such as "2deg 0.15m" in a random direction."""
    wanted = parse_perturbation(size)
    return wrong_start(truth, wanted.angle_deg, wanted.distance_m, rng)


def view(options: SyntheticOptions, scene_number: int, number: int = 0, camera: str = "") -> View:
    """Return frame `number` of a scene with its ground truth, for one of `cameras` if there are several.

    The same options give identical frames.
    """
    options = _with_rig(options, scene_number)
    weather = weather_of(options.weather, _stream(options, _WEATHER, scene_number))
    static = {"speed_m_s": 0.0, "sway": 0.0} if options.targets != "none" and not options.speed_m_s else {}
    of_drive = SyntheticOptions(**{**options.model_dump(include=_OF_DRIVE), **static})
    scene, moments = _drive(of_drive, scene_number)
    moment, truth = moments[number], _camera_from_body(options, scene_number, number, camera)
    if weather.name == "night":
        # A robot in a building has no headlights.
        height_m = LIDAR_HEIGHT_M if options.lidar_height_m is None else options.lidar_height_m
        own = () if scene.lighting.inside else headlights(moment.world_from_lidar, height_m)
        scene = lit_near(scene, moment.world_from_lidar, own)
    scene, boards = _with_boards(options, scene, moment, scene_number, number)
    # In parallel with the image, because each of them has phases that use a single core.
    with ThreadPoolExecutor(1) as pool:
        sensor = _moved(moment, options)
        noise = _stream(options, _LIDAR, scene_number, number, *_place_numbers(options))
        air = weather.air if scene.lighting.inside is None else Air()
        motion: dict[str, Any] = {"twist": sensor.twist, "time_s": sensor.time_s}
        future = pool.submit(sweep, scene, _lidar(options), sensor.world_from_lidar, noise, air=air, **motion)
        # Each camera of a rig has its own image noise.
        numbers = (scene_number, number, *([options.cameras.index(camera)] if camera else []))
        image, rendered = _images(options, scene, moment, truth, weather, numbers)
        cloud = future.result()
    # A random rig has another initial guess in each scene.
    start = _stream(options, _START, *(() if options.rig == "fixed" else (scene_number,)))
    truth = truth_at(options, scene_number, number, camera)
    frame = Frame(
        _name(options, scene_number, number, camera),
        image,
        cloud.untwisted(sensor.twist) if options.deskew else cloud,
        camera_from_lidar=truth,
        start=_displaced(truth, options.start_error, start),
        twist=sensor.twist,
        targets=tuple(board.target for board in boards),
        camera_name=camera,
        **_of_drive(options, moments, scene_number, number, camera),
    )
    return View(frame, scene, sensor, rendered, boards)


def _moved(moment: Moment, options: SyntheticOptions) -> Moment:
    """Return the moment of the LiDAR at its place on the body, whose moment this is."""
    if options.lidar_at == _NOMINAL:
        return moment
    place = body_from_lidar(options)
    twist = adjoint(se3.inverse(place), moment.twist)
    return replace(moment, world_from_lidar=moment.world_from_lidar @ place, twist=twist)


def _place_numbers(options: SyntheticOptions) -> tuple[int, ...]:
    """Return numbers of the place of the LiDAR, so that each LiDAR of a body has its own noise; none if nominal."""
    if options.lidar_at == _NOMINAL:
        return ()
    return tuple(int(number) for number in np.array(options.lidar_at, np.float64).view(np.uint32))


def frame(options: SyntheticOptions, scene_number: int, number: int = 0, camera: str = "") -> Frame:
    """Return frame `number` of a scene, for one of `cameras` if there are several."""
    return view(options, scene_number, number, camera).frame


def _most_speed_m_s(options: SyntheticOptions) -> float:
    """Return the speed of the options, the largest possible one if it depends on the drawn kind of scene."""
    if options.speed_m_s is None:
        return _USUAL_M_S.get(options.place, _ROAD_M_S) if options.targets == "none" else 0.0
    return options.speed_m_s


def _of_drive(
    options: SyntheticOptions, moments: tuple[Moment, ...], scene_number: int, number: int, camera_name: str
) -> dict[str, Any]:
    """Return the data of a frame that depend on its drive; empty for a single frame."""
    if options.frames_per_scene == 1:
        return {}
    lidar = [_moved(moment, options).world_from_lidar for moment in moments]
    truths = (truth_at(options, scene_number, at, camera_name) for at in range(len(moments)))
    camera = [pose @ se3.inverse(truth) for pose, truth in zip(lidar, truths, strict=True)]
    noise = {"noise_deg": options.odometry_noise_deg, "noise_m": options.odometry_noise_m}
    lidar_poses, camera_poses = (
        odometry(poses, _stream(options, _ODOMETRY, scene_number, sensor), **noise)
        for sensor, poses in enumerate((lidar, camera))
    )
    return {
        "sequence": f"scene-{scene_number:04d}",
        "time_s": moments[number].time_s,
        "lidar_world_from_lidar": lidar_poses[number],
        "camera_world_from_camera": camera_poses[number],
    }


def _with_boards(
    options: SyntheticOptions, scene: Scene, moment: Moment, scene_number: int, number: int
) -> tuple[Scene, tuple[Board, ...]]:
    """Return the scene with the boards of a frame, and the boards."""
    # Placed for the nominal mounting, not the true one, so that only the image depends on the latter.
    if options.targets == "none":
        return scene, ()
    lidar_from_camera = se3.inverse(camera_from_lidar())
    rig = Rig(camera_of(options), moment.world_from_lidar @ lidar_from_camera, moment.world_from_lidar)
    targets = (TARGETS[options.targets][options.board],) * options.boards
    seed = (options.seed, _BOARDS, scene_number)
    boards, things = boards_in_view(scene, rig, targets, options.holder, number=number, seed=seed)
    return scene.plus(things), boards


def _travel_m(speed_m_s: float, options: SyntheticOptions) -> float:
    """Return the length of a drive, rounded up to multiples of 10 frames, so that shorter drives share a layout.

    The duration `sweep_s` of a long sweep is added.
    """
    rounded = 10 * -(-options.frames_per_scene // 10)
    return speed_m_s * (options.period_s * rounded + (options.sweep_s or 0.0))


@lru_cache(maxsize=2)
def _drive(options: SyntheticOptions, scene_number: int) -> tuple[Scene, tuple[Moment, ...]]:
    """Return a scene and the drive through it; cached for the frames of a drive, which have the same _OF_DRIVE."""
    layout, shake = (_stream(options, purpose, scene_number) for purpose in (_PLACE, _DRIVE))
    drawn = place_of(options.place, layout)
    speed_m_s = _USUAL_M_S.get(drawn, _ROAD_M_S) if options.speed_m_s is None else options.speed_m_s
    travel = _travel_m(speed_m_s, options)
    around = options.rig != "fixed"
    scene, twist = scene_of(drawn, layout, speed_m_s=speed_m_s, travel_m=travel, around=around)
    drawn_weather = _stream(options, _WEATHER, scene_number)
    scene = in_weather(scene, weather_of(options.weather, drawn_weather), drawn_weather)
    height_m = options.lidar_height_m
    if height_m is None:
        rolled = _stream(options, _HEIGHT, scene_number).uniform(*_INDOORS_M)
        height_m = float(rolled) if drawn in INDOORS else LIDAR_HEIGHT_M
    motion = options.model_dump(include={"period_s", "sway", "swing_deg", "tilt_deg"})
    return scene.prepare(), drive(twist, options.frames_per_scene, shake, height_m=height_m, **motion)


def _images(
    options: SyntheticOptions, scene: Scene, moment: Moment, truth: Float, weather: Weather, numbers: tuple[int, ...]
) -> tuple[Image, RenderedImage]:
    """Return the image and its rendering; `numbers` are those of scene, frame and, on a rig, camera."""
    camera, world_from_camera = camera_of(options), moment.world_from_lidar @ se3.inverse(truth)
    rendered = render(scene, camera, world_from_camera, moment.time_s)

    grain = _stream(options, _GRAIN, *numbers)
    photo, right_photo = _photos(options, numbers[0], rendered, weather)

    def developed(source: RenderedImage, pose: Float, photo: Any) -> UInt8:
        light = source.light
        if weather.rain and scene.lighting.inside is None:
            drops = _stream(options, _RAIN, *numbers, int(source is not rendered))
            light = rained_on(light, source.depth_m, camera, se3.inverse(pose), weather, drops)
        return develop(light, photo, grain)

    rgb, right = developed(rendered, world_from_camera, photo), None
    if camera.is_pinhole and options.right:
        shifted = world_from_camera @ se3.make(translation=(BASELINE_M, 0.0, 0.0))
        right = developed(render(scene, camera, shifted, moment.time_s), shifted, right_photo)
    masked = ~rendered.seen | rendered.foliage if options.mask_foliage else ~rendered.seen
    baseline_m = None if right is None else BASELINE_M
    image = Image(rgb, camera, right, baseline_m, rendered.depth_m, masked if masked.any() else None)
    return image, rendered


def _photos(options: SyntheticOptions, scene_number: int, rendered: RenderedImage, weather: Weather) -> tuple[Any, Any]:
    """Return the settings of the left and right camera, which differ slightly; little light makes them darker."""
    drawn = _stream(options, _CAMERA, scene_number)
    exposure_ev, mismatch = drawn.uniform(-1.2, 1.5) + weather.exposure_ev, 1 + 0.05 * drawn.normal()
    if options.exposure_ev is not None:
        exposure_ev = options.exposure_ev
    gain = metered_gain(rendered.light, exposure_ev, whole=options.rig != "fixed")
    lens = options.model_dump(include={"blur_px", "vignetting", "jpeg_quality"})
    photo = Photo(gain=gain, grain=options.grain * weather.grain, **lens)
    return photo, replace(photo, gain=photo.gain * mismatch)


def _lidar(options: SyntheticOptions) -> Any:
    """Return the LiDAR of the options, with the modified parameters."""
    given = options.model_dump(include={"divergence_mrad", "angle_noise_deg", "keeps", "sweep_s"})
    given["range_noise_m"] = options.noise_m
    return replace(LIDARS[options.lidar], **{name: value for name, value in given.items() if value is not None})


def _stream(options: SyntheticOptions, purpose: int, *numbers: int) -> np.random.Generator:
    return np.random.default_rng([options.seed, purpose, *numbers])


def _name(options: SyntheticOptions, scene_number: int, number: int, camera: str) -> str:
    in_drive = f"/{number:04d}" if options.frames_per_scene > 1 else ""
    return f"scene-{scene_number:04d}" + in_drive + (f"/{camera}" if camera else "")


def build(options: SyntheticOptions) -> LazyFrames:
    """Return the frames scene-0000, scene-0001, ... or, for drives, scene-0000/0000, scene-0000/0001, ...

    The camera's name is appended for rigs: scene-0000/front. Each frame is rendered on demand from its own seed.

    Raises InputError for invalid drift or start_error, for contradictory options, and for frames that are too many or
    too large for memory.
    """
    for text in (options.drift, options.start_error):
        parse_perturbation(text)
    if options.drift_at_frame is not None and options.drift_at_frame >= options.frames_per_scene:
        fault, last = "the mounting changes after the end of the drive", options.frames_per_scene - 1
        late, hint = options.drift_at_frame, "raise frames_per_scene"
        raise InputError(fault, where="drift_at_frame", expected=f"0 to {last}", got=late, hint=hint)
    if (options.swing_deg or options.tilt_deg) and not _most_speed_m_s(options):
        fault = "a static vehicle does not turn"
        hint = "set speed_m_s=5; with targets the vehicle is static by default"
        raise InputError(fault, where="swing_deg, tilt_deg", expected="speed_m_s > 0", got=options.speed_m_s, hint=hint)
    if options.targets != "none" and options.rig != "fixed":
        fault = "a random rig may not observe the boards"
        raise InputError(fault, where="rig, targets", expected="rig=fixed with targets", got=f"rig={options.rig}")
    rosette = options.rig == "fixed" and isinstance(LIDARS[options.lidar], Rosette)
    if options.sweep_s is not None and not rosette:
        fault = "the duration of a revolution is that of the model"
        got = f"lidar={options.lidar}, rig={options.rig}"
        raise InputError(fault, where="sweep_s", expected="lidar=mid-40, avia or mid-360 of a fixed rig", got=got)
    if len(set(options.cameras)) < len(options.cameras):
        names = ",".join(options.cameras)
        raise InputError("a camera is named twice", where="cameras", expected="each once", got=names)
    _require_bounded(options)
    entries = {
        _name(options, scene, number, camera): (scene, number, camera)
        for scene in range(options.scenes)
        for number in range(options.frames_per_scene)
        for camera in options.cameras or ("",)
    }
    # `scenes` is the number of scenes only. A new option whose default changes no frame leaves all identities.
    recipe = options.model_dump(mode="json", exclude={"scenes"}, exclude_defaults=True)
    identity = {"version": p2o_sim.VERSION, "options": recipe}
    return LazyFrames(
        entries, lambda entry: frame(options, *entry), identify=lambda entry: {**identity, "entry": list(entry)}
    )


def _require_bounded(options: SyntheticOptions) -> None:
    """Raise InputError for too many frames, and for drives and images that do not fit into memory."""
    frames = options.scenes * options.frames_per_scene * max(1, len(options.cameras))
    if frames > _MAX_FRAMES:
        limit = f"at most {_MAX_FRAMES} in all"
        raise InputError("too many frames", where="scenes, frames_per_scene", expected=limit, got=frames)
    travel_m = _travel_m(_most_speed_m_s(options), options)
    most, drawn = options.megapixels or np.inf, options.megapixels or _MEGAPIXELS
    megapixels = min(options.width_px * options.height_px / 1e6, most) if options.rig == "fixed" else drawn
    needed = _ALWAYS_MB + _PER_METRE_MB * travel_m * min(options.scenes, 2) + _PER_MEGAPIXEL_MB * megapixels
    if needed > _MAX_MB:
        fault, expected = "a frame would take too much memory", f"at most {_MAX_MB} MB"
        where = "frames_per_scene, speed_m_s, period_s, width_px, height_px"
        hint = "make the drive shorter or the image smaller"
        got = f"about {needed:.0f} MB for drives of {travel_m:.0f} m and images of {megapixels:.1f} million pixels"
        raise InputError(fault, where=where, expected=expected, got=got, hint=hint)


METHOD = Method(
    name="synthetic",
    build=build,
    options=SyntheticOptions,
    summary="Synthetic roads, halls and rooms: image, right image, depth, nine LiDARs, targets, exact ground truth.",
    gives=frozenset({"right", "depth", "truth", "rings", "intensity", "time", "twist"}),
)
