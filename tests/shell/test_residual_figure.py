"""Figures of the residual analysis show what was found; the page holds them."""

import dataclasses

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from test_html import EVIL, make, parsed

from jaxnarx.data import Channel
from jaxnarx.evaluation.residual_tests.coefficients import Coefficient, Influence
from jaxnarx.evaluation.residual_tests.correlations import (
    autocorrelation,
    changing_variance,
    higher_order,
    input_correlation,
    output_product,
)
from jaxnarx.evaluation.residual_tests.diagnostics import (
    Diagnostics,
    OutputDiagnostics,
)
from jaxnarx.evaluation.residual_tests.operating_point import bin_by_operating_point
from jaxnarx.evaluation.residual_tests.residual import make_residual
from jaxnarx.evaluation.residual_tests.scalar_tests import ljung_box
from jaxnarx.shell.figures import residuals
from jaxnarx.shell.figures.style import RED
from jaxnarx.shell.report.html import render


@pytest.fixture(scope="module")
def one() -> OutputDiagnostics:
    """A residual that holds the square of its input one sample before."""
    rng = np.random.default_rng(1)
    u, known = rng.normal(size=(1, 300)), np.ones((1, 300), bool)
    e = rng.normal(size=(1, 300)) + np.roll(u, 1, axis=1) ** 2
    residual = make_residual(e, known)
    tests = (
        autocorrelation(residual),
        changing_variance(residual),
        output_product(residual, e),
        input_correlation(residual, u, known, signal=EVIL),
        *higher_order(residual, u, known, e, signal=EVIL),
    )
    point = bin_by_operating_point(residual, np.roll(u[0], 1), variable=EVIL, unit="V")
    assert point is not None
    return OutputDiagnostics(
        output=Channel("NOx", "ppm"),
        samples=300,
        parameters=1.0,
        mean=residual.mean,
        deviation=residual.deviation,
        estimated="no",
        errors=(e[0],),
        lag_tests=tests,
        scalar_tests=(ljung_box(residual, tests[0]),),
        operating_points=(point,),
        coefficients=(
            Coefficient(1, f"{EVIL}[t-1]", 2.0, 0.1, 20.0, 1e-9, 0.5),
            Coefficient(1, "1", 2.0, None, None, None, None),
        ),
        condition=(12.0,),
        influences=(Influence(EVIL, 0.3, 0.02, 1.0, 0.1),),
    )


def test_the_lag_outside_its_band_is_red(one):
    figure = residuals.correlations(one)
    square = next(a for a in figure.axes if a.get_title(loc="left").startswith("u²,"))
    red = [x for x in square.lines if x.get_color() == RED]
    assert [np.asarray(x.get_xdata()).tolist() for x in red] == [[1]]
    assert len(figure.axes) == 6


def test_bins_whose_mean_is_off_are_red(one):
    figure = residuals.operating_points(one)
    assert figure is not None
    (axes,) = figure.axes
    bars = [c for c in axes.collections if isinstance(c, LineCollection)]
    red = [c for c in bars if np.allclose(c.get_color()[0], to_rgba(RED))]
    point = one.operating_points[0]
    off = np.abs(point.mean) > 2 * point.error
    assert off.sum() > 2 and len(red[0].get_segments()) == off.sum()
    assert axes.get_xlabel().endswith("[V]")
    bare = dataclasses.replace(one, operating_points=())
    assert residuals.operating_points(bare) is None


def test_the_page_has_its_section_and_escapes_names(one):
    told = Diagnostics((one,), 20, 0.05)
    assert "Can the model be believed" not in render(make())
    page = render(dataclasses.replace(make(), diagnostics=told))
    assert "Can the model be believed" in page and "<script" not in page
    assert "script" not in parsed(page).tags
    assert "speak against the model" in page and "Cook's distance" in page
    assert page.count("<svg") == render(make()).count("<svg") + 2
