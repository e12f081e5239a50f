# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of `tactile_sim`, in groups. A group refuses a value by ValueError."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.documents import value_text
from dotsim_ros.io.quantity import check_fields, check_value, quantities_of, quantity
from dotsim_ros.nodes.common.parameters import CONFIGURED, FREE, READ_ONLY
from dotsim_ros.nodes.simulated_time.latency import LONGEST_S, check_quantiles
from dotsim_ros.nodes.tactile_sim.framing import KEEP, STRETCH
from dotsim_ros.nodes.tactile_sim.profiles import BY_CLOCK, NAMES, resolve_profile
from dotsim_ros.specification import NoiseSpecification, SolverSpecification

REALTIME, LOCKSTEP = "realtime", "lockstep"
POSE, TWIST, ANY = "pose", "twist", "any"
BY_POSE, BY_FORCE = "pose", "force"
TOPIC, TF, ODOMETRY = "topic", "tf", "odometry"
TWIST_STAMPED, TWIST_PLAIN = "TwistStamped", "Twist"
AXIAL, RANGE = "z", "range"
LARGEST_GRID_M = quantities_of(SolverSpecification)["grid_spacing_m"][1].high
LARGEST_NOISE_LEVELS = quantities_of(NoiseSpecification)["deviation_levels"][1].high
SENSORS_OWN = -1.0


@dataclass(frozen=True)
class SensorParameters:
    """What is simulated, and how accurately."""

    FIXED: ClassVar[str] = CONFIGURED

    sensor: str = quantity("densetact2")
    """Sensor to simulate: a name below params/sensors, or the path of a YAML file."""
    device: str = quantity("cpu")
    """Where the gel is computed: cpu, or cuda; cuda:1 is the second GPU."""
    indenter: str = quantity("sphere_4mm", fixed=FREE)
    """What presses: a name below params/indenters, the path of an STL, OBJ, PLY or YAML file, or a
    definition such as 'sphere(radius_m=0.003)' or 'mesh(path=screw.stl, scale=0.001)'."""
    profile: str = quantity(BY_CLOCK, choices=NAMES)
    """How accurately the gel is solved: exact (the sensor's own solver, any motion in a frame),
    realtime, fast (a coarser grid), or auto (the finest that the machine affords); by_clock:
    realtime, and in lockstep, which takes no other, exact. docs/run.md lists the errors."""
    grid_spacing_m: float = quantity(0.0, low=0.0, high=LARGEST_GRID_M)
    """Spacing of the gel's grid in place of the sensor's own, in every profile, for a rate that
    this machine does not reach otherwise; 0: as in the sensor's file. docs/gel.md says what it
    costs."""
    idle_image: str = quantity("", is_path=True)
    """Image of the real sensor at rest, to be carried by the gel; a YAML file of its name next to
    it may describe it. Empty: the sensor's own."""
    effects: str = quantity("", is_path=True, fixed=READ_ONLY)
    """Overlay of effects to add to the sensor, a YAML file that find_gap wrote. Empty: none."""
    effects_folder: str = quantity("", is_path=True, fixed=READ_ONLY)
    """Folder of effects of your own that the overlay may name, one a Python file: the files of
    those that it names are run as programs. Empty: those shipped."""

    def __post_init__(self) -> None:
        check_fields("", self)
        if not re.fullmatch("cpu|cuda(:[0-9]{1,3})?", self.device):
            raise ValueError(f"device is {value_text(self.device)}, expected cpu or cuda")
        if self.grid_spacing_m != 0.0:
            spacing, name = self.grid_spacing_m, "grid_spacing_m"
            check_value(SolverSpecification, name, spacing, called=name)
        if self.effects_folder and not self.effects:
            raise ValueError(
                f"effects_folder is {self.effects_folder!r}, but no overlay names an effect of it: "
                "set the parameter effects, too"
            )


@dataclass(frozen=True)
class TimeParameters:
    """When frames are made, stamped and published."""

    FIXED: ClassVar[str] = CONFIGURED

    clock: str = quantity(REALTIME, choices=(REALTIME, LOCKSTEP))
    """realtime: frames at rate_hz from the newest pose; lockstep: one frame for each pose, with its
    stamp."""
    rate_hz: float = quantity(25.0, low=0.5, high=240.0, fixed=FREE)
    """Frames per second of the real-time clock."""
    exposure_s: float = quantity(0.0, low=0.0, high=0.5)
    """In simulated time: how long the camera exposes; a frame's stamp is the middle of that, so
    that half of it is over before anything is read out."""
    image_latency_s: tuple[float, ...] = quantity((0.0,), low=0.0, high=LONGEST_S, any_length=True)
    """In simulated time: from the end of the exposure until a frame is published: one delay, or
    evenly spaced quantiles of it, the smallest first."""
    latency_seed: int = quantity(0, low=0, high=2**31 - 1)
    """Seed of image_latency_s."""
    diagnostics_period_s: float = quantity(1.0, low=0.05, high=60.0)
    """Time between diagnostics."""

    def __post_init__(self) -> None:
        check_fields("", self)
        check_quantiles("image_latency_s", self.image_latency_s)

    @property
    def is_realtime(self) -> bool:
        """Whether frames are made at a rate, from the newest pose; else one for each pose."""
        return self.clock == REALTIME


@dataclass(frozen=True)
class MotionParameters:
    """What moves the indenter, and how far and fast that may be."""

    FIXED: ClassVar[str] = FREE

    input: str = quantity(ANY, choices=(POSE, TWIST, ANY), fixed=CONFIGURED)
    """Which input moves the indenter; any: whichever speaks first, the other one is refused while
    it goes on."""
    control: str = quantity(BY_POSE, choices=(BY_POSE, BY_FORCE), fixed=READ_ONLY)
    """What says how deep the indenter presses. pose: its pose; force: the normal force on
    indenter/wrench, along the indenter's z axis, where the pose says all but the depth."""
    pose_source: str = quantity(TOPIC, choices=(TOPIC, TF, ODOMETRY), fixed=CONFIGURED)
    """Where the pose comes from. topic: indenter/pose; odometry: indenter/odometry; tf: the place
    of indenter_frame in base_frame on /tf and /tf_static. docs/simulators.md."""
    twist_message: str = quantity(
        TWIST_STAMPED, choices=(TWIST_STAMPED, TWIST_PLAIN), fixed=CONFIGURED
    )
    """Type of indenter/twist."""
    input_timeout_s: float = quantity(0.5, low=0.02, high=3600.0)
    """After this long without a message a velocity counts as zero, the other input may take over,
    and the diagnostics warn."""
    maximum_jump_m: float = quantity(0.01, low=1e-4, high=10.0)
    """A pose further than this from the one before is a new start, not a motion through what lies
    between."""
    maximum_lag_m: float = quantity(0.001, low=1e-5, high=10.0)
    """An indenter that a frame shows further than this from its newest pose is warned of: it lags
    behind since it moves faster than frames can follow in contact."""
    maximum_step_s: float = quantity(1.0, low=1e-3, high=1e6)
    """Stamps that step back by more than this are a new start (a bag played again); by less, the
    pose is out of order and refused."""
    start_position_m: tuple[float, float, float] = quantity((0.0, 0.0, 0.03), low=-10.0, high=10.0)
    """Where the indenter starts under velocity input."""
    start_quaternion_xyzw: tuple[float, float, float, float] = quantity(
        (0.0, 0.0, 0.0, 1.0), low=-1.0, high=1.0
    )
    """How it is turned there."""

    def __post_init__(self) -> None:
        check_fields("", self)
        self.start_pose()
        if self.pose_source != TOPIC and self.input == TWIST:
            raise ValueError(
                f"pose_source is {self.pose_source}, but input is {TWIST}, which reads no pose: "
                f"set input to {POSE}"
            )

    def start_pose(self) -> Pose:
        """Return where the indenter starts under velocity input.

        Raises:
            ValueError: the quaternion is not of unit length.
        """
        try:
            return Pose(np.array(self.start_position_m), np.array(self.start_quaternion_xyzw))
        except ValueError as error:
            raise ValueError(f"start_quaternion_xyzw: {error}") from None


@dataclass(frozen=True)
class FrameParameters:
    """Names of frames."""

    FIXED: ClassVar[str] = CONFIGURED

    frame_prefix: str = quantity("")
    """Put before base_frame, optical_frame and indenter_frame, such as left_ for one of two
    sensors."""
    base_frame: str = quantity("densetact_base")
    """Frame of poses, skin and wrench."""
    optical_frame: str = quantity("densetact_optical_frame")
    """Frame of the images and the depth."""
    indenter_frame: str = quantity("indenter")
    """Frame of the indenter: of velocities along its axes, of pose_source tf and odometry, and of
    its external wrench."""
    world_frame: str = quantity("")
    """With pose_source tf: the frame of Gazebo's world, for entity_wrench. Empty: the axes of
    base_frame are the world's."""
    publish_tf: bool = quantity(True)
    """Publish the camera's place in the base frame on /tf_static, where tf2_ros is installed."""

    def __post_init__(self) -> None:
        check_fields("", self)
        frames = (self.base_frame, self.optical_frame, self.indenter_frame)
        if "" in frames or len(set(frames)) < 3:
            raise ValueError(
                f"base_frame, optical_frame and indenter_frame are {frames}: they must differ and "
                "must not be empty"
            )
        if self.world_frame in (self.base_frame, self.indenter_frame):
            raise ValueError(
                f"world_frame is {value_text(self.world_frame)}, as base_frame or indenter_frame "
                "is: expected another frame, or none"
            )

    def prefixed(self) -> FrameParameters:
        """Return the same with the names of frames as they are published."""
        return replace(
            self,
            frame_prefix="",
            base_frame=f"{self.frame_prefix}{self.base_frame}",
            optical_frame=f"{self.frame_prefix}{self.optical_frame}",
            indenter_frame=f"{self.frame_prefix}{self.indenter_frame}",
        )


@dataclass(frozen=True)
class LinkParameters:
    """Gazebo's links that get the wrench."""

    FIXED: ClassVar[str] = CONFIGURED

    entity_indenter: str = quantity("")
    """Gazebo's name of the link that presses, such as peg::link; its wrench goes out on
    entity_wrench. Empty: none."""
    entity_indenter_centre_m: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0), low=-10.0, high=10.0
    )
    """Centre of mass of that link in indenter_frame: Gazebo lets forces act there."""
    entity_sensor: str = quantity("")
    """The same of the link that carries the sensor. Empty: none."""
    entity_sensor_centre_m: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0), low=-10.0, high=10.0
    )
    """Centre of mass of that link in base_frame."""

    def __post_init__(self) -> None:
        check_fields("", self)


@dataclass(frozen=True)
class TopicParameters:
    """Names of what is published."""

    FIXED: ClassVar[str] = CONFIGURED

    image_topic: str = quantity("image_raw")
    """Topic of the images; compressed ones are published on its name with /compressed."""
    camera_info_topic: str = quantity("")
    """Topic of the intrinsics; empty: camera_info next to the images."""
    camera_info_url: str = quantity("", fixed=READ_ONLY)
    """Calibration that camera_info shows in place of the simulated camera's own, and that
    set_camera_info writes: file:///PATH.yaml or package://PACKAGE/PATH.yaml."""
    wrench_topic: str = quantity("wrench")
    """Topic of the wrench."""
    difference_topic: str = quantity("image_diff")
    """Topic of the images' difference to the reference, and with /compressed of the same as JPEG or
    PNG."""
    reference_topic: str = quantity("reset_dt")
    """Topic of std_msgs/Bool that makes what is seen now the reference."""
    radius_topic: str = quantity("depth/radius")
    """Topic of the skin's distance from the centre of the dome in 8 bits."""
    radius_shown_topic: str = quantity("depth/radius_shown")
    """Topic of the same as a grey rgb8 image."""

    def __post_init__(self) -> None:
        check_fields("", self)
        for name, (default, _) in quantities_of(TopicParameters).items():
            # Empty is what its default means.
            if default and not getattr(self, name):
                raise ValueError(f"{name} is empty, expected the name of a topic")


@dataclass(frozen=True)
class ImageParameters:
    """Part, size and form of the images."""

    FIXED: ClassVar[str] = FREE

    encoding: str = quantity("rgb8", choices=("rgb8", "bgr8", "mono8"))
    """Encoding of image_raw."""
    crop_px: tuple[int, int, int, int] = quantity((0, 0, 0, 0), low=0, high=16384)
    """Part of the sensor's image that is published: x, y, width, height; zeros: all of it."""
    image_size_px: tuple[int, int] = quantity((0, 0), low=0, high=16384)
    """Width and height that the part is published at; zeros: as it is."""
    image_aspect: str = quantity(KEEP, choices=(KEEP, STRETCH))
    """Whether an image_size_px of another aspect ratio than the part's is refused (keep), or the
    image squeezed to it (stretch)."""
    image_noise_levels: float = quantity(SENSORS_OWN, low=SENSORS_OWN, high=LARGEST_NOISE_LEVELS)
    """Standard deviation of the camera's noise, in grey levels of 255, in place of the sensor's
    own; negative: as in the sensor's file."""
    fail_drop_images: bool = quantity(False)
    """Publish no images, as after a cut cable, to test what reads them."""
    compression: str = quantity("jpeg", choices=("jpeg", "png"))
    """Format of image_raw/compressed."""
    jpeg_quality: int = quantity(95, low=1, high=100)
    """Quality of JPEG."""
    difference_gain: float = quantity(8.0, low=1.0, high=255.0)
    """What differences are multiplied by."""
    depth_convention: str = quantity(AXIAL, choices=(AXIAL, RANGE))
    """What depth/image holds: z, the depth along the optical axis as in REP 118; or range, the
    distance along the ray, which a fisheye has beyond 90 degrees, too."""
    radius_limits_m: tuple[float, float] = quantity((0.01223, 0.01688), low=0.0, high=1.0)
    """Radii that the values 0 and 256 of the 8-bit image stand for."""

    def __post_init__(self) -> None:
        check_fields("", self)
        if self.radius_limits_m[0] >= self.radius_limits_m[1]:
            raise ValueError(
                f"radius_limits_m is {list(self.radius_limits_m)}, expected two radii, the smaller "
                "one first"
            )
        if (self.image_size_px[0] == 0) != (self.image_size_px[1] == 0):
            raise ValueError(
                f"image_size_px is {list(self.image_size_px)}: give both width and height, or two "
                "zeros for the size of the crop"
            )
        if (self.crop_px[2] == 0) != (self.crop_px[3] == 0) or (
            self.crop_px[2] == 0 and any(self.crop_px)
        ):
            raise ValueError(
                f"crop_px is {list(self.crop_px)}: give x, y, width and height, or four zeros"
            )


@dataclass(frozen=True)
class TactileSimParameters:
    """Parameters of `tactile_sim`, by group.

    Raises:
        ValueError: parameters of several groups contradict each other.
    """

    sensor: SensorParameters = SensorParameters()
    time: TimeParameters = TimeParameters()
    motion: MotionParameters = MotionParameters()
    frames: FrameParameters = FrameParameters()
    links: LinkParameters = LinkParameters()
    topics: TopicParameters = TopicParameters()
    image: ImageParameters = ImageParameters()

    def __post_init__(self) -> None:
        motion, time, world_frame = self.motion, self.time, self.frames.world_frame
        resolve_profile(self.sensor.profile, is_lockstep=not time.is_realtime)
        if world_frame and motion.pose_source != TF:
            raise ValueError(
                f"world_frame is {value_text(world_frame)}, but pose_source is "
                f"{motion.pose_source}: only {TF} knows more frames; leave world_frame empty where "
                "the axes of base_frame are the world's"
            )
        if time.is_realtime and motion.input_timeout_s < 1.0 / time.rate_hz:
            raise ValueError(
                f"input_timeout_s is {motion.input_timeout_s}, shorter than a frame at "
                f"{time.rate_hz} Hz; raise one of the two"
            )
        if not time.is_realtime and (motion.input, motion.twist_message) == (TWIST, TWIST_PLAIN):
            raise ValueError(
                "lockstep needs stamps: set twist_message to TwistStamped, or clock to realtime"
            )

    def prefixed(self) -> TactileSimParameters:
        """Return the same with the names of frames as they are published."""
        return replace(self, frames=self.frames.prefixed())
