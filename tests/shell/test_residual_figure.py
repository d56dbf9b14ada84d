"""Figures of the residual analysis show what was found; the page holds them."""

import dataclasses

import numpy as np
import pytest
from test_html import EVIL, make, parsed

from jaxnarx.data import Channel
from jaxnarx.evaluation import Chart, Curve
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


def marked(chart: Chart, colour: str) -> list[float]:
    """Places of the dots of a colour."""
    curves = [m for m in chart.marks if isinstance(m, Curve) and m.marker]
    return [x for m in curves if m.colour == colour for x in m.points[0].tolist()]


def test_the_lag_outside_its_band_is_red(one):
    charts = residuals.correlations(one).charts
    square = next(c for c in charts if c.title.startswith("u²,"))
    assert marked(square, "red") == [1.0]
    assert len(charts) == 6


def test_bins_whose_mean_is_off_are_red(one):
    picture = residuals.operating_points(one)
    assert picture is not None
    (chart,) = picture.charts
    point = one.operating_points[0]
    off = np.abs(point.mean) > 2 * point.error
    assert off.sum() > 2 and len(marked(chart, "red")) == off.sum()
    assert chart.x_label.endswith("[V]")
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
