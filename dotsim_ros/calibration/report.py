# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The report of a calibration: figures as JSON, a page with plots, and lines for a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.calibration.advice import far_modulus
from dotsim_ros.calibration.loss import FORCE, SKIN
from dotsim_ros.calibration.parameters import shown_value, with_coordinates
from dotsim_ros.calibration.run import Calibration
from dotsim_ros.calibration.statistics import CHANNEL_SETS, Combination, Identifiability
from dotsim_ros.gel.values import GelParameter
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.files import whole_file, write_json
from dotsim_ros.io.page import (
    LARGEST_WIDTH_INCHES,
    Bullets,
    Gallery,
    Page,
    Paragraph,
    ReportImage,
    Section,
    Table,
    as_html,
    image_of,
    page_figure,
)
from dotsim_ros.io.printable import figure_label, one_line, printable
from dotsim_ros.io.provenance import provenance
from dotsim_ros.twin.press_metrics import by_indenter, summarize

ONE_PRESS = (
    "One press was fitted: its intervals hold the stated noise alone, not what differs between "
    "presses; record several"
)
EFFECTIVE = (
    "The constants are effective ones, with which this model fits these presses: the model's grid, "
    "contact and law shift them from the material's own. Where the material's own has an interval, "
    "it holds what this shift was on other units, domes that another solver pressed"
)
FIGURES, PAGE = "report.json", "report.html"


def figures(calibration: Calibration, *, seed: int) -> dict[str, Any]:
    """Return all figures of a calibration, ready for JSON."""
    c = calibration
    parameters = c.problem.parameters
    return {
        **provenance(),
        "seed": seed,
        "asked": list(c.asked),
        "constants": EFFECTIVE,
        "frozen": list(c.frozen),
        "skin_loss": c.problem.skin_loss,
        "noise": asdict(c.problem.noise),
        "parameters": {
            parameter.name: {
                "unit": parameter.unit,
                "prior": shown_value(parameter, c.problem.start),
                "median": _shown(c, parameter, index, c.median),
                "joint": _shown(c, parameter, index, c.joint),
                "single": {
                    name: _value_at(c, index, fit.best.point[: len(parameters)])
                    for name, fit in c.fits.items()
                },
            }
            for index, parameter in enumerate(parameters)
        },
        "values": asdict(c.values),
        "identifiability": [asdict(row) for row in c.identifiability],
        "offsets": {
            name: lin.point[len(parameters) :].tolist()
            for name, lin in c.linearisations.items()
            if c.problem.with_offset
        },
        "misfit": {
            name: {ch: _root_mean_square(lin.loss[ch], lin.count[ch]) for ch in lin.loss}
            for name, lin in c.linearisations.items()
        },
        "solves": c.solve_counts,
        "most_solves": max(c.solve_counts.values()),
        "unsettled": [name for name, fit in c.fits.items() if not fit.has_settled],
        "not_converged": [name for name, lin in c.linearisations.items() if not lin.converged],
        "fit_seconds": c.fit_seconds,
        "held_out": _held_out(c),
        "omissions": [asdict(omission) for omission in c.omissions],
        "remarks": list(c.remarks),
    }


def _held_out(calibration: Calibration) -> dict[str, Any]:
    scores = calibration.scores
    if not scores:
        return {}
    return {
        "all": asdict(summarize(scores)),
        **{name: asdict(summarize(part)) for name, part in by_indenter(scores).items()},
    }


def _root_mean_square(loss: float, count: int) -> float:
    return float(np.sqrt(2.0 * loss / count))


def _value_at(calibration: Calibration, index: int, point: FloatArray) -> float:
    problem = calibration.problem
    values = with_coordinates(problem.start, problem.parameters, point)
    return shown_value(problem.parameters[index], values)


def _shown(
    calibration: Calibration, parameter: GelParameter, index: int, combination: Combination
) -> dict[str, Any]:
    """Return value and interval in the parameter's unit, the others at the estimate, that of the
    material's own constant, and whether the value lies at a bound, where it is no estimate."""
    point = combination.point
    ends = combination.low[index], combination.high[index]
    low, high = _interval(calibration, index, point, ends)
    error, material = parameter.model_error, None
    is_at_bound = _is_at_bound(calibration, index, point)
    if error is not None and not is_at_bound:
        reach = [float(np.hypot(end - point[index], 1.96 * error)) for end in ends]
        material = _interval(
            calibration, index, point, (point[index] - reach[0], point[index] + reach[1])
        )
    return {
        "value": _value_at(calibration, index, point),
        "low": low,
        "high": high,
        "material": None if material is None else list(material),
        "at_bound": is_at_bound,
    }


def _interval(
    calibration: Calibration, index: int, point: FloatArray, ends: tuple[float, float]
) -> tuple[float, float]:
    """Return the smaller and the larger value with a parameter's coordinate at either end."""
    values = []
    for end in ends:
        moved = point.copy()
        moved[index] = end
        values.append(_value_at(calibration, index, moved))
    return min(values), max(values)


def _is_at_bound(calibration: Calibration, index: int, point: FloatArray) -> bool:
    problem = calibration.problem
    values = with_coordinates(problem.start, problem.parameters, point)
    parameter = problem.parameters[index]
    return parameter.bound_of(getattr(values, parameter.field)) is not None


def summary_lines(calibration: Calibration) -> list[str]:
    """Return what a calibration found, as lines of text."""
    c = calibration
    lines = [
        f"fitted on {len(c.fits)} presses in {c.fit_seconds:.0f} s, at most "
        f"{max(c.solve_counts.values())} solves of a press"
    ]
    for index, parameter in enumerate(c.problem.parameters):
        for label, combination in (("joint", c.joint), ("median", c.median)):
            shown = _shown(c, parameter, index, combination)
            text = f"{shown['value']:.5g} [{shown['low']:.5g}, {shown['high']:.5g}]"
            if combination is c.joint and shown["material"] is not None:
                text += " (the material's own: {:.3g} to {:.3g})".format(*shown["material"])
            if shown["at_bound"]:
                text = f"{shown['value']:.5g}, the end of what is searched and no estimate,"
            lines.append(f"{parameter.name} ({label}): {text} {parameter.unit}".rstrip(" ,"))
    far = far_modulus(c.values.youngs_modulus_pa, c.problem.start.youngs_modulus_pa)
    lines += [] if far is None else [far]
    if c.specification.gel.shape != "dome":
        own_m, found_m = c.problem.start.thickness_m, c.values.thickness_m
        if own_m != found_m:
            lines.append(_face_line(own_m, found_m))
    lines += [one_line(remark) for remark in c.remarks]
    if len(c.fits) == 1:
        lines.append(ONE_PRESS)
    for name in c.frozen:
        reason = f": {c.reasons[name]}" if name in c.reasons else ""
        lines.append(f"{name}: the data do not identify it, and it is kept at its prior{reason}")
    lines += [_identified_line(row) for row in c.identifiability if row.data != "skin and force"]
    if c.scores:
        s = summarize(c.scores)
        lines.append(
            f"held out ({s.presses} presses, {s.frames} frames from 2 mm): skin "
            f"{s.skin_rms_mm:.3f} mm, contact {_figure(s.contact_rms_mm)} mm, normal force "
            f"{_percent(s.normal_force_error)}, tangential {_percent(s.tangential_force_error)}"
        )
    lines += [f"left out: {one_line(omission.reason)}" for omission in c.omissions]
    return lines


def _face_line(own_m: float, found_m: float) -> str:
    """Return where the face of a pad is, and what that asks of poses."""
    way = "lower" if found_m < own_m else "raise"
    return (
        f"face: {1e3 * found_m:.4g} mm above the base, {1e3 * own_m:.4g} before; this file has z = "
        f"0 at the base: {way} poses by {1e3 * abs(own_m - found_m):.3g} mm before you send them "
        "to the simulated sensor (a data set with skin_mesh.npz is moved by itself)"
    )


def _identified_line(row: Identifiability) -> str:
    text = f"deviation {row.deviation:.3g}, before {row.prior_deviation:.3g}"
    if row.information == 0.0:
        text = "no information"
    return f"{row.parameter} from {row.data}: {text}"


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100.0 * value:.1f} %"


def write_report(directory: Path, calibration: Calibration, *, seed: int) -> Path:
    """Write report.json and report.html below a directory; return the page's path."""
    numbers = figures(calibration, seed=seed)
    write_json(directory / FIGURES, numbers)
    page = directory / PAGE
    with whole_file(page) as part:
        html = printable(as_html(page_of(calibration, numbers)))
        part.write_text(html, encoding="utf-8")
    return page


def page_of(calibration: Calibration, numbers: dict[str, Any]) -> Page:
    """Return the report as a page.

    Args:
        calibration: what was found.
        numbers: its `figures`.
    """
    c = calibration
    estimates = Table(
        ("parameter", "before", *(f"{what} (95 %)" for what in _ESTIMATES)),
        tuple(
            (
                f"{name}, {p['unit']}" if p["unit"] else name,
                *(_number(p["prior"]), _estimate(p["joint"])),
                *(_material(p["joint"]), _estimate(p["median"])),
            )
            for name, p in numbers["parameters"].items()
        ),
    )
    identified = Table(
        ("parameter", "from", "information", "deviation after", "before", "identifiable"),
        tuple(
            (
                *(r.parameter, r.data),
                *map(_number, (r.information, r.deviation, r.prior_deviation)),
                "yes" if r.is_told else "no",
            )
            for r in c.identifiability
        ),
    )
    held_out = tuple(
        (name, *(_number(s[key]) for key in _HELD_OUT)) for name, s in numbers["held_out"].items()
    )
    omitted = tuple(omission.reason for omission in c.omissions)
    left_out = Bullets(omitted) if omitted else Paragraph("Nothing.")
    return Page(
        "Calibration of the gel",
        f"Joint fit: {'; '.join(f'{row[0]} {row[2]}' for row in estimates.rows)}",
        (
            Section(
                "Parameters",
                (
                    estimates,
                    *([Paragraph(ONE_PRESS)] if len(c.fits) == 1 else []),
                    *([Bullets(c.remarks)] if c.remarks else []),
                    Paragraph(
                        "Intervals of the fits are bootstraps over presses. An error that all "
                        "presses have in common, such as the "
                        f"{100 * c.problem.noise.force_discretisation:.0f} % that the force is "
                        "stated to have, is in none of them. " + EFFECTIVE + "."
                    ),
                    Gallery(_plot_single_fits(c)),
                ),
            ),
            Section(
                "What the data identify",
                (
                    identified,
                    Paragraph(
                        "Information is Fisher's, with the other parameters known. Deviations "
                        "are with the others free, each within its prior, which to second order "
                        "is the width of the profile likelihood; they are of the coordinate that "
                        "is fitted: the logarithm of E, friction and 1/2 - nu, the others "
                        "themselves. Without force, E has no "
                        "information at all: the skin of a quasi-static press does not depend on "
                        "it. What a fit to surfaces alone calls E is the softness of its contact "
                        "and, in a scheme with inertia, its compressed time."
                    ),
                    Paragraph(_frozen_text(c)),
                    Gallery((_plot_information(c),)),
                ),
            ),
            Section("Misfit, in units of the stated noise", (Gallery((_plot_misfit(c),)),)),
            Section(
                "Held-out presses",
                (Table(("presses", *_HELD_OUT), held_out) if held_out else Paragraph("None."),),
            ),
            Section("Left out", (left_out,)),
            Section(
                "Solves",
                (
                    Paragraph(
                        f"At most {numbers['most_solves']} of a press, {c.fit_seconds:.0f} s. Fits "
                        f"that spent their budget: {', '.join(numbers['unsettled']) or 'none'}. "
                        "Presses with a frame short of the solver's tolerance: "
                        f"{', '.join(numbers['not_converged']) or 'none'}."
                    ),
                    Paragraph(
                        "Commit {commit}, {machine}, {date}, seed {seed}: {command}".format(
                            **numbers
                        )
                    ),
                ),
            ),
        ),
    )


_ESTIMATES = ("joint fit", "the material's own", "median of single fits")
_HELD_OUT = (
    *("skin_rms_mm", "contact_rms_mm", "vertex_rms_mm"),
    *("normal_force_error", "tangential_force_error", "frames"),
)


def _frozen_text(calibration: Calibration) -> str:
    if not calibration.frozen:
        return "The data identify all parameters that were asked for."
    reasons = "".join(f" {name}: {text}." for name, text in calibration.reasons.items())
    return f"Not identifiable, and kept at their priors: {', '.join(calibration.frozen)}.{reasons}"


def _estimate(shown: dict[str, Any]) -> str:
    if shown["at_bound"]:
        return f"{_number(shown['value'])}, the end of what is searched: no estimate"
    return f"{_number(shown['value'])} ({_number(shown['low'])} to {_number(shown['high'])})"


def _material(shown: dict[str, Any]) -> str:
    if shown["material"] is None:
        return "not known"
    low, high = shown["material"]
    return f"{_number(low)} to {_number(high)}"


def _number(value: float | int | None) -> str:
    """Return four digits, without an exponent where that would be longer than the number."""
    if value is None:
        return "-"
    return f"{float(f'{value:.4g}'):.7g}"


MOST_NAMED_ROWS = 100
"""Beyond, a figure of presses would be metres high, and is drawn without their names."""


def _rows_inches(row_inches: float, names: Sequence[str]) -> float:
    return row_inches * min(len(names), MOST_NAMED_ROWS)


def _name_rows(axes: Any, places: NDArray[Any], names: Sequence[str]) -> None:
    if len(names) <= MOST_NAMED_ROWS:
        axes.set_yticks(places, list(map(figure_label, names)))
    else:
        axes.set_ylabel(f"{len(names)} presses")


def _plot_single_fits(calibration: Calibration) -> tuple[ReportImage, ...]:
    """Return an image of each parameter: the fits of single presses, and their combinations."""
    c = calibration
    names = list(c.fits)
    images = []
    for index, parameter in enumerate(c.problem.parameters):
        with page_figure(LARGEST_WIDTH_INCHES, 1.3 + _rows_inches(0.2, names)) as figure:
            axes = figure.add_subplot()
            count = len(c.problem.parameters)
            single = [_value_at(c, index, c.fits[n].best.point[:count]) for n in names]
            axes.plot(single, range(len(names)), "o", label="single press")
            combined = []
            for label, combination, colour in (
                ("joint", c.joint, "tab:green"),
                ("median", c.median, "tab:red"),
            ):
                value = _shown(c, parameter, index, combination)
                axes.axvline(value["value"], color=colour, label=label)
                axes.axvspan(value["low"], value["high"], color=colour, alpha=0.15)
                combined.append(f"{label} {_number(value['value'])}")
            axes.set_xlabel(f"{parameter.name} {parameter.unit}".strip())
            _name_rows(axes, np.arange(len(names)), names)
            axes.ticklabel_format(axis="x", style="sci", scilimits=(-3, 4))
            axes.locator_params(axis="x", nbins=4)
            figure.legend(loc="outside upper center", ncols=3, frameon=False)
            alt = (
                f"{parameter.name} of single presses, {_number(min(single))} to "
                f"{_number(max(single))}, with {' and '.join(combined)}"
            )
            images.append(image_of(figure, name=f"fits_{parameter.name}", alt=alt))
    return tuple(images)


def _plot_information(calibration: Calibration) -> ReportImage:
    rows = calibration.identifiability
    with page_figure(LARGEST_WIDTH_INCHES, 2.6) as figure:
        axes = figure.add_subplot()
        width = 0.8 / len(CHANNEL_SETS)
        for shift, data in enumerate(CHANNEL_SETS):
            shares = [r.deviation / r.prior_deviation for r in rows if r.data == data]
            axes.bar(np.arange(len(shares)) + shift * width, shares, width, label=data)
        axes.set_xticks(np.arange(len(calibration.asked)) + width, calibration.asked)
        axes.set_ylabel("deviation after / before")
        axes.set_yscale("log")
        axes.axhline(0.5, color="black", linewidth=0.8, linestyle="--")
        figure.legend(loc="outside upper center", ncols=3, frameon=False, columnspacing=1.0)
        alt = "Deviation of each parameter after the data over before: " + ", ".join(
            f"{r.parameter} from {r.data} {r.deviation / r.prior_deviation:.2g}" for r in rows
        )
        return image_of(figure, name="information", alt=alt)


def _plot_misfit(calibration: Calibration) -> ReportImage:
    items = list(calibration.linearisations.items())
    names = [name for name, _ in items]
    with page_figure(LARGEST_WIDTH_INCHES, 0.9 + _rows_inches(0.3, names)) as figure:
        axes = figure.add_subplot()
        worst = []
        for shift, channel in enumerate((SKIN, FORCE)):
            sizes = [
                _root_mean_square(lin.loss[channel], lin.count[channel])
                if channel in lin.loss
                else 0.0
                for _, lin in items
            ]
            axes.barh(np.arange(len(items)) + 0.4 * shift, sizes, 0.4, label=channel)
            worst.append(f"{channel} up to {max(sizes):.2g}")
        _name_rows(axes, np.arange(len(items)) + 0.2, names)
        figure.legend(loc="outside upper center", ncols=2, frameon=False)
        alt = f"Misfit of each press in units of noise: {', '.join(worst)}"
        return image_of(figure, name="misfit", alt=alt)
