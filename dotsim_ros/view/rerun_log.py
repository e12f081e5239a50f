# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a sensor publishes, in the viewer of rerun (https://rerun.io): of a bag, or of live topics.

Entities: `camera/image`, `camera/depth` (m), `base/skin` (a mesh, coloured by how far it moved),
`base/indenter` (the axes of its frame), `wrench/force_n` and `wrench/torque_nm`; the timeline
`stamp` is the messages' own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

import msg_adapters
from dotsim_ros.data.bag import BAG_TYPES
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.extras import extra_needed
from dotsim_ros.io.files import whole_file
from dotsim_ros.io.printable import placed
from dotsim_ros.view.panels import AXIS_COLOURS, PanelImages, coloured
from dotsim_ros.view.skin_map import read_rest_m, rest_position_m, skin_triangles
from dotsim_ros.view.timeline import ViewTopics, open_timeline
from msg_adapters.image import PNG_SIGNATURE

APPLICATION = "dotsim_ros"
TIMELINE = "stamp"
SUFFIX = ".rrd"
URL_BEGINNING = "rerun+http"
SKIN_COLOURS = "plasma"
"""Not black where nothing moves: the shape of the skin shows, too."""
SKIN_SCALE_M = 2e-3
"""Motion of the brightest colour, where the largest is not known."""
AXIS_LENGTH_M = 5e-3


def rerun_module() -> ModuleType:
    """Return rerun.

    Raises:
        ValueError: it is not installed.
    """
    with extra_needed("--rerun", "rerun"):
        import rerun
    return rerun


def blueprint() -> Any:
    """Return what the viewer shows where: image above depth, the skin, force above torque."""
    rerun_module()
    import rerun.blueprint as rrb

    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial2DView(origin="camera/image", name="Image"),
                rrb.Spatial2DView(origin="camera/depth", name="Depth"),
            ),
            rrb.Spatial3DView(origin="base", name="Motion of the skin"),
            rrb.Vertical(
                rrb.TimeSeriesView(origin="wrench/force_n", name="Force on the indenter, N"),
                rrb.TimeSeriesView(origin="wrench/torque_nm", name="Torque, N m"),
            ),
        ),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


class RerunLog:
    """Puts messages into a recording of rerun.

    Args:
        recording: a `rerun.RecordingStream`.
        displacement_m: motion of the skin with the brightest colour.
        depth_m: nearest and farthest depth on the colour scale; None: each image has its own.
        rest_m: (V, 3) the skin at rest; None: by the first cloud.
    """

    def __init__(
        self,
        recording: Any,
        *,
        displacement_m: float = SKIN_SCALE_M,
        depth_m: tuple[float, float] | None = None,
        rest_m: FloatArray | None = None,
    ) -> None:
        self._rerun, self._recording = rerun_module(), recording
        self._displacement_m, self._depth_m, self._rest_m = displacement_m, depth_m, rest_m
        self._is_skin_begun = False
        show = self._rerun
        colours = list(AXIS_COLOURS.values())
        recording.log("base", show.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        arrows = show.Arrows3D(vectors=AXIS_LENGTH_M * np.eye(3), colors=_rgb(colours))
        recording.log("base/indenter", arrows, static=True)
        for name, symbol in (("wrench/force_n", "F"), ("wrench/torque_nm", "M")):
            lines = show.SeriesLines(
                names=[f"{symbol}{axis}" for axis in AXIS_COLOURS], colors=_rgb(colours)
            )
            recording.log(name, lines, static=True)

    def log(self, name: str, message: msg_adapters.Message) -> None:
        """Show a message at its own stamp.

        Args:
            name: of its topic in `ViewTopics`.
            message: of ROS or of a bag.

        Raises:
            ValueError: it holds no such thing.
        """
        stamp_ns = msg_adapters.message_stamp_ns(message)
        self._recording.set_time(TIMELINE, timestamp=np.datetime64(stamp_ns, "ns"))
        show = {
            "image": self._image,
            "depth": self._depth,
            "points": self._points,
            "pose": self._pose,
            "wrench": self._wrench,
        }
        show[name](message)

    def _image(self, message: msg_adapters.Message) -> None:
        if hasattr(message, "encoding"):
            # Without loss, at a fraction of the bytes.
            message = msg_adapters.encode_compressed_image(
                msg_adapters.decode_rgb(message),
                compression="png",
                stamp_ns=0,
                frame_id="",
                types=BAG_TYPES,
            )
        msg_adapters.compressed_image_size(message)
        contents = bytes(message.data)
        is_png = contents.startswith(PNG_SIGNATURE)
        media_type = "image/png" if is_png else "image/jpeg"
        image = self._rerun.EncodedImage(contents=contents, media_type=media_type)
        self._recording.log("camera/image", image)

    def _depth(self, message: msg_adapters.Message) -> None:
        if message.encoding != "32FC1":
            raise ValueError(f"holds a {message.encoding} image, expected 32FC1")
        depth_m = np.asarray(msg_adapters.decode_image(message), dtype=np.float32)
        image = self._rerun.DepthImage(
            depth_m, meter=1.0, colormap="viridis", depth_range=self._depth_m
        )
        self._recording.log("camera/depth", image)

    def _points(self, message: msg_adapters.Message) -> None:
        cloud = msg_adapters.decode_cloud(message)
        if self._rest_m is None:
            self._rest_m = rest_position_m(cloud)
        mesh = self._rerun.Mesh3D
        if not self._is_skin_begun:
            triangles = mesh.from_fields(triangle_indices=skin_triangles(self._rest_m))
            self._recording.log("base/skin", triangles, static=True)
            self._is_skin_begun = True
        position_m = np.asarray(cloud.position, dtype=np.float64)
        if position_m.shape != self._rest_m.shape:
            raise ValueError(
                f"the skin has {len(position_m)} points, expected {len(self._rest_m)}: it must "
                "keep its vertices"
            )
        motion_m = np.linalg.norm(position_m - self._rest_m, axis=1)
        moved = mesh.from_fields(
            vertex_positions=position_m,
            vertex_colors=coloured(motion_m, 0.0, self._displacement_m, SKIN_COLOURS),
            vertex_normals=cloud.normal,
        )
        self._recording.log("base/skin", moved)

    def _pose(self, message: msg_adapters.Message) -> None:
        position_m, quaternion_xyzw = msg_adapters.decode_pose_stamped(message)
        rotation = self._rerun.Quaternion(xyzw=quaternion_xyzw)
        at = self._rerun.Transform3D(translation=position_m, quaternion=rotation)
        self._recording.log("base/indenter", at)

    def _wrench(self, message: msg_adapters.Message) -> None:
        force_n, torque_nm = msg_adapters.decode_wrench_stamped(message)
        self._recording.log("wrench/force_n", self._rerun.Scalars(force_n))
        self._recording.log("wrench/torque_nm", self._rerun.Scalars(torque_nm))


def _rgb(colours: list[str]) -> list[list[int]]:
    return [[int(colour[place : place + 2], 16) for place in (1, 3, 5)] for colour in colours]


@contextmanager
def recording_at(place: str) -> Iterator[Any]:
    """Yield a recording that goes to a viewer, or to a file that appears when the block ends well.

    Args:
        place: the URL of a running viewer (rerun+http://127.0.0.1:9876/proxy), or a file, *.rrd.

    Raises:
        ValueError: it is neither, or rerun is not installed.
        OSError: the file could not be written; the one before it is left as it was.
    """
    path, is_viewer = Path(place), place.startswith(URL_BEGINNING)
    if not is_viewer and path.suffix != SUFFIX:
        raise ValueError(
            f"--rerun is {place}, expected the name of a file that ends in {SUFFIX}, or the URL of "
            f"a running viewer, which begins with {URL_BEGINNING}"
        )
    recording = rerun_module().RecordingStream(APPLICATION, recording_id=path.stem)
    if is_viewer:
        recording.connect_grpc(place, default_blueprint=blueprint())
        yield recording
        recording.disconnect()
        return
    with whole_file(path) as part:
        try:
            recording.save(part, default_blueprint=blueprint())
            yield recording
            recording.flush()
        except RuntimeError as error:
            raise OSError(
                f"{path} could not be written (rerun: {error}), and what was there before is as it "
                "was; make room, or give another path"
            ) from error
        finally:
            recording.disconnect()


def write_rerun(
    path: Path,
    place: str,
    warn: Callable[[str], None],
    *,
    topics: ViewTopics | None = None,
    rest: Path | None = None,
) -> None:
    """Show a bag as a recording of rerun; one that is cut short, up to where it ends.

    Args:
        path: of the bag.
        place: as `recording_at`.
        warn: takes what is not shown and why, a sentence each.
        topics: those the user named.
        rest: .npz with `rest_position_m`, or None.

    Raises:
        FileNotFoundError: no such bag.
        ValueError: it cannot be read, is damaged, or shows nothing; or as `recording_at`.
        OSError: as `recording_at`.
    """
    with recording_at(place) as recording, open_timeline(path, topics) as timeline, placed(path):
        for words in timeline.shortcomings():
            warn(words)
        rest_m = None if rest is None else read_rest_m(rest)
        scales = PanelImages(timeline.moments(), rest_m=rest_m)
        log = RerunLog(
            recording,
            displacement_m=scales.displacement_m or SKIN_SCALE_M,
            depth_m=scales.depth_m,
            rest_m=rest_m,
        )
        for name, message in timeline.messages():
            with placed(f"{path}, {getattr(timeline.topics, name)}"):
                log.log(name, message)
