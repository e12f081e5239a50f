# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Effects of the camera and its lights."""

from __future__ import annotations

from functools import cache, partial

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from dotsim_ros.data.recording import Phase
from dotsim_ros.effects.effect import IMAGE, Effect, EffectParameter, SeenImage, Values, by_frame
from dotsim_ros.effects.optical_terms import (
    FULL_SCALE,
    FixedResampling,
    any_frame,
    moves_fast,
    pixel_places,
    radius_square,
    sampled,
    undistorted_camera,
    within_scale,
)
from dotsim_ros.io.arrays import FloatArray

image_effect = partial(Effect, channels=(IMAGE,), excited_by=any_frame)
"""An effect of the image; every frame shows it, unless it names what excites it."""


AMBIENT_LIGHT = image_effect(
    name="ambient_light",
    title="Ambient light",
    # Of the full scale. Less light than when the twin was made is as likely as more.
    summary="a veil over the whole image that no contact changes.",
    parameters=(EffectParameter("added_share", "", 0.0, -0.05, 0.05, (0.02, -0.02)),),
    protocol="images with the LEDs off",
    taken_for=("gamma", "daylight"),
    image=by_frame(
        lambda values, image: within_scale(image.pixels + FULL_SCALE * values["added_share"])
    ),
)

DARK_LEVEL = 1.0
"""Mean grey level below which a camera's gain does not follow any further."""


def _auto_exposure(values: Values, image: SeenImage) -> FloatArray:
    wanted = max(float(np.mean(image.idle)), DARK_LEVEL)
    seen = max(float(np.mean(image.pixels)), DARK_LEVEL)
    return within_scale(image.pixels * (wanted / seen) ** values["strength"])


AUTO_EXPOSURE = image_effect(
    name="auto_exposure",
    title="Auto-exposure",
    # At 1 the mean of every image is that of the idle frame.
    summary="the camera's gain follows the mean of what it sees, relative to the idle frame.",
    parameters=(EffectParameter("strength", "", 0.0, 0.0, 1.0, (0.5, 1.0)),),
    protocol="a deep press, which changes the image's mean",
    excited_by=lambda recording: recording.has(Phase.LOAD),
    taken_for=("led_dimming",),
    image=by_frame(_auto_exposure),
)

ROUNDS = 2
"""How often it is asked where the skin that a new pixel shows was seen before."""


def parallax_px(image: SeenImage, displacement_m: FloatArray) -> FloatArray:
    """Return how far (H, W, 2) what each pixel shows moves in the image; 0 where no skin is seen.
    The displacement (3,) is the camera's, optical frame."""
    camera = undistorted_camera(image)
    directions, _ = camera.rays()
    point_m = image.depth_m[..., None] * directions
    x, y = pixel_places(image)
    return np.nan_to_num(camera.project_optical(point_m - displacement_m) - np.stack([x, y], -1))


def _camera_displacement(values: Values, image: SeenImage) -> FloatArray:
    displacement_m = np.array([values["x_m"], values["y_m"], values["z_m"]])
    if not displacement_m.any():
        return image.pixels
    moved = parallax_px(image, displacement_m).astype(np.float32)
    x, y = pixel_places(image)
    way = moved
    for _ in range(ROUNDS):
        found = cv2.remap(
            moved,
            (x - way[..., 0]).astype(np.float32),
            (y - way[..., 1]).astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        way = np.asarray(found, dtype=np.float32)
    return within_scale(sampled(image.pixels, x - way[..., 0], y - way[..., 1]))


CAMERA_DISPLACEMENT = image_effect(
    name="camera_displacement",
    title="Displaced camera",
    summary="the camera, or its entrance pupil, stands next to its place.",
    parameters=(
        EffectParameter("x_m", "m", 0.0, -5.0e-4, 5.0e-4, (1.0e-4, -1.0e-4)),
        EffectParameter("y_m", "m", 0.0, -5.0e-4, 5.0e-4, (0.0, 1.0e-4)),
        EffectParameter("z_m", "m", 0.0, -5.0e-4, 5.0e-4, (0.0, 1.0e-4)),
    ),
    protocol="images of the idle pattern, and of deep presses, whose skin is near",
    taken_for=("camera_extrinsics", "camera_intrinsics", "pose_offset"),
    image=by_frame(_camera_displacement),
)
"""Near skin moves farther in the image than far skin: a parallax, which a turned camera
(`camera_extrinsics`) does not have. Skin that only the displaced camera sees is taken from what is
next to it. The lens's radial distortion is not known here and left out.
"""


def _turned(values: Values, image: SeenImage) -> tuple[FloatArray, FloatArray]:
    turn = Rotation.from_rotvec(
        [values["tilt_x_rad"], values["tilt_y_rad"], values["roll_rad"]]
    ).as_matrix()
    camera = undistorted_camera(image)
    directions, _ = camera.rays()
    places = camera.project_optical(directions @ turn.T)
    # Where a pixel has no direction or its direction no place, the border is shown.
    places = np.where(np.isfinite(places), places, -1.0)
    return places[..., 0], places[..., 1]


CAMERA_EXTRINSICS = image_effect(
    name="camera_extrinsics",
    title="Tilted camera",
    summary="the camera is turned about its own place.",
    parameters=(
        EffectParameter("tilt_x_rad", "rad", 0.0, -0.07, 0.07, (0.01, -0.01)),
        EffectParameter("tilt_y_rad", "rad", 0.0, -0.07, 0.07, (0.0, 0.01)),
        EffectParameter("roll_rad", "rad", 0.0, -0.07, 0.07, (0.0, 0.01)),
    ),
    protocol="images of the idle pattern",
    taken_for=("camera_intrinsics", "camera_displacement", "pose_offset"),
    image=lambda values: FixedResampling(partial(_turned, values)),
)
"""A camera that turns without moving sees the same rays elsewhere, whatever their depth, so the
image is resampled exactly but for the lens's radial distortion, which is not known here. A camera
that has moved sees a parallax that depends on depth: that is `camera_displacement`.
"""


def _through_another_lens(values: Values, image: SeenImage) -> tuple[FloatArray, FloatArray]:
    x, y = pixel_places(image)
    centre_x, centre_y = image.centre_px
    shift_x = values["shift_x_rad"] * image.focal_x_px
    shift_y = values["shift_y_rad"] * image.focal_px
    ratio = values["focal_ratio"]
    return (
        centre_x + (x - centre_x - shift_x) / ratio,
        centre_y + (y - centre_y - shift_y) / ratio,
    )


CAMERA_INTRINSICS = image_effect(
    name="camera_intrinsics",
    title="Another focal length or centre of the camera",
    # The shift is given over the focal length: 0.06 rad are 5 px of an image 240 px high.
    summary="another focal length, or another place of the optical axis in the image.",
    parameters=(
        EffectParameter("focal_ratio", "", 1.0, 0.95, 1.05, (1.01, 0.99)),
        EffectParameter("shift_x_rad", "rad", 0.0, -0.06, 0.06, (0.0, 0.012)),
        EffectParameter("shift_y_rad", "rad", 0.0, -0.06, 0.06, (0.0, 0.012)),
    ),
    protocol="images of the idle pattern",
    taken_for=("camera_extrinsics", "camera_displacement", "pose_offset"),
    image=lambda values: FixedResampling(partial(_through_another_lens, values)),
)
"""With an equidistant lens or a pinhole, and any radial distortion, focal length and centre act on
the image linearly: a new pixel p looks where the old image has c + (p - c') / k, with k the ratio
of the focal lengths and c' the new centre.
"""


def _daylight(values: Values, image: SeenImage) -> FloatArray:
    azimuth, elevation = values["azimuth_rad"], values["elevation_rad"]
    towards = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    most, diffuse = FULL_SCALE * values["added_share"], values["diffuse_share"]
    # The normal of a view is the one on the camera's side.
    cosine = -image.normal @ towards
    share = diffuse * 0.5 * (1.0 + cosine) + (1.0 - diffuse) * np.maximum(cosine, 0.0)
    return within_scale(image.pixels + most * np.nan_to_num(share)[..., None])


DAYLIGHT = image_effect(
    name="daylight",
    title="Daylight from one side",
    # Of the full scale, on skin that faces it. The direction is that of the optical frame: from
    # right towards down in the image, and from its plane towards where the camera looks. Less
    # light than when the twin was made is as likely as more.
    summary="light from one side falls through the coat, most on the skin that faces it.",
    parameters=(
        EffectParameter("added_share", "", 0.0, -0.1, 0.1, (0.03,)),
        EffectParameter(
            "azimuth_rad",
            "rad",
            None,
            -np.pi,
            np.pi,
            tuple(np.radians([-150.0, -90.0, -30.0, 30.0, 90.0, 150.0]).tolist()),
        ),
        EffectParameter("elevation_rad", "rad", None, 0.0, 1.2, (0.0, 0.7)),
        EffectParameter("diffuse_share", "", None, 0.0, 1.0, (0.5,)),
    ),
    protocol="images with the LEDs off, the sensor turned about its axis between them",
    taken_for=("ambient_light", "vignetting", "led_imbalance"),
    image=by_frame(_daylight),
)
"""A share of the light is that of a uniform half of the sky about a direction: skin whose outward
normal leans from it by the angle b has (1 + cos b) / 2 of it (Liu and Jordan, "The long-term
average performance of flat-plate solar-energy collectors", Solar Energy 7(2), 1963). The rest comes
straight from there, and skin has max(cos b, 0) of it by Lambert's law. Skin that faces the light
has all of either, skin that faces away none, so a dent shows in it. Shadows of the indenter are
left out.
"""

SMALLEST_PX = 2.0
"""Diameter of the smallest disc that is worked out; smaller ones are mixed of it and no blur."""
GROWTH = 1.4
"""From one disc to the next."""
SUBSAMPLES = 16
"""Points along each side of a pixel at which a disc is asked whether it covers it."""


def disc_px(image: SeenImage, *, pupil_area_m2: float, focus_m: float) -> FloatArray:
    """Return (H, W) the diameter of each pixel's circle of confusion, px, for an entrance pupil of
    an area and a distance in focus; 0 where no skin is seen."""
    pupil_m = np.sqrt(4.0 * pupil_area_m2 / np.pi)
    diameter = image.focal_px * pupil_m * np.abs(1.0 / image.depth_m - 1.0 / focus_m)
    return np.nan_to_num(diameter)


@cache
def _disc(number: int) -> tuple[FloatArray, float]:
    """Return the weights (2 n + 1, 2 n + 1) of a disc, and their variance along an axis, px^2."""
    radius = 0.5 * SMALLEST_PX * GROWTH**number
    reach = int(np.ceil(radius - 0.5))
    side = 2 * reach + 1
    place = (np.arange(side * SUBSAMPLES) + 0.5) / SUBSAMPLES - 0.5 * side
    covered = np.hypot(place[:, None], place[None, :]) <= radius
    weight = covered.reshape(side, SUBSAMPLES, side, SUBSAMPLES).mean(axis=(1, 3))
    weight /= weight.sum()
    offset = np.arange(side) - reach
    return weight, float(np.sum(weight * offset**2))


def _defocus(values: Values, image: SeenImage) -> FloatArray:
    wanted = disc_px(image, **values) ** 2 / 16.0
    result = image.pixels.copy()
    finer, least = image.pixels, 0.0
    number, most = 0, float(wanted.max())
    while least < most:
        weight, variance = _disc(number)
        coarser = np.asarray(
            cv2.filter2D(image.pixels, -1, weight, borderType=cv2.BORDER_REPLICATE),
            dtype=np.float64,
        )
        between = (wanted > least) & (wanted <= variance)
        share = ((wanted[between] - least) / (variance - least))[:, None]
        result[between] = (1.0 - share) * finer[between] + share * coarser[between]
        finer, least, number = coarser, variance, number + 1
    return within_scale(result)


DEFOCUS = image_effect(
    name="defocus",
    title="A lens out of focus",
    # The area, since blur grows in proportion to it: 1e-6 m2 are a pupil of 1.13 mm.
    summary=("the lens is focused at one distance, and skin that is nearer or farther is blurred."),
    parameters=(
        EffectParameter("pupil_area_m2", "m2", 0.0, 0.0, 1.0e-6, (5.0e-8, 4.0e-7)),
        EffectParameter("focus_m", "m", None, 0.004, 0.2, (0.009, 0.015, 0.04)),
    ),
    protocol="images of the idle pattern, and of presses of several depths",
    taken_for=("motion_blur",),
    image=by_frame(_defocus),
)
"""A thin lens spreads a point at the distance s over a disc, the circle of confusion (Potmesil and
Chakravarty, "A lens and aperture camera model for synthetic image generation", Computer Graphics
15(3), 1981). Seen from the lens, its diameter is D |1/s - 1/f|, with D the diameter of the entrance
pupil and f the distance in focus: as many pixels as the focal length has a radian.

Each pixel is the mean over the disc of its own depth. Discs of some diameters are worked out, and a
pixel mixes the two next to its own so that the variance of the blur, d^2 / 16 an axis for a
diameter d, is exactly its own. What blurs the frame already, such as the lens that took the idle
image, is beneath.
"""


def _gamma(values: Values, image: SeenImage) -> FloatArray:
    exponent = values["exponent"]
    # Identical, not only nearly, where nothing is bent.
    if exponent == 1.0:
        return image.pixels
    # To the last digit what NumPy's power is, in half the time.
    bent = cv2.pow(within_scale(image.pixels) / FULL_SCALE, exponent)
    return FULL_SCALE * np.asarray(bent, dtype=np.float64)


GAMMA = image_effect(
    name="gamma",
    title="Another gamma of the camera",
    summary="the camera responds to light by another power than when the twin was made.",
    parameters=(EffectParameter("exponent", "", 1.0, 0.85, 1.15, (0.95, 1.05)),),
    protocol="idle images at two exposures",
    taken_for=("ambient_light", "vignetting"),
    image=by_frame(_gamma),
)


def _led_dimming(values: Values, image: SeenImage) -> FloatArray:
    warm = -np.expm1(-max(image.session_s, 0.0) / values["time_s"])
    return within_scale(image.pixels * (1.0 - values["final_loss_share"] * warm))


LED_DIMMING = image_effect(
    name="led_dimming",
    title="LEDs that dim over the session",
    summary="all LEDs lose brightness as they warm up over a session.",
    parameters=(
        EffectParameter("final_loss_share", "", 0.0, 0.0, 0.3, (0.05,)),
        EffectParameter("time_s", "s", None, 1.0, 3600.0, (20.0, 300.0)),
    ),
    protocol="images without contact, at the start and at the end of a session of minutes",
    excited_by=lambda recording: recording.session_s > 0.0,
    taken_for=("auto_exposure", "ambient_light"),
    image=by_frame(_led_dimming),
)
"""The loss approaches its final share exponentially, as that of a junction that warms up under a
constant current does. Dimming that came before the session is a gain of all images alike, which the
camera's gain takes.
"""


def led_imbalance(colour: str, channel: int) -> Effect:
    """Return the effect that the LEDs of one colour shine weaker or brighter than the others.

    The image's channel (0 red, 1 green, 2 blue) stands for the LEDs: the light of one colour that
    the camera sees in another channel is left out.
    """

    def dimmed(values: Values, image: SeenImage) -> FloatArray:
        pixels = image.pixels.copy()
        pixels[..., channel] *= 1.0 - values["loss_share"]
        return within_scale(pixels)

    return image_effect(
        name=f"led_imbalance_{colour}",
        title=f"{colour.capitalize()} LEDs out of balance",
        summary=f"the {colour} LEDs shine weaker or brighter than those of the other colours.",
        parameters=(EffectParameter("loss_share", "", 0.0, -0.3, 0.3, (0.05, -0.05)),),
        protocol="any images, also without contact",
        taken_for=("white balance of the camera",),
        image=by_frame(dimmed),
    )


LED_IMBALANCE_RED = led_imbalance("red", channel=0)

LED_IMBALANCE_GREEN = led_imbalance("green", channel=1)

LED_IMBALANCE_BLUE = led_imbalance("blue", channel=2)

SAMPLES_PER_PX = 2.0
MOST_SAMPLES = 33


def _motion_blur(values: Values, image: SeenImage) -> FloatArray:
    path_px = values["exposure_s"] * image.flow_px_s
    longest_px = float(np.linalg.norm(path_px, axis=2).max(initial=0.0))
    if longest_px == 0.0:
        return image.pixels
    count = int(np.clip(np.ceil(SAMPLES_PER_PX * longest_px) + 2, 3, MOST_SAMPLES))
    x, y = pixel_places(image)
    total = np.zeros_like(image.pixels)
    # The middles of equal shares of the exposure.
    for share in (np.arange(count) + 0.5) / count - 0.5:
        total += sampled(image.pixels, x - share * path_px[..., 0], y - share * path_px[..., 1])
    return within_scale(total / count)


MOTION_BLUR = image_effect(
    name="motion_blur",
    title="Motion blur",
    summary="the image moves while the camera exposes.",
    parameters=(EffectParameter("exposure_s", "s", 0.0, 0.0, 0.03, (0.01, 0.03)),),
    protocol="a slide or a press of 2 mm/s or faster, filmed as it moves",
    excited_by=moves_fast,
    taken_for=("defocus", "latency"),
    image=by_frame(_motion_blur),
)
"""The image is the mean of what was seen at even times over the exposure, which is centred on the
frame's stamp, so that the blur is not a latency too. Each instant is the frame's image, moved by
its flow.
"""


def _rolling_shutter(values: Values, image: SeenImage) -> FloatArray:
    readout_s, flow_px_s = values["readout_s"], image.flow_px_s
    if readout_s == 0.0 or not np.any(flow_px_s):
        return image.pixels
    x, y = pixel_places(image)
    later_s = readout_s * (y / max(image.pixels.shape[0] - 1, 1) - 0.5)
    source = x - later_s * flow_px_s[..., 0], y - later_s * flow_px_s[..., 1]
    return within_scale(sampled(image.pixels, *source))


ROLLING_SHUTTER = image_effect(
    name="rolling_shutter",
    title="Rolling shutter",
    # From the first row to the last, whatever their number: 480 rows of 20 to 60 us take 10 to
    # 29 ms.
    summary="rows are read one after the other, so what moves is skewed.",
    parameters=(EffectParameter("readout_s", "s", 0.0, 0.0, 0.03, (0.015, 0.03)),),
    protocol="a slide of 2 mm/s or faster, filmed as it moves, across and along the rows",
    excited_by=moves_fast,
    taken_for=("latency",),
    image=by_frame(_rolling_shutter),
)
"""The frame's stamp is that of the middle row. A row that is read later shows the image moved on
along its flow.
"""


SATURATION = image_effect(
    name="saturation",
    title="Saturation of the camera",
    # Lower than the table's 0.85, so that a sensor that is not lit to the full has it in range.
    summary="the camera clips what is brighter than a level below its full scale.",
    parameters=(EffectParameter("clip_share", "", 1.0, 0.5, 1.0, (0.85, 0.65)),),
    protocol="images that come near to white: bright LEDs, a glossy contact",
    taken_for=("gamma", "auto_exposure"),
    image=by_frame(
        lambda values, image: np.minimum(image.pixels, FULL_SCALE * values["clip_share"])
    ),
)


def _vignetting(values: Values, image: SeenImage) -> FloatArray:
    shade = 1.0 - values["edge_loss"] * radius_square(image)
    return within_scale(image.pixels * shade[..., None])


VIGNETTING = image_effect(
    name="vignetting",
    title="Vignetting",
    # The loss at half the image's height from the axis, over that at the axis.
    summary="brightness falls with the square of the distance from the optical axis.",
    parameters=(EffectParameter("edge_loss", "", 0.0, 0.0, 0.3, (0.05, 0.2)),),
    protocol="any images, also without contact",
    taken_for=("gamma", "daylight"),
    image=by_frame(_vignetting),
)

PLACES_RAD = (0.0, -1.0, -0.5, 0.5, 1.0)


def _worn_coat(values: Values, image: SeenImage) -> FloatArray:
    x, y = pixel_places(image)
    across_x = (x - image.centre_px[0]) / image.focal_x_px - values["x_rad"]
    across_y = (y - image.centre_px[1]) / image.focal_px - values["y_rad"]
    spot = np.exp(-0.5 * (across_x**2 + across_y**2) / values["radius_rad"] ** 2)
    return within_scale(image.pixels * (1.0 - values["loss_share"] * spot)[..., None])


WORN_COAT = image_effect(
    name="worn_coat",
    title="Worn spot of the coat",
    # Places and radius are angles from the optical axis: pixels over the focal length.
    summary="a smooth spot of the image that scatters less light than it did.",
    parameters=(
        EffectParameter("loss_share", "", 0.0, -0.5, 0.8, (0.2,)),
        EffectParameter("x_rad", "rad", None, -1.4, 1.4, PLACES_RAD),
        EffectParameter("y_rad", "rad", None, -1.4, 1.4, PLACES_RAD),
        EffectParameter("radius_rad", "rad", None, 0.1, 0.6, (0.3,)),
    ),
    protocol="images without contact, at commissioning and after wear",
    taken_for=("dust", "vignetting"),
    image=by_frame(_worn_coat),
)
"""The spot is a Gaussian at a fixed place of the image. A spot of the coat moves with the skin
under contact; as long as that is less than its radius this makes little difference.
"""
