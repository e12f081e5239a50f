# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How far a sensor's twin is from recordings: what `dotsim_ros evaluate` does and reports."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.calibration.fitting import FitProblem
from dotsim_ros.calibration.loss import POINTS, LossNoise
from dotsim_ros.calibration.run import Progress
from dotsim_ros.calibration.stages import open_workers
from dotsim_ros.data.data_set import DataSet, read_data_set
from dotsim_ros.data.presses import Prediction, Press
from dotsim_ros.data.reading import (
    PRESS_CHANNELS,
    BadBagError,
    MeasuredBag,
    Observation,
    Omission,
    PressReader,
    summarize_reasons,
)
from dotsim_ros.data.trajectory import MEASURED_TOPICS, Topics
from dotsim_ros.gel.make import body_of, skin_of
from dotsim_ros.gel.values import values_of
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.mesh_distance import surface_distance
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh, tip_depth_m
from dotsim_ros.io.arrays import FloatArray, ImageArray
from dotsim_ros.io.cores import single_threaded
from dotsim_ros.io.files import cache_directory
from dotsim_ros.io.page import (
    LARGEST_WIDTH_INCHES,
    Bullets,
    Gallery,
    Page,
    Paragraph,
    Section,
    Table,
    image_of,
    page_figure,
    page_files,
)
from dotsim_ros.io.printable import figure_label
from dotsim_ros.io.provenance import provenance
from dotsim_ros.io.replacement import finish_replacement, replace_files
from dotsim_ros.io.worker_pool.pool import Crew, check_workers
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.noise import with_noise
from dotsim_ros.optics.picture import change_image
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import SensorSpecification, given_sensor
from dotsim_ros.twin.footage import SkinFollower, camera_for, twin_renderers
from dotsim_ros.twin.image_metrics import image_psnr_db
from dotsim_ros.twin.press_metrics import JUDGED_DEPTH_M, judged_frames, root_mean_square
from dotsim_ros.twin.simulator import raised_m
from dotsim_ros.twin.surface_metrics import relative_rms, weighted_rms

ERRORS = "errors.json"
CHANNELS = ("skin", "force", "image")
MAGNIFIED = 2.0
"""Grey levels of the picture of a difference for one of the images."""
HEAD = (
    *("frames of", "skin RMS, mm", "95 %, mm", "largest, mm", "normal force", "tangential force"),
    *("PSNR, dB", "image difference, levels", "frames: skin, force, image"),
)


@dataclass(frozen=True)
class FrameError:
    """How far a simulated frame is from the recorded one; None for a channel that it does not have.

    Attributes:
        press, indenter: names of the trajectory and of the indenter.
        frame: its number in the channel.
        depth_m: of the tip below the skin at rest.
        skin_m: (V,) distance of each recorded vertex from the simulated surface.
        skin_rms_m: root mean square of it over the area of the skin.
        force_n: (3,) that was recorded, base frame.
        force_error_n: (3,) simulated minus recorded.
        psnr_db: of the simulated image against the recorded one, over the whole image.
        difference_levels: mean absolute difference of the two, in grey levels of 255.
    """

    press: str
    indenter: str
    frame: int
    depth_m: float
    skin_m: FloatArray | None = None
    skin_rms_m: float | None = None
    force_n: FloatArray | None = None
    force_error_n: FloatArray | None = None
    psnr_db: float = np.nan
    difference_levels: float = np.nan


SeenFrame = tuple[FrameError, ImageArray, ImageArray]
"""An error with the recorded and the simulated image (H, W, 3)."""


@dataclass(frozen=True)
class Evaluation:
    """How far a twin is from a data set.

    Attributes:
        sensor, data: their names.
        from_depth_m, seed: that were asked for.
        frames: that were judged; an image is a frame of its own.
        shallow: how many frames and images are less deep than asked for.
        omissions: what was left out, and why.
        worst: the frame whose image differs most; None without images.
    """

    sensor: str
    data: str
    from_depth_m: float
    seed: int
    frames: tuple[FrameError, ...]
    shallow: int
    omissions: tuple[Omission, ...]
    worst: SeenFrame | None


@single_threaded()
def evaluate_twin(
    data: str | Path | DataSet,
    *,
    sensor: str | Path | SensorSpecification,
    trajectories: Sequence[str] | None = None,
    indenters: str | Path | None = None,
    from_depth_m: float = JUDGED_DEPTH_M,
    workers: Crew = 2,
    seed: int = 0,
    topics: Topics = MEASURED_TOPICS,
    progress: Progress = lambda _stage, _done, _total: None,
) -> Evaluation:
    """Let a sensor follow the recorded poses, and return how far it is from what was recorded.

    It starts processes, so a script calls it below `if __name__ == "__main__":`.

    Args:
        data: folder of the data set, or the data set.
        sensor: a name, a YAML file or a specification.
        trajectories: names of those to judge; by default all.
        indenters: folder of the indenters' meshes; None as `DataSet.indenter_file`.
        from_depth_m: depth of the tip from which frames are judged.
        workers: how many processes, or workers of Ray.
        seed: of the noise of the simulated images.
        topics: where the channels lie in the bags.
        progress: called with the stage, how many presses of it are done, and of how many.

    Raises:
        FileNotFoundError: no data set or sensor there.
        ValueError: an argument that is out of range or names nothing, or no frame to judge.
    """
    check_workers(workers)
    if not 0.0 <= from_depth_m < np.inf or seed < 0:
        raise ValueError(
            f"the depth to judge from is {1e3 * from_depth_m:g} mm and the seed {seed}, expected "
            "0 or more both"
        )
    data_set = data if isinstance(data, DataSet) else read_data_set(data)
    twin = given_sensor(sensor)
    entries = data_set.entries if trajectories is None else data_set.named(trajectories)
    reader = PressReader.of(
        data_set, skin_of(twin.gel), sensor=twin.name, topics=topics, indenters=indenters
    )
    skin, has_vertices = reader.skin, reader.has_vertices
    frames: list[FrameError] = []
    depths_m = [np.zeros(0)]
    omissions: list[Omission] = []
    observations: list[Observation] = []
    camera = _TwinCamera(twin, skin, from_depth_m, seed)
    filmed = [entry for entry in entries if entry.has_images]
    worst: list[SeenFrame] = []
    for entry in entries:
        has_images = entry.has_images
        bag = reader.open(entry, (*PRESS_CHANNELS, "image") if has_images else PRESS_CHANNELS)
        try:
            observations.append(reader.observation(bag))
        except BadBagError as error:
            omissions.append(Omission(entry.name, f"skin and force of {error}"))
        if not has_images:
            continue
        progress("images", filmed.index(entry) + 1, len(filmed))
        try:
            depth_m, seen = camera.judge(bag, reader.indenter(entry))
        except (FileNotFoundError, ValueError) as error:
            omissions.append(Omission(entry.name, f"images of {entry.name}: {error}"))
            continue
        depths_m.append(depth_m)
        frames += [frame for frame, *_ in seen]
        worst = sorted([*worst, *seen], key=lambda one: one[0].psnr_db)[:1]
    if not has_vertices and any(o.press.skin_position_m is not None for o in observations):
        why = f"skin: {data_set.directory} has no skin_mesh.npz, so its points are no vertices"
        omissions.append(Omission("", f"{why}; add that file to have them compared"))
        observations = [o for o in observations if o.press.force_n is not None]
    as_it_is = FitProblem((), values_of(twin), LossNoise(), POINTS)
    with (
        tempfile.TemporaryDirectory() as folder,
        open_workers(twin, skin, Path(folder), workers) as crew,
    ):
        predicted = crew.predict(as_it_is, np.zeros(0), observations)
        for number, (o, found) in enumerate(predicted, 1):
            progress("presses", number, len(observations))
            if isinstance(found, str):
                reason = f"skin and force of {o.press.name}: {found}"
                omissions.append(Omission(o.press.name, reason))
                continue
            depths_m.append(tip_depth_m(skin, o.press.poses))
            frames += _pressed_frames(o.press, found, skin, has_vertices, from_depth_m)
    depth_m = np.concatenate(depths_m)
    if not frames:
        reasons = [omission.reason for omission in omissions]
        if depth_m.size:
            reasons.insert(0, f"the tip is {1e3 * depth_m.max():.2f} mm deep at most")
        raise ValueError(
            f"no frame of {data_set.directory} can be judged, expected the tip "
            f"{1e3 * from_depth_m:g} mm deep or deeper and a channel to compare (press deeper, or "
            f"lower --from-depth-mm): {summarize_reasons(reasons)}"
        )
    return Evaluation(
        *(twin.name, data_set.directory.resolve().name, from_depth_m, seed),
        *(tuple(frames), len(depth_m) - len(frames), tuple(omissions)),
        worst[0] if worst else None,
    )


def _pressed_frames(
    press: Press, found: Prediction, skin: SkinMesh, has_vertices: bool, from_depth_m: float
) -> list[FrameError]:
    """Return the errors of skin and force of a press."""
    depth_m, frames = tip_depth_m(skin, press.poses), []
    for frame in judged_frames(press, skin, from_depth_m=from_depth_m).tolist():
        distance = rms = force = error = None
        if press.skin_position_m is not None and has_vertices:
            measured, simulated = press.skin_position_m[frame], found.skin_position_m[frame]
            distance = surface_distance(measured, simulated, skin.triangles)
            rms = weighted_rms(distance, skin.rest_area_m2)
        if press.force_n is not None and found.force_n is not None:
            force, error = press.force_n[frame], found.force_n[frame] - press.force_n[frame]
        place = (press.name, press.indenter, frame, float(depth_m[frame]))
        frames.append(FrameError(*place, distance, rms, force, error))
    return frames


class _TwinCamera:
    """Judges the images of a sensor; what it needs is made for the first that are judged."""

    def __init__(
        self,
        sensor: SensorSpecification,
        measured: SkinMesh,
        from_depth_m: float,
        seed: int,
    ) -> None:
        self._sensor, self._from_depth_m, self._seed = sensor, from_depth_m, seed
        self._skin = skin_of(sensor.gel)
        # The file of a pad that was found thinner has its face lower than its data, and its camera.
        body, thickness_m = body_of(sensor.gel), values_of(sensor).thickness_m
        self._raised_m = raised_m(body, measured, thickness_m)
        self._follow = SkinFollower(sensor, self._skin, cache_directory() / "skins", lambda _: None)
        self._renderers: dict[tuple[int, ...], tuple[SkinRenderer, ImageRenderer]] = {}

    def judge(self, bag: MeasuredBag, indenter: Indenter) -> tuple[FloatArray, list[SeenFrame]]:
        """Return the depths (F,) of a bag's images, and those that are deep enough.

        Raises:
            FileNotFoundError, ValueError: it cannot be judged.
        """
        footage = bag.footage()
        press, size = footage.press, footage.pixels.shape[1:]
        poses = [Pose(p.position_m - self._raised_m, p.quaternion_xyzw) for p in press.poses]
        press = replace(press, poses=poses)
        depth_m = tip_depth_m(self._skin, press.poses)
        judged = judged_frames(press, self._skin, from_depth_m=self._from_depth_m).tolist()
        if not judged:
            return depth_m, []
        if size not in self._renderers:
            camera = camera_for(self._sensor, footage.pixels[0], press.name)
            self._renderers[size] = twin_renderers(self._sensor, camera)[:2]
        renderer, images = self._renderers[size]
        skin_m = self._follow(press, indenter)
        found = []
        for frame in judged:
            recorded = footage.pixels[frame]
            simulated = with_noise(
                images.render(renderer.render(skin_m[frame])),
                self._sensor.noise.deviation_levels,
                (self._seed, frame),
                channel_count=self._sensor.camera.channel_count,
            )
            error = FrameError(
                *(press.name, press.indenter, frame, float(depth_m[frame])),
                psnr_db=image_psnr_db(simulated, recorded),
                difference_levels=float(np.abs(simulated.astype(np.float64) - recorded).mean()),
            )
            found.append((error, recorded, simulated))
        return depth_m, found


def figures_of(frames: Sequence[FrameError]) -> dict[str, Any]:
    """Return the errors of frames together, by channel; None for a channel that none has.

    A share is the root mean square of the error over that of the recorded component. 95 % of the
    vertices of all frames are nearer to the simulated surface than `p95_mm`.
    """
    found: dict[str, Any] = {"trajectories": len({f.press for f in frames})}
    found |= dict.fromkeys(CHANNELS)
    if skin := [f.skin_m for f in frames if f.skin_m is not None]:
        found["skin"] = {
            "rms_mm": 1e3
            * root_mean_square([f.skin_rms_m for f in frames if f.skin_rms_m is not None]),
            "p95_mm": 1e3 * float(np.percentile(np.stack(skin), 95.0)),
            "largest_mm": 1e3 * float(np.max(skin)),
            "frames": len(skin),
        }
    if force := [f.force_n for f in frames if f.force_n is not None]:
        recorded = np.stack(force)
        error = np.stack([f.force_error_n for f in frames if f.force_error_n is not None])
        found["force"] = {
            "normal_share": relative_rms(error[:, 2], recorded[:, 2]),
            "normal_n": root_mean_square(error[:, 2]),
            "tangential_share": relative_rms(error[:, :2], recorded[:, :2]),
            "tangential_n": root_mean_square(np.linalg.norm(error[:, :2], axis=1)),
            "frames": len(force),
        }
    if image := [f for f in frames if np.isfinite(f.psnr_db)]:
        found["image"] = {
            "psnr_db": float(np.mean([f.psnr_db for f in image])),
            "difference_levels": float(np.mean([f.difference_levels for f in image])),
            "frames": len(image),
        }
    return found


def errors_of(evaluation: Evaluation) -> dict[str, Any]:
    """Return the errors over all frames, by indenter and by trajectory, ready for JSON."""
    e = evaluation

    def by(attribute: str) -> dict[str, Any]:
        names = sorted({getattr(f, attribute) for f in e.frames})
        return {n: figures_of([f for f in e.frames if getattr(f, attribute) == n]) for n in names}

    return {
        **provenance(),
        **{name: getattr(e, name) for name in ("sensor", "data", "from_depth_m", "seed")},
        "all": figures_of(e.frames),
        "indenters": by("indenter"),
        "trajectories": by("press"),
        "shallow": e.shallow,
        "omissions": [asdict(omission) for omission in e.omissions],
    }


def table_of(errors: dict[str, dict[str, Any]]) -> Table:
    """Return a table of errors by name, as `figures_of` gives them."""
    rows = []
    for name, found in errors.items():
        skin, force, image = (found[channel] for channel in CHANNELS)
        lengths = [skin[key] if skin else None for key in ("rms_mm", "p95_mm", "largest_mm")]
        images = [image[key] if image else None for key in ("psnr_db", "difference_levels")]
        rows.append(
            (
                name,
                *("-" if mm is None else f"{mm:.3f}" for mm in lengths),
                *(_force(force, part) for part in ("normal", "tangential")),
                *("-" if value is None else f"{value:.2f}" for value in images),
                ", ".join(str(part["frames"] if part else 0) for part in (skin, force, image)),
            )
        )
    return Table(HEAD, tuple(rows))


def _force(force: dict[str, Any] | None, part: str) -> str:
    if force is None:
        return "-"
    share, newtons = force[f"{part}_share"], f"{force[f'{part}_n']:.3f} N"
    return newtons if share is None else f"{100.0 * share:.1f} % ({newtons})"


def page_of(evaluation: Evaluation, errors: dict[str, Any]) -> Page:
    """Return the report of an evaluation, whose `errors_of` are given, as a page."""
    e, everything = evaluation, errors["all"]
    skin, force, image = (everything[channel] for channel in CHANNELS)
    parts = (
        f"{skin['rms_mm']:.3f} mm RMS of the skin" if skin else "no skin to compare",
        f"{_force(force, 'normal')} of the normal force" if force else "no force to compare",
        f"{image['psnr_db']:.1f} dB PSNR of the image" if image else "no image to compare",
    )
    text = (
        f"The sensor follows the recorded poses. {everything['trajectories']} trajectories are "
        f"judged, in frames whose tip is at least {1e3 * e.from_depth_m:g} mm below the skin at "
        f"rest; {e.shallow} frames and images are less deep. Skin: distance of the recorded "
        "vertices from the simulated surface. Force: RMS of the error, as a share of the RMS of "
        "what was recorded and in newtons, along the sensor's axis and across it. Image: over the "
        "whole image; the difference is the mean of all colours, of 255 levels."
    )
    left_out = Bullets(tuple(o.reason for o in e.omissions)) if e.omissions else Paragraph("None.")
    return Page(
        "How far the twin is from the recordings",
        f"Error of {e.sensor} on {e.data}: {', '.join(parts)}.",
        (
            Section(
                "Errors",
                (table_of({"all": everything, **errors["indenters"]}), Paragraph(text)),
            ),
            *([_worst_image(e.worst)] if e.worst else []),
            *([_skin_over_depth(e.frames)] if skin else []),
            Section("By trajectory", (table_of(errors["trajectories"]),)),
            Section("Left out", (left_out,)),
            Section("Made by", (Paragraph(f"{errors['command']}, commit {errors['commit']}"),)),
        ),
    )


def write_evaluation(directory: Path, page: Page, errors: dict[str, Any]) -> None:
    """Write report.html, report.md with its images, and errors.json into a folder, in place of
    those of an earlier evaluation, all or none.

    Raises:
        OSError: they could not be written.
    """
    finish_replacement(directory)
    record = (json.dumps(errors, indent=2, allow_nan=False) + "\n").encode()
    replace_files(directory, {ERRORS: record, **page_files(page)})


def _worst_image(worst: SeenFrame) -> Section:
    error, recorded, simulated = worst
    difference = change_image(simulated, recorded, MAGNIFIED)
    of = f"{error.press}, frame {error.frame}: {error.psnr_db:.1f} dB"
    pictures = []
    for name, pixels in zip(
        ("recorded", "simulated", "difference"), (recorded, simulated, difference), strict=True
    ):
        height = 0.3 + LARGEST_WIDTH_INCHES * pixels.shape[0] / pixels.shape[1]
        with page_figure(LARGEST_WIDTH_INCHES, height) as figure:
            axes = figure.add_subplot(title=name)
            axes.imshow(pixels)
            axes.set_axis_off()
            pictures.append(image_of(figure, name=f"worst_{name}", alt=f"{name}, {of}"))
    text = (
        f"The frame whose image differs most: {of}. Difference: simulated minus recorded, "
        f"{MAGNIFIED:g} times, on grey."
    )
    return Section("Worst image", (Paragraph(text), Gallery(tuple(pictures))))


def _skin_over_depth(frames: Sequence[FrameError]) -> Section:
    errors: dict[str, list[tuple[float, float]]] = {}
    for f in frames:
        if f.skin_rms_m is not None:
            errors.setdefault(f.indenter, []).append((1e3 * f.depth_m, 1e3 * f.skin_rms_m))
    largest_mm = max(mm for points in errors.values() for _, mm in points)
    with page_figure(LARGEST_WIDTH_INCHES, 2.8) as figure:
        axes = figure.add_subplot(xlabel="depth of the tip, mm", ylabel="skin RMS, mm")
        for name, points in sorted(errors.items()):
            axes.plot(*zip(*points, strict=True), "o", markersize=4, label=figure_label(name))
        axes.set_ylim(0.0, 1.1 * largest_mm or 1.0)
        figure.legend(loc="outside upper center", ncols=2, frameon=False)
        alt = f"Error of the skin over the depth of the tip, up to {largest_mm:.3f} mm"
        image = image_of(figure, name="skin_over_depth", alt=alt)
    return Section("Skin over depth", (Gallery((image,)),))
