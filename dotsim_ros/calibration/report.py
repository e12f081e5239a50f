"""The report of a calibration: figures as JSON, a page with plots, and lines for a terminal."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.calibration.loss import FORCE, SKIN
from dotsim_ros.calibration.parameters import (
    Parameter,
    shown_value,
    with_coordinates,
)
from dotsim_ros.calibration.run import Calibration
from dotsim_ros.calibration.statistics import CHANNEL_SETS, Combination, Identifiability
from dotsim_ros.evaluation.geometry import by_indenter, summarize
from dotsim_ros.evaluation.provenance import provenance, write_json

Array = NDArray[np.float64]


def figures(calibration: Calibration, *, seed: int) -> dict[str, Any]:
    """Return all figures of a calibration, ready for JSON."""
    c = calibration
    parameters = c.problem.parameters
    return {
        **provenance(),
        "seed": seed,
        "asked": list(c.asked),
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


def _value_at(calibration: Calibration, index: int, point: Array) -> float:
    problem = calibration.problem
    values = with_coordinates(problem.start, problem.parameters, point)
    return shown_value(problem.parameters[index], values)


def _shown(
    calibration: Calibration, parameter: Parameter, index: int, combination: Combination
) -> dict[str, float]:
    """Return value and interval in the parameter's unit; the others stay at the estimate."""
    ends = []
    for end in (combination.low, combination.high):
        point = combination.point.copy()
        point[index] = end[index]
        ends.append(_value_at(calibration, index, point))
    return {
        "value": _value_at(calibration, index, combination.point),
        "low": min(ends),
        "high": max(ends),
    }


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
            lines.append(
                f"{parameter.name} ({label}): {shown['value']:.5g} "
                f"[{shown['low']:.5g}, {shown['high']:.5g}] {parameter.unit}".rstrip()
            )
    lines += [f"{name}: the data do not tell it; kept at its prior" for name in c.frozen]
    lines += [_told_line(row) for row in c.identifiability if row.data != "skin and force"]
    if c.scores:
        s = summarize(c.scores)
        lines.append(
            f"held out ({s.presses} presses, {s.frames} frames from 2 mm): skin "
            f"{s.skin_rms_mm:.3f} mm, contact {_figure(s.contact_rms_mm)} mm, normal force "
            f"{_percent(s.normal_force_error)}, tangential {_percent(s.tangential_force_error)}"
        )
    lines += [f"left out: {omission.reason}" for omission in c.omissions]
    return lines


def _told_line(row: Identifiability) -> str:
    told = f"deviation {row.deviation:.3g} of a prior's {row.prior_deviation:.3g}"
    if row.information == 0.0:
        told = "nothing at all"
    return f"{row.parameter} from {row.data}: {told}"


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100.0 * value:.1f} %"


def write_report(directory: Path, calibration: Calibration, *, seed: int) -> Path:
    """Write report.json and report.html below a directory; return the page's path."""
    numbers = figures(calibration, seed=seed)
    write_json(directory / "report.json", numbers)
    page = directory / "report.html"
    page.write_text(_page(calibration, numbers), encoding="utf-8")
    return page


def _page(calibration: Calibration, numbers: dict[str, Any]) -> str:
    c = calibration
    estimates = [
        [name, _number(p["prior"])]
        + [
            f"{_number(p[kind]['value'])} ({_number(p[kind]['low'])} to {_number(p[kind]['high'])})"
            for kind in ("joint", "median")
        ]
        + [p["unit"]]
        for name, p in numbers["parameters"].items()
    ]
    told = [
        [
            r.parameter,
            r.data,
            _number(r.information),
            _number(r.deviation),
            _number(r.prior_deviation),
            "yes" if r.is_told else "no",
        ]
        for r in c.identifiability
    ]
    held_out = [
        [name, *(_number(s[key]) for key in _HELD_OUT)] for name, s in numbers["held_out"].items()
    ]
    parts = [
        "<h1>Calibration of the gel</h1>",
        f"<p>{html.escape(_origin(numbers))}</p>",
        "<h2>Parameters</h2>",
        _table(["", "before", "joint fit (95 %)", "median of single fits (95 %)", ""], estimates),
        "<p>Intervals are bootstraps over presses. An error that all presses have in common, such "
        f"as the {100 * c.problem.noise.force_discretisation:.0f} % that the force is stated to "
        "have, is in none of them.</p>",
        _image(_plot_single_fits(c)),
        "<h2>What the data can tell</h2>",
        _table(["parameter", "from", "information", "deviation after", "before", "told"], told),
        "<p>Deviations are of the coordinate that is fitted: the logarithm of E, friction and "
        "1/2 - nu, the others themselves. Without force, E has no information at all: the skin of "
        "a quasi-static press does not depend on it. What a fit to surfaces alone calls E is the "
        "softness of its contact and, in a scheme with inertia, its compressed time.</p>",
        _frozen_paragraph(c),
        _image(_plot_information(c)),
        "<h2>Misfit, in units of the stated noise</h2>",
        _image(_plot_misfit(c)),
        "<h2>Held-out presses</h2>",
        _table(["", *_HELD_OUT], held_out) if held_out else "<p>None.</p>",
        "<h2>Left out</h2>",
        _list([omission.reason for omission in c.omissions]),
        "<h2>Solves</h2>",
        f"<p>At most {numbers['most_solves']} of a press, {c.fit_seconds:.0f} s. Fits that spent "
        f"their budget: {html.escape(', '.join(numbers['unsettled']) or 'none')}. Presses with a "
        "frame short of the solver's tolerance: "
        f"{html.escape(', '.join(numbers['not_converged']) or 'none')}.</p>",
    ]
    return (
        "<!doctype html><html><head><meta charset='utf-8'><title>Calibration</title><style>"
        "body{font-family:sans-serif;max-width:60em;margin:2em auto}td,th{padding:.2em .8em;"
        "text-align:left;border-bottom:1px solid #ccc}table{border-collapse:collapse}img{"
        "max-width:100%}</style></head><body>" + "\n".join(parts) + "</body></html>\n"
    )


_HELD_OUT = (
    "skin_rms_mm",
    "contact_rms_mm",
    "vertex_rms_mm",
    "normal_force_error",
    "tangential_force_error",
    "frames",
)


def _origin(numbers: dict[str, Any]) -> str:
    return (
        f"Commit {numbers['commit']}, {numbers['machine']}, {numbers['date']}, seed "
        f"{numbers['seed']}: {numbers['command']}"
    )


def _frozen_paragraph(calibration: Calibration) -> str:
    if not calibration.frozen:
        return "<p>The data tell all parameters that were asked for.</p>"
    return (
        f"<p>Not told, and kept at their priors: {html.escape(', '.join(calibration.frozen))}.</p>"
    )


def _number(value: float | int | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["<tr>" + "".join(f"<th>{html.escape(cell)}</th>" for cell in head) + "</tr>"]
    lines += [
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    ]
    return "<table>" + "".join(lines) + "</table>"


def _list(items: Sequence[str]) -> str:
    if not items:
        return "<p>Nothing.</p>"
    return "<ul>" + "".join(f"<li>{html.escape(item)}</li>" for item in items) + "</ul>"


def _image(figure: Any) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f"<p><img alt='plot' src='data:image/png;base64,{data}'></p>"


def _axes(count: int, height: float) -> tuple[Any, list[Any]]:
    # Not pyplot, which would keep figures and choose a display.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, height), layout="constrained")
    return figure, [figure.add_subplot(1, count, k + 1) for k in range(count)]


def _plot_single_fits(calibration: Calibration) -> Any:
    c = calibration
    names = list(c.fits)
    figure, axes = _axes(len(c.problem.parameters), 1.0 + 0.22 * len(names))
    for index, (parameter, axis) in enumerate(zip(c.problem.parameters, axes, strict=True)):
        count = len(c.problem.parameters)
        single = [_value_at(c, index, c.fits[n].best.point[:count]) for n in names]
        axis.plot(single, range(len(names)), "o", label="single press")
        for label, combination, colour in (
            ("joint", c.joint, "tab:green"),
            ("median", c.median, "tab:red"),
        ):
            shown = _shown(c, parameter, index, combination)
            axis.axvline(shown["value"], color=colour, label=label)
            axis.axvspan(shown["low"], shown["high"], color=colour, alpha=0.15)
        axis.set_xlabel(f"{parameter.name} {parameter.unit}".strip())
        axis.set_yticks(range(len(names)), names if index == 0 else [""] * len(names), fontsize=7)
    axes[0].legend(fontsize=7)
    return figure


def _plot_information(calibration: Calibration) -> Any:
    rows = calibration.identifiability
    figure, (axis,) = _axes(1, 3.0)
    width = 0.8 / len(CHANNEL_SETS)
    for shift, data in enumerate(CHANNEL_SETS):
        shares = [r.deviation / r.prior_deviation for r in rows if r.data == data]
        axis.bar(np.arange(len(shares)) + shift * width, shares, width, label=data)
    axis.set_xticks(np.arange(len(calibration.asked)) + width, calibration.asked)
    axis.set_ylabel("deviation after / before")
    axis.set_yscale("log")
    axis.axhline(0.5, color="black", linewidth=0.8, linestyle="--")
    axis.legend(fontsize=8)
    return figure


def _plot_misfit(calibration: Calibration) -> Any:
    items = list(calibration.linearisations.items())
    figure, (axis,) = _axes(1, 1.0 + 0.22 * len(items))
    for shift, channel in enumerate((SKIN, FORCE)):
        sizes = [
            _root_mean_square(lin.loss[channel], lin.count[channel]) if channel in lin.loss else 0.0
            for _, lin in items
        ]
        axis.barh(np.arange(len(items)) + 0.4 * shift, sizes, 0.4, label=channel)
    axis.set_yticks(np.arange(len(items)) + 0.2, [name for name, _ in items], fontsize=7)
    axis.legend(fontsize=8)
    return figure
