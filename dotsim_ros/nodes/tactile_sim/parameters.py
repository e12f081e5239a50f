# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of `tactile_sim`."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np

from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.documents import value_text
from dotsim_ros.io.quantity import check_value, quantities_of
from dotsim_ros.nodes.common.options import option
from dotsim_ros.nodes.simulated_time.latency import LONGEST_S, check_quantiles
from dotsim_ros.nodes.tactile_sim.output_parameters import OutputParameters
from dotsim_ros.nodes.tactile_sim.profiles import BY_CLOCK, NAMES, resolve_profile
from dotsim_ros.specification import NoiseSpecification, SolverSpecification

REALTIME, LOCKSTEP = "realtime", "lockstep"
POSE, TWIST, ANY = "pose", "twist", "any"
BY_POSE, BY_FORCE = "pose", "force"
TOPIC, TF, ODOMETRY = "topic", "tf", "odometry"
TWIST_STAMPED, TWIST_PLAIN = "TwistStamped", "Twist"
LARGEST_GRID_M = quantities_of(SolverSpecification)["grid_spacing_m"][1].high
LARGEST_NOISE_LEVELS = quantities_of(NoiseSpecification)["deviation_levels"][1].high
SENSORS_OWN = -1.0


@dataclass(frozen=True)
class TactileSimParameters(OutputParameters):
    """Parameters of `tactile_sim`; each field says what it is.

    Raises:
        ValueError: a value out of its range, or two that contradict each other.
    """

    sensor: str = option(
        "densetact2",
        "Sensor to simulate: a name below params/sensors, or the path of a YAML file.",
        fixed_while_configured=True,
    )
    device: str = option(
        "cpu", "Where the gel is computed: cpu, or cuda:0.", fixed_while_configured=True
    )
    indenter: str = option(
        "sphere_4mm",
        "What presses: a name below params/indenters, the path of an STL, OBJ, PLY or YAML file, "
        "or a definition such as 'sphere(radius_m=0.003)' or "
        "'mesh(path=screw.stl, scale=0.001)'.",
    )
    clock: str = option(
        REALTIME,
        "realtime: frames at rate_hz from the newest pose; lockstep: one frame for each pose, "
        "with its stamp.",
        choices=(REALTIME, LOCKSTEP),
        fixed_while_configured=True,
    )
    profile: str = option(
        BY_CLOCK,
        "How accurately the gel is solved: exact (the sensor's own solver, any motion in a frame), "
        "realtime, fast (a coarser grid), or auto (the finest that the machine affords); by_clock: "
        "realtime, and in lockstep, which takes no other, exact. docs/run.md tells the errors.",
        choices=NAMES,
        fixed_while_configured=True,
    )
    grid_spacing_m: float = option(
        0.0,
        "Spacing of the gel's grid in place of the sensor's own, in every profile, for a rate that "
        "this machine does not reach otherwise; 0: as in the sensor's file. docs/gel.md tells what "
        "it costs.",
        minimum=0.0,
        maximum=LARGEST_GRID_M,
        fixed_while_configured=True,
    )
    rate_hz: float = option(
        25.0, "Frames per second of the real-time clock.", minimum=0.5, maximum=240.0
    )
    input: str = option(
        ANY,
        "Which input moves the indenter; any: whichever speaks first, the other one is refused "
        "while it goes on.",
        choices=(POSE, TWIST, ANY),
        fixed_while_configured=True,
    )
    control: str = option(
        BY_POSE,
        "What says how deep the indenter presses. pose: its pose; force: the normal force on "
        "indenter/wrench, along the indenter's z axis, where the pose says all but the depth.",
        choices=(BY_POSE, BY_FORCE),
        read_only=True,
    )
    pose_source: str = option(
        TOPIC,
        "Where the pose comes from. topic: indenter/pose; odometry: indenter/odometry; tf: the "
        "place of indenter_frame in base_frame on /tf and /tf_static. docs/simulators.md.",
        choices=(TOPIC, TF, ODOMETRY),
        fixed_while_configured=True,
    )
    twist_message: str = option(
        TWIST_STAMPED,
        "Type of indenter/twist.",
        choices=(TWIST_STAMPED, TWIST_PLAIN),
        fixed_while_configured=True,
    )
    input_timeout_s: float = option(
        0.5,
        "After this long without a message a velocity counts as zero, the other input may take "
        "over, and the diagnostics warn.",
        minimum=0.02,
        maximum=3600.0,
    )
    maximum_jump_m: float = option(
        0.01,
        "A pose further than this from the one before is a new start, not a motion through what "
        "lies between.",
        minimum=1e-4,
        maximum=10.0,
    )
    maximum_lag_m: float = option(
        0.001,
        "An indenter that a frame shows further than this from its newest pose is warned of: it "
        "lags behind since it moves faster than frames can follow in contact.",
        minimum=1e-5,
        maximum=10.0,
    )
    maximum_step_s: float = option(
        1.0,
        "Stamps that step back by more than this are a new start (a bag played again); by less, "
        "the pose is out of order and refused.",
        minimum=1e-3,
        maximum=1e6,
    )
    start_position_m: tuple[float, float, float] = option(
        (0.0, 0.0, 0.03),
        "Where the indenter starts under velocity input.",
        minimum=-10.0,
        maximum=10.0,
    )
    start_quaternion_xyzw: tuple[float, float, float, float] = option(
        (0.0, 0.0, 0.0, 1.0), "How it is turned there.", minimum=-1.0, maximum=1.0
    )
    base_frame: str = option(
        "densetact_base", "Frame of poses, skin and wrench.", fixed_while_configured=True
    )
    optical_frame: str = option(
        "densetact_optical_frame", "Frame of the images and the depth.", fixed_while_configured=True
    )
    indenter_frame: str = option(
        "indenter",
        "Frame of the indenter: of velocities along its axes, of pose_source tf and odometry, and "
        "of its external wrench.",
        fixed_while_configured=True,
    )
    world_frame: str = option(
        "",
        "With pose_source tf: the frame of Gazebo's world, for entity_wrench. Empty: the axes of "
        "base_frame are the world's.",
        fixed_while_configured=True,
    )
    entity_indenter: str = option(
        "",
        "Gazebo's name of the link that presses, such as peg::link; its wrench goes out on "
        "entity_wrench. Empty: none.",
        fixed_while_configured=True,
    )
    entity_indenter_centre_m: tuple[float, float, float] = option(
        (0.0, 0.0, 0.0),
        "Centre of mass of that link in indenter_frame: Gazebo lets forces act there.",
        minimum=-10.0,
        maximum=10.0,
        fixed_while_configured=True,
    )
    entity_sensor: str = option(
        "",
        "The same of the link that carries the sensor. Empty: none.",
        fixed_while_configured=True,
    )
    entity_sensor_centre_m: tuple[float, float, float] = option(
        (0.0, 0.0, 0.0),
        "Centre of mass of that link in base_frame.",
        minimum=-10.0,
        maximum=10.0,
        fixed_while_configured=True,
    )
    encoding: str = option("rgb8", "Encoding of image_raw.", choices=("rgb8", "bgr8", "mono8"))
    crop_px: tuple[int, int, int, int] = option(
        (0, 0, 0, 0),
        "Part of the sensor's image that is published: x, y, width, height; zeros: all of it.",
        minimum=0,
        maximum=16384,
    )
    image_size_px: tuple[int, int] = option(
        (0, 0),
        "Width and height that the part is published at; zeros: as it is.",
        minimum=0,
        maximum=16384,
    )
    idle_image: str = option(
        "",
        "Image of the real sensor at rest, to be carried by the gel; a YAML file of its name "
        "next to it may describe it. Empty: the sensor's own.",
        is_path=True,
        fixed_while_configured=True,
    )
    image_noise_levels: float = option(
        SENSORS_OWN,
        "Standard deviation of the camera's noise, in grey levels of 255, in place of the sensor's "
        "own; negative: as in the sensor's file.",
        minimum=SENSORS_OWN,
        maximum=LARGEST_NOISE_LEVELS,
    )
    effects: str = option(
        "",
        "Overlay of effects to add to the sensor, a YAML file that find_gap wrote. Empty: none.",
        is_path=True,
        read_only=True,
    )
    effects_folder: str = option(
        "",
        "Folder of effects of your own that the overlay may name, one a Python file: the files of "
        "those that it names are run as programs. Empty: those shipped.",
        is_path=True,
        read_only=True,
    )
    exposure_s: float = option(
        0.0,
        "In simulated time: how long the camera exposes; a frame's stamp is the middle of that, so "
        "that half of it is over before anything is read out.",
        minimum=0.0,
        maximum=0.5,
        fixed_while_configured=True,
    )
    image_latency_s: tuple[float, ...] = option(
        (0.0,),
        "In simulated time: from the end of the exposure until a frame is published: one delay, or "
        "evenly spaced quantiles of it, the smallest first.",
        minimum=0.0,
        maximum=LONGEST_S,
        fixed_while_configured=True,
    )
    latency_seed: int = option(
        0, "Seed of image_latency_s.", minimum=0, maximum=2**31 - 1, fixed_while_configured=True
    )
    fail_drop_images: bool = option(
        False, "Publish no images, as after a cut cable, to test what reads them."
    )
    compression: str = option("jpeg", "Format of image_raw/compressed.", choices=("jpeg", "png"))
    jpeg_quality: int = option(95, "Quality of JPEG.", minimum=1, maximum=100)
    diagnostics_period_s: float = option(
        1.0, "Time between diagnostics.", minimum=0.05, maximum=60.0, fixed_while_configured=True
    )
    publish_tf: bool = option(
        True,
        "Publish the camera's place in the base frame on /tf_static, where tf2_ros is installed.",
        fixed_while_configured=True,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, length in (
            ("start_position_m", 3),
            ("start_quaternion_xyzw", 4),
            ("entity_indenter_centre_m", 3),
            ("entity_sensor_centre_m", 3),
            ("crop_px", 4),
            ("image_size_px", 2),
        ):
            if len(getattr(self, name)) != length:
                raise ValueError(f"{name} needs {length} numbers, got {len(getattr(self, name))}")
        if not re.fullmatch("cpu|cuda(:[0-9]{1,3})?", self.device):
            raise ValueError(f"device is {value_text(self.device)}, expected cpu, or cuda:0")
        self.start_pose()
        resolve_profile(self.profile, is_lockstep=self.clock == LOCKSTEP)
        if self.grid_spacing_m != 0.0:
            spacing, name = self.grid_spacing_m, "grid_spacing_m"
            check_value(SolverSpecification, name, spacing, called=name)
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
        frames = (self.base_frame, self.optical_frame, self.indenter_frame)
        if "" in frames or len(set(frames)) < 3:
            raise ValueError(
                f"base_frame, optical_frame and indenter_frame are {frames}: they must differ and "
                "must not be empty"
            )
        self._check_pose_source()
        if self.effects_folder and not self.effects:
            raise ValueError(
                f"effects_folder is {self.effects_folder!r}, but no overlay names an effect of it: "
                "set the parameter effects, too"
            )
        check_quantiles("image_latency_s", self.image_latency_s)
        if self.clock == REALTIME and self.input_timeout_s < 1.0 / self.rate_hz:
            raise ValueError(
                f"input_timeout_s is {self.input_timeout_s}, shorter than a frame at "
                f"{self.rate_hz} Hz; raise one of the two"
            )
        if self.clock == LOCKSTEP and self.input == TWIST and self.twist_message == TWIST_PLAIN:
            raise ValueError(
                "lockstep needs stamps: set twist_message to TwistStamped, or clock to realtime"
            )

    def _check_pose_source(self) -> None:
        if self.pose_source != TOPIC and self.input == TWIST:
            raise ValueError(
                f"pose_source is {self.pose_source}, but input is {TWIST}, which reads no pose: "
                f"set input to {POSE}"
            )
        if self.world_frame and self.pose_source != TF:
            raise ValueError(
                f"world_frame is {value_text(self.world_frame)}, but pose_source is "
                f"{self.pose_source}: only {TF} knows more frames; leave world_frame empty where "
                "the axes of base_frame are the world's"
            )
        if self.world_frame in (self.base_frame, self.indenter_frame):
            raise ValueError(
                f"world_frame is {value_text(self.world_frame)}, as base_frame or indenter_frame "
                "is: expected another frame, or none"
            )

    def prefixed(self) -> TactileSimParameters:
        """Return the same with the names of frames as they are published."""
        return replace(
            self,
            frame_prefix="",
            base_frame=f"{self.frame_prefix}{self.base_frame}",
            optical_frame=f"{self.frame_prefix}{self.optical_frame}",
            indenter_frame=f"{self.frame_prefix}{self.indenter_frame}",
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
