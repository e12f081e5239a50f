# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The paper's explicit gel as a model of measured presses, fitted as the paper does, or to forces.

The paper fits E and nu to the surfaces of each trajectory and takes the median. Where the gel's
mass is scaled until its step is stable, the scale follows E and the surfaces are the same for every
E, which therefore stays where the paper's fit ended. The force is then in proportion to E, so that
one run of each press tells which E the measured forces ask for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from dotsim_ros.data.presses import Prediction, Press
from dotsim_ros.gel.explicit.gel import PAPER_FRAME_S, ExplicitGel, ExplicitSettings
from dotsim_ros.gel.make import SingleExplicitGel, body_of
from dotsim_ros.gel.material import NeoHookean
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.follow import SolveError, follow

PAPER_YOUNGS_MODULUS_PA = 27_575.0
SEARCHED_POISSON_RATIOS = (0.303, 0.40, 0.45, 0.48)
"""The search's values, from the paper's own to those of a nearly incompressible gel."""

CLEARANCE_M = 0.3e-3
"""The explicit gel takes its first pose for granted, so that it must lie outside."""

# With its mass scaled up the gel rings for many frames; the rate at which it is quiet in one.
SETTINGS = ExplicitSettings(damping_per_s=50.0)
COARSE_SETTINGS = replace(SETTINGS, spacing_m=2.4e-3, softness=30.0)
"""The paper's row of 2.4 mm, on which nu is searched."""


class ExplicitModel:
    """The explicit gel on the measured skin, in frames of at most 1/24 s.

    Args:
        specification: its body, density and friction are taken.
        material: the fitted law.
        settings: grid and substeps.
        name: how tables call it.
    """

    def __init__(
        self,
        specification: SensorSpecification,
        material: NeoHookean,
        settings: ExplicitSettings = SETTINGS,
        *,
        name: str = "explicit",
    ) -> None:
        self.specification, self.material, self.settings = specification, material, settings
        self.name = name
        self._gel: ExplicitGel | None = None

    def prepare(self, indenter: Indenter, skin: SkinMesh) -> ExplicitGel:
        """Return the gel at rest; for another skin that takes a while."""
        gel = self._gel
        if gel is None or gel.skin is not skin:
            s = self.specification
            gel = self._gel = ExplicitGel(
                body_of(s.gel),
                skin,
                material=self.material,
                density_kg_m3=s.material.density_kg_m3,
                friction_coefficient=s.contact.friction_coefficient,
                indenter=indenter,
                settings=self.settings,
                frame_s=PAPER_FRAME_S,
            )
        elif gel.indenter is not indenter:
            gel.set_indenter(indenter)
        gel.reset()
        return gel

    def predict(self, press: Press, indenter: Indenter, skin: SkinMesh) -> Prediction:
        """Return skin and force at the poses of a press, one after the other from rest.

        Raises:
            SolveError: it became unstable.
        """
        gel = self.prepare(indenter, skin)
        gel.step(start_outside(press.poses[0], indenter, skin), PAPER_FRAME_S)
        found = follow(
            SingleExplicitGel(gel).step,
            press.poses,
            press.stamp_s,
            longest_step_s=PAPER_FRAME_S,
        )
        return Prediction(found.skin_position_m, found.force_n)


def start_outside(pose: Pose, indenter: Indenter, skin: SkinMesh) -> Pose:
    """Return a pose moved out along the indenter's axis until it is clear of the skin at rest."""
    away = pose.rotation()[:, 2]
    depth = -float(indenter.distance_from(skin.rest_position_m, pose).min())
    while depth > -CLEARANCE_M:
        pose = Pose(pose.position_m + (depth + 1.1 * CLEARANCE_M) * away, pose.quaternion_xyzw)
        depth = -float(indenter.distance_from(skin.rest_position_m, pose).min())
    return pose


def surface_error_m(predicted: Prediction, press: Press) -> float:
    """Return the paper's loss: the bidirectional Chamfer distance of the vertices, all frames.

    Raises:
        ValueError: no skin was measured.
    """
    if press.skin_position_m is None:
        raise ValueError(f"{press.name}: no skin was measured, so no surface can be fitted")
    distances = []
    for simulated, measured in zip(predicted.skin_position_m, press.skin_position_m, strict=True):
        distances.append(KDTree(measured).query(simulated)[0].mean())
        distances.append(KDTree(simulated).query(measured)[0].mean())
    return float(np.mean(distances))


def best_poisson_ratio(
    specification: SensorSpecification, press: Press, indenter: Indenter, skin: SkinMesh
) -> float | None:
    """Return the searched Poisson's ratio whose surfaces are nearest to a press's; None where the
    gel became unstable with each of them."""
    errors: dict[float, float] = {}
    for ratio in SEARCHED_POISSON_RATIOS:
        material = NeoHookean(PAPER_YOUNGS_MODULUS_PA, ratio)
        model = ExplicitModel(specification, material, COARSE_SETTINGS)
        with suppress(SolveError):
            errors[ratio] = surface_error_m(model.predict(press, indenter, skin), press)
    return min(errors, key=errors.__getitem__, default=None)


@dataclass(frozen=True)
class ForceSums:
    """How predicted forces compare with measured ones: sums over frames and axes.

    Attributes:
        predicted_n2: squared predicted force.
        product_n2: predicted force times measured force.
    """

    predicted_n2: float
    product_n2: float


def force_sums(model: ExplicitModel, press: Press, indenter: Indenter, skin: SkinMesh) -> ForceSums:
    """Return how a model's forces compare with those of a press.

    Raises:
        ValueError: no force was measured.
        SolveError: the gel became unstable.
    """
    if press.force_n is None:
        raise ValueError(f"{press.name}: no force was measured, so no modulus can be fitted to it")
    force_n = model.predict(press, indenter, skin).force_n
    assert force_n is not None
    return ForceSums(float(np.sum(force_n**2)), float(np.sum(force_n * press.force_n)))


class ExplicitFit:
    """Fits explicit gels; a press's own runs are done once, whatever splits it is in.

    A press in which the gel becomes unstable is not fitted on.

    Args:
        specification: its body, density and friction are taken.
        settings: grid and substeps of what is fitted.
    """

    def __init__(
        self, specification: SensorSpecification, settings: ExplicitSettings = SETTINGS
    ) -> None:
        self._specification, self._settings = specification, settings
        self._ratio: dict[str, float | None] = {}
        self._force: dict[tuple[str, float], ForceSums | None] = {}

    def fit(
        self, train: Sequence[Press], indenters: Mapping[str, Indenter], skin: SkinMesh
    ) -> ExplicitModel:
        """Return the gel with the median Poisson's ratio of the presses.

        Raises:
            SolveError: the gel became unstable in all of them.
        """
        for press in train:
            if press.name not in self._ratio:
                self._ratio[press.name] = best_poisson_ratio(
                    self._specification, press, indenters[press.indenter], skin
                )
        ratios = [ratio for press in train if (ratio := self._ratio[press.name]) is not None]
        if not ratios:
            raise SolveError("the explicit gel became unstable in all presses to fit on")
        median = float(np.median(ratios))
        material = NeoHookean(PAPER_YOUNGS_MODULUS_PA, median)
        return ExplicitModel(self._specification, material, self._settings)

    def fit_with_force(
        self, train: Sequence[Press], indenters: Mapping[str, Indenter], skin: SkinMesh
    ) -> ExplicitModel:
        """Return the same gel with Young's modulus by least squares of the forces of all presses.

        Raises:
            ValueError: a press without force, or no indenter touches the gel.
            SolveError: the gel became unstable in all of the presses.
        """
        model = self.fit(train, indenters, skin)
        ratio = model.material.poisson_ratio
        for press in train:
            key = (press.name, ratio)
            if key not in self._force:
                try:
                    found = force_sums(model, press, indenters[press.indenter], skin)
                except SolveError:
                    found = None
                self._force[key] = found
        sums = [s for press in train if (s := self._force[press.name, ratio]) is not None]
        if not sums:
            raise SolveError("the explicit gel became unstable in all presses to fit on")
        predicted = sum(s.predicted_n2 for s in sums)
        factor = sum(s.product_n2 for s in sums) / predicted if predicted else 0.0
        if not factor > 0.0:
            raise ValueError(
                "the forces of the presses to fit on tell no Young's modulus: no indenter touches "
                "the gel, or they point the other way"
            )
        material = NeoHookean(factor * PAPER_YOUNGS_MODULUS_PA, ratio)
        return ExplicitModel(self._specification, material, self._settings, name="explicit_fitted")
