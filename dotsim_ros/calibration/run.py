# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A whole calibration: read, see what the data identify, fit each press, combine, judge."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import monotonic

import numpy as np

from dotsim_ros.calibration.advice import shown_modulus_pa, why_not_identified
from dotsim_ros.calibration.fitting import FitProblem, PressFit, PressLinearisation
from dotsim_ros.calibration.loss import CHAMFER, FORCE, POINTS, LossNoise
from dotsim_ros.calibration.parameters import chosen_parameters, with_coordinates
from dotsim_ros.calibration.stages import Outcome, Task, Workers, open_workers
from dotsim_ros.calibration.statistics import (
    Combination,
    Identifiability,
    identifiability,
    joint_estimate,
    joint_step,
    median_estimate,
    offset_step,
)
from dotsim_ros.data.data_set import DataSet
from dotsim_ros.data.plausibility import HARDEST_PA, SOFTEST_PA
from dotsim_ros.data.reading import Observation, Omission, PressReader, summarize_reasons
from dotsim_ros.data.trajectory import Topics
from dotsim_ros.gel.make import skin_of
from dotsim_ros.gel.values import GelValues, specification_with, values_of
from dotsim_ros.geometry.skin_mesh import SkinMesh, tip_depth_m
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.worker_pool.pool import Crew
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.press_metrics import PressFrameScore, score_press
from dotsim_ros.twin.simulator import GelSimulator

SOLVE_BUDGET = 40
"""Usual most solves of a press in a whole calibration."""
JOINT_STEPS = 2
"""Gauss-Newton steps of the joint fit: from the median, whose neighbourhood is nearly linear."""


@dataclass(frozen=True)
class CalibrationRequest:
    """What to calibrate: what `calibrate` is given, checked and complete.

    Attributes:
        sensor: the sensor before; its constants are the priors' centres.
        train, held_out: names of the trajectories to fit on and to judge on.
        fit: names of parameters, keys of `PARAMETERS`.
        with_offset: whether to fit an offset of the indenter to each press.
        directory: of the run's files.
        joint_steps: Gauss-Newton steps of the joint fit, each a solve and one a parameter for each
            press. Without any, the joint estimate comes from the fits of single presses, weighed by
            their information: splits of one data set then share all solves.
        solve_budget: most solves of a press. One more than there are parameters leaves each press
            where it starts.
    """

    data_set: DataSet
    sensor: SensorSpecification
    train: tuple[str, ...]
    held_out: tuple[str, ...]
    fit: tuple[str, ...]
    with_offset: bool
    losses: tuple[str, ...]
    noise: LossNoise
    topics: Topics
    directory: Path
    workers: Crew
    seed: int
    joint_steps: int = JOINT_STEPS
    solve_budget: int = SOLVE_BUDGET
    indenters: Path | None = None


@dataclass(frozen=True)
class Calibration:
    """What a calibration found.

    Attributes:
        problem: what was fitted, of the parameters that the data tell.
        asked: names of all parameters that were asked for.
        frozen: names of those that the data do not tell; they keep their priors' centres.
        identifiability: of all that were asked for, at the start.
        fits: of single presses, by name.
        median, joint: the two combinations.
        values: the gel's, by the joint fit.
        specification: the sensor with them.
        linearisations: at the joint fit's last point, by press; at those of the single fits where
            the joint fit took no steps.
        solve_counts: solves of each press.
        scores: of the held-out frames, empty where nothing could be judged.
        omissions: trajectories that were left out, and why.
        fit_seconds: what fitting took, without reading, tables and judging.
        reasons: why the data do not tell a frozen parameter, and what to do, by its name.
        remarks: what else the sensor's file has otherwise than the sensor before.
    """

    problem: FitProblem
    asked: tuple[str, ...]
    frozen: tuple[str, ...]
    identifiability: list[Identifiability]
    fits: dict[str, PressFit]
    median: Combination
    joint: Combination
    values: GelValues
    specification: SensorSpecification
    linearisations: dict[str, PressLinearisation]
    solve_counts: dict[str, int]
    scores: list[PressFrameScore]
    omissions: list[Omission]
    fit_seconds: float
    reasons: dict[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    def named(self, name: str) -> SensorSpecification:
        """Return the calibrated sensor under a name; a network of images stays with its own."""
        sensor = self.specification
        if name != sensor.name:
            sensor = replace(sensor, camera=replace(sensor.camera, residual=""))
        return replace(sensor, name=name)


Progress = Callable[[str, int, int], None]
"""Told the stage, how many presses of it are done, and of how many."""


def run_calibration(request: CalibrationRequest, progress: Progress) -> Calibration:
    """Fit the gel to the data.

    Raises:
        ValueError: nothing to fit, no usable trajectory, or losses that the data do not have.
    """
    r = request
    reader = PressReader.of(
        r.data_set,
        skin_of(r.sensor.gel),
        sensor=r.sensor.name,
        topics=r.topics,
        indenters=r.indenters,
    )
    if POINTS in r.losses and not reader.has_vertices:
        raise ValueError(
            f"{r.data_set.directory} has no skin_mesh.npz, so its points do not correspond to "
            "vertices; use the loss chamfer"
        )
    found, omissions = reader.read_all(r.train)
    judged, unjudged = reader.read_all(r.held_out)
    omissions += unjudged
    observations = _touching([_with_losses(o, r.losses) for o in found], reader.skin, omissions)
    if not observations:
        raise ValueError(
            f"no trajectory of {r.data_set.directory} can be fitted: "
            f"{summarize_reasons([omission.reason for omission in omissions])}"
        )
    asked = FitProblem(
        chosen_parameters(r.fit),
        values_of(r.sensor),
        r.noise,
        CHAMFER if CHAMFER in r.losses else POINTS,
        r.with_offset,
    )
    _prepare_tables(r.sensor, reader.skin, asked, progress)
    with open_workers(r.sensor, reader.skin, r.directory, r.workers) as workers:
        stages = _Stages(r, observations, workers, progress, omissions)
        return _calibrated(stages, asked, judged if reader.has_vertices else [])


def _calibrated(stages: _Stages, asked: FitProblem, judged: list[Observation]) -> Calibration:
    begun, request = monotonic(), stages.request
    first = stages.linearised("start", asked, dict.fromkeys(stages.observations, asked.centre()))
    shown_pa = shown_modulus_pa(asked, list(first.values()))
    if shown_pa is not None:
        check_modulus(shown_pa, "the forces are those of")
    identified = identifiability(asked, list(first.values()))
    everything = {i.parameter for i in identified if i.data == "skin and force" and i.is_told}
    kept = [k for k, p in enumerate(asked.parameters) if p.name in everything]
    frozen = [p.name for p in asked.parameters if p.name not in everything]
    reasons = why_not_identified(
        asked,
        frozen,
        list(stages.observations.values()),
        stages.workers.skin,
        losses=request.losses,
        topics=request.topics,
        shown_pa=shown_pa,
    )
    if not kept:
        raise ValueError(
            "the data identify no parameter: "
            + "; ".join(f"{name}: {reason}" for name, reason in reasons.items())
        )
    problem = replace(asked, parameters=tuple(asked.parameters[k] for k in kept))
    first = {name: _restricted(asked, kept, lin) for name, lin in first.items()}
    fits = stages.fitted("single", problem, first)
    median = median_estimate(problem, list(fits.values()), seed=request.seed)
    points = {name: _joined(problem, median.point, fits[name].best) for name in fits}
    at = {name: fit.best for name, fit in fits.items()}
    for number in range(request.joint_steps):
        at = stages.linearised(f"joint_{number}", problem, points)
        step = joint_step(problem, list(at.values()))
        points = {
            name: lin.point + np.concatenate([step, offset_step(problem, lin, step)])
            for name, lin in at.items()
        }
    joint = joint_estimate(problem, list(at.values()), seed=request.seed)
    values = with_coordinates(problem.start, problem.parameters, joint.point)
    if "E" in everything:
        check_modulus(values.youngs_modulus_pa, "the fit ends at")
    fit_seconds = monotonic() - begun
    scores = stages.judged(problem, joint.point, judged)
    return Calibration(
        problem=problem,
        asked=tuple(p.name for p in asked.parameters),
        frozen=tuple(frozen),
        identifiability=identified,
        fits=fits,
        median=median,
        joint=joint,
        values=values,
        specification=seen_as_before(specification_with(request.sensor, values), request.sensor),
        linearisations=at,
        solve_counts=stages.solve_counts,
        scores=scores,
        omissions=stages.omissions,
        fit_seconds=fit_seconds,
        reasons=reasons,
    )


def face_drop_m(fitted: SensorSpecification, before: SensorSpecification) -> float:
    """Return how far the face of a pad came down by a fit; that of a dome stays where it is."""
    if fitted.gel.shape == "dome":
        return 0.0
    return before.gel.thickness_m - fitted.gel.thickness_m


def seen_as_before(fitted: SensorSpecification, before: SensorSpecification) -> SensorSpecification:
    """Return a sensor whose camera and lights are as far from a pad's face as before the fit: its
    base is at 0, so that the face is where the thickness that was found puts it. A network of
    images stays with the camera that it was trained for."""
    lower_m = face_drop_m(fitted, before)
    if lower_m == 0.0:
        return fitted
    x, y, z = before.camera.position_m
    return replace(
        fitted,
        camera=replace(before.camera, position_m=(x, y, z - lower_m), residual=""),
        lighting=replace(before.lighting, height_m=before.lighting.height_m - lower_m),
    )


def check_modulus(youngs_modulus_pa: float, what: str) -> None:
    """Refuse a Young's modulus that no gel has; `what` begins the error.

    Raises:
        ValueError: it lies beyond `SOFTEST_PA` and `HARDEST_PA`.
    """
    if not SOFTEST_PA <= youngs_modulus_pa <= HARDEST_PA:
        raise ValueError(
            f"{what} E = {youngs_modulus_pa:.4g} Pa, expected {SOFTEST_PA:.0e} to {HARDEST_PA:.0e} "
            "Pa, as gels have: no sensor is written; check the unit of the force, the poses' "
            "frame, and the indenters' meshes"
        )


class _Stages:
    """Runs the stages of a request, each over all presses.

    Attributes:
        request: what is calibrated.
        observations: the presses to fit to, by name.
        workers: who solve.
        solve_counts: solves of each press so far.
        omissions: what was left out so far, and why.
    """

    def __init__(
        self,
        request: CalibrationRequest,
        observations: Sequence[Observation],
        workers: Workers,
        progress: Progress,
        omissions: list[Omission],
    ) -> None:
        self.request, self.workers, self.omissions = request, workers, omissions
        self.observations = {o.press.name: o for o in observations}
        self.solve_counts = dict.fromkeys(self.observations, 0)
        self._progress = progress

    def linearised(
        self, stage: str, problem: FitProblem, points: Mapping[str, FloatArray]
    ) -> dict[str, PressLinearisation]:
        """Return the linearisations of presses at their points (n,)."""
        tasks = [Task(self.observations[name], problem, point) for name, point in points.items()]
        return {name: fit.best for name, fit in self._run(stage, tasks).items()}

    def fitted(
        self, stage: str, problem: FitProblem, starts: Mapping[str, PressLinearisation]
    ) -> dict[str, PressFit]:
        """Return the fits of single presses."""
        most = self.request.solve_budget - self.request.joint_steps * (1 + problem.size)
        tasks = [
            Task(
                self.observations[name], problem, start.point, start, most - self.solve_counts[name]
            )
            for name, start in starts.items()
        ]
        return self._run(stage, tasks)

    def judged(
        self, problem: FitProblem, point: FloatArray, observations: Sequence[Observation]
    ) -> list[PressFrameScore]:
        """Return the scores of held-out presses at the shared parameters' point (P,)."""
        if not observations:
            return []
        scores: list[PressFrameScore] = []
        self._progress("held out", 0, len(observations))
        predicted = self.workers.predict(problem, point, observations)
        for number, (o, found) in enumerate(predicted, 1):
            self._progress("held out", number, len(observations))
            if isinstance(found, str):
                self.omissions.append(Omission(o.press.name, f"held out: {found}"))
            elif o.press.skin_position_m is not None:
                scores += score_press(
                    o.press, found, o.indenter, self.workers.skin, seed=self.request.seed
                )
        return scores

    def _run(self, stage: str, tasks: Sequence[Task]) -> dict[str, PressFit]:
        outcomes: dict[str, Outcome] = {}
        self._progress(stage, 0, len(tasks))
        for name, outcome in self.workers.run(stage, tasks):
            outcomes[name] = outcome
            self._progress(stage, len(outcomes), len(tasks))
        found = {}
        for name in (task.name for task in tasks):
            outcome = outcomes[name]
            if isinstance(outcome, str):
                reason = (
                    f"{name}, stage {stage}: {outcome}; check the poses' frame and units and "
                    "the indenter's mesh, or press less deep"
                )
                self.omissions.append(Omission(name, reason))
                continue
            self.solve_counts[name] += outcome.solve_count
            found[name] = outcome
        if not found:
            raise ValueError(
                f"no press could be solved in stage {stage}: "
                f"{summarize_reasons([omission.reason for omission in self.omissions])}"
            )
        return found


def _touching(
    observations: Sequence[Observation], skin: SkinMesh, omissions: list[Omission]
) -> list[Observation]:
    """Return the observations whose indenter touches the gel, and list the others as left out."""
    found = []
    for observation in observations:
        press = observation.press
        nearest = int(np.argmax(tip_depth_m(skin, press.poses)))
        distance = observation.indenter.distance_from(skin.rest_position_m, press.poses[nearest])
        if float(distance.min()) <= 0.0:
            found.append(observation)
            continue
        omissions.append(
            Omission(
                press.name,
                f"{press.name}: the indenter never touches the gel, it stays "
                f"{1e3 * float(distance.min()):.2f} mm off the skin, expected a press of 2 mm; "
                "check the poses and the indenter's origin, or leave the trajectory out",
            )
        )
    return found


def _with_losses(observation: Observation, losses: Sequence[str]) -> Observation:
    """Return the observation without the channels that no loss asks for."""
    press = observation.press
    if FORCE not in losses:
        press = replace(press, force_n=None)
    if POINTS not in losses and CHAMFER not in losses:
        press = replace(press, skin_position_m=None)
    return replace(observation, press=press)


def _prepare_tables(
    sensor: SensorSpecification, skin: SkinMesh, problem: FitProblem, progress: Progress
) -> None:
    """Compute the tables that the start needs once, not in each worker."""
    simulator = GelSimulator(
        sensor, skin, progress=lambda share: progress("tables", round(100 * share), 100)
    )
    simulator.prepare(problem.start)


def _restricted(
    asked: FitProblem, kept: Sequence[int], lin: PressLinearisation
) -> PressLinearisation:
    """Return a linearisation of the kept parameters and the offset alone."""
    count = len(asked.parameters)
    rows = [*kept, *range(count, asked.size)]
    return replace(
        lin,
        point=lin.point[rows],
        information={c: m[np.ix_(rows, rows)] for c, m in lin.information.items()},
        gradient={c: g[rows] for c, g in lin.gradient.items()},
    )


def _joined(problem: FitProblem, shared: FloatArray, lin: PressLinearisation) -> FloatArray:
    """Return shared coordinates (P,) with a press's own offset."""
    return np.concatenate([shared, lin.point[len(problem.parameters) :]])
