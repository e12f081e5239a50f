"""Reads the pictures of a data set for the gap finder, and says what of them cannot be used."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from dotsim_ros.evaluation.geometry import tip_depth_m
from dotsim_ros.evaluation.presses import Press
from dotsim_ros.gap.measurement import find_indenter
from dotsim_ros.gap.recording import Recording, phases_of
from dotsim_ros.geometry.pose import Pose, interpolate
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.measured.data_set import DataSet, DataSetEntry, read_data_set
from dotsim_ros.measured.trajectory import MEASURED_TOPICS, PoseChannel, Topics, read_trajectory

Array = NDArray[np.float64]
ByteImage = NDArray[np.uint8]

MOST_PICTURES = 300
"""Of a data set; trajectories are thinned evenly to come to no more."""
LEAST_FRAMES = 4
"""Of a trajectory that is thinned."""

ALIKE = 0.5
"""Correlation of the pattern of two idle frames of one unit; those of two units have 0.2 to 0.3 at
the best shift, those of one 0.9 and more, and a camera that has moved, dimmed or worn keeps it."""
TILES = (8, 6)
"""Columns and rows of the pieces of a picture whose patterns are compared."""
REACH_SHARE = 0.04
"""How far pieces may have moved, of the picture's height: a tilt of 3 degrees."""
FINE_PX = 6.0
"""The pattern is what is finer than this blur, in a picture 240 px high."""


@dataclass(frozen=True)
class Pictured:
    """A trajectory with pictures.

    Attributes:
        recording: the motion at the pictures' times; force as far as it was measured, no skin.
        measured: (F, H, W, 3) uint8.
    """

    recording: Recording
    measured: ByteImage


@dataclass(frozen=True)
class Pictures:
    """What a camera took of a data set.

    Attributes:
        directory: of the data set.
        idle_images: (N, H, W, 3) uint8 without contact.
        trajectories: with pictures of the same size, in the order of the index.
        warnings: what was left out, and why.
        digest: of all that was read.
    """

    directory: Path
    idle_images: ByteImage
    trajectories: tuple[Pictured, ...]
    warnings: tuple[str, ...]
    digest: str

    @property
    def idle(self) -> ByteImage:
        """Mean (H, W, 3) of the idle images."""
        return np.rint(self.idle_images.mean(axis=0)).astype(np.uint8)


def has_pictures(directory: str | Path) -> tuple[bool, bool]:
    """Return whether a data set says that its bags hold images, and whether it has idle images.

    Raises:
        FileNotFoundError, ValueError: as `read_data_set`.
    """
    data_set = read_data_set(directory)
    return any(entry.has_images for entry in data_set.entries), bool(data_set.idle_images())


def read_pictures(
    directory: str | Path,
    *,
    skin: SkinMesh,
    indenters: str | Path | None = None,
    names: Sequence[str] | None = None,
    topics: Topics = MEASURED_TOPICS,
) -> Pictures:
    """Read the pictures of a data set.

    Args:
        directory: the folder that holds dataset.yaml.
        skin: of the twin, at rest.
        indenters: folder of the indenters' meshes; None as `find_indenter`.
        names: of the trajectories to read; None for all with pictures.
        topics: where the channels lie.

    Raises:
        FileNotFoundError: no data set there.
        ValueError: no idle image, one that shows a contact, or no trajectory with pictures.
    """
    # Loaded on use: they start Warp.
    from dotsim_ros.optics.idle_check import mean_idle_image, read_idle_images

    data_set = read_data_set(directory)
    paths = data_set.idle_images()
    idle_images = read_idle_images(paths)
    mean_idle_image(idle_images, paths)
    entries = [e for e in data_set.entries if e.has_images and (names is None or e.name in names)]
    most = _most_frames([entry.frame_count for entry in entries])
    warnings: list[str] = []
    found: list[Pictured] = []
    digest = hashlib.sha256(idle_images.tobytes())
    session_s = 0.0
    for entry in data_set.entries:
        try:
            if entry in entries:
                one = _read(data_set, entry, idle_images, skin, session_s, indenters, topics, most)
                found.append(one)
                digest.update(one.measured.tobytes())
            session_s += _duration_s(entry, topics)
        except (FileNotFoundError, ValueError) as error:
            warnings.append(f"the pictures of {entry.name} were left out: {error}")
    if not found:
        raise ValueError(
            f"no trajectory of {data_set.directory} has pictures that can be used; record the "
            "camera's images beside the poses, and say 'images: true' in the index"
            + "".join(f"; {text}" for text in warnings)
        )
    return Pictures(
        data_set.directory, idle_images, tuple(found), tuple(warnings), digest.hexdigest()[:16]
    )


def check_same_unit(idle: ByteImage, measured: ByteImage, *, owner: str) -> None:
    """Refuse pictures of another unit: the pattern of the coat is each unit's own.

    Args:
        idle: (H, W, 3) of the twin or of the commissioning.
        measured: (H, W, 3) of the data set.
        owner: of the former, for the message.

    Raises:
        ValueError: another size or another pattern.
    """
    if idle.shape != measured.shape:
        raise ValueError(
            f"the idle images are {measured.shape[1]}x{measured.shape[0]}, {owner} is "
            f"{idle.shape[1]}x{idle.shape[0]}: take both with one camera and setting"
        )
    found = pattern_likeness(idle, measured)
    if found < ALIKE:
        raise ValueError(
            f"the idle images show another pattern than {owner} (correlation {found:.2f}, expected "
            f"{ALIKE} at least): they belong to another unit; name its own twin with --sensor, or "
            "its commissioning with --reference"
        )


def pattern_likeness(one: ByteImage, other: ByteImage) -> float:
    """Return how alike the patterns of two pictures (H, W, 3) are: the median, over pieces of the
    picture, of their correlation at the best shift."""
    first, second = _fine(one), _fine(other)
    height, width = first.shape
    reach = max(1, round(REACH_SHARE * height))
    columns, rows = TILES
    found = []
    for row in range(rows):
        for column in range(columns):
            top, bottom = max(row * height // rows, reach), (row + 1) * height // rows
            left, right = max(column * width // columns, reach), (column + 1) * width // columns
            bottom, right = min(bottom, height - reach), min(right, width - reach)
            piece = first[top:bottom, left:right]
            if min(piece.shape) < 4 or np.mean(piece != 0.0) < 0.8:
                continue
            around = second[top - reach : bottom + reach, left - reach : right + reach]
            found.append(float(cv2.matchTemplate(around, piece, cv2.TM_CCOEFF_NORMED).max()))
    return float(np.median(found)) if found else 0.0


def _fine(picture: ByteImage) -> NDArray[np.float32]:
    """Return (H, W) what is fine in a picture, relative to its brightness; 0 where it is dark."""
    grey = picture.mean(axis=2).astype(np.float32)
    size_px = FINE_PX * picture.shape[0] / 240.0
    level = cv2.GaussianBlur(grey, (0, 0), size_px)
    fine = grey - level
    fine[level < 0.1 * level.max()] = 0.0
    return np.asarray(fine / np.maximum(level, 1.0), dtype=np.float32)


def _most_frames(counts: Sequence[int]) -> int:
    """Return to how many frames each trajectory is thinned; 0 stands for a count that is not
    known."""
    if all(counts) and sum(counts) <= MOST_PICTURES:
        return MOST_PICTURES
    return max(LEAST_FRAMES, MOST_PICTURES // max(len(counts), 1))


def _duration_s(entry: DataSetEntry, topics: Topics) -> float:
    pose = read_trajectory(entry.bag, topics=topics, channels=("pose",)).pose
    return 0.0 if pose is None else 1e-9 * float(pose.stamp_ns[-1] - pose.stamp_ns[0])


def _read(
    data_set: DataSet,
    entry: DataSetEntry,
    idle_images: ByteImage,
    skin: SkinMesh,
    session_s: float,
    indenters: str | Path | None,
    topics: Topics,
    most: int,
) -> Pictured:
    trajectory = read_trajectory(entry.bag, topics=topics, channels=("pose", "wrench", "image"))
    pose, image, wrench = trajectory.pose, trajectory.image, trajectory.wrench
    if image is None or pose is None:
        missing = topics.image if image is None else topics.pose
        raise ValueError(f"nothing on {missing} in the bag; record it, or name its topic")
    if image.pixels.shape[1:] != idle_images.shape[1:]:
        raise ValueError(
            f"its images are {image.pixels.shape[2]}x{image.pixels.shape[1]}, the idle images "
            f"{idle_images.shape[2]}x{idle_images.shape[1]}; take both with one camera and setting"
        )
    within = (image.stamp_ns >= pose.stamp_ns[0]) & (image.stamp_ns <= pose.stamp_ns[-1])
    frames = np.flatnonzero(within)
    if not len(frames):
        raise ValueError("no image was taken while poses were recorded; stamp both by one clock")
    if len(frames) > most:
        frames = frames[np.unique(np.linspace(0, len(frames) - 1, most).round().astype(int))]
    stamp_ns = image.stamp_ns[frames]
    stamp_s = 1e-9 * stamp_ns.astype(np.float64)
    force = None
    if wrench is not None:
        times = 1e-9 * wrench.stamp_ns.astype(np.float64)
        force = np.stack([np.interp(stamp_s, times, axis) for axis in wrench.force_n.T], axis=1)
    poses = [_pose_at(pose, stamp) for stamp in stamp_ns.tolist()]
    press = Press(entry.name, entry.indenter, poses, stamp_s, force_n=force)
    depth_m = np.asarray(tip_depth_m(skin, poses))
    began_s = session_s + 1e-9 * float(stamp_ns[0] - pose.stamp_ns[0])
    recording = Recording(
        press,
        find_indenter(data_set, entry.indenter, indenters),
        began_s,
        depth_m,
        phases_of(poses, stamp_s, depth_m),
    )
    return Pictured(recording, image.pixels[frames])


def _pose_at(pose: PoseChannel, stamp_ns: int) -> Pose:
    """Return the pose at a time within those of the channel."""
    after = int(np.searchsorted(pose.stamp_ns, stamp_ns))
    later = Pose(pose.position_m[after], pose.quaternion_xyzw[after])
    if pose.stamp_ns[after] == stamp_ns:
        return later
    before = after - 1
    earlier = Pose(pose.position_m[before], pose.quaternion_xyzw[before])
    lapse = float(pose.stamp_ns[after] - pose.stamp_ns[before])
    return interpolate(earlier, later, float(stamp_ns - pose.stamp_ns[before]) / lapse)
