"""Figures: small, deterministic, and safe whatever a channel is called."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from jaxnarx.shell import figures, style

EVIL = "<script>alert(1)</script> $x_$ & \x07 転"


def trace(n=400, label="NOx [ppm]"):
    t = np.arange(n) * 0.1
    y = np.sin(t)
    limited = (t > 5) & (t < 6)
    return figures.measured_and_simulated(
        t, y, y + 0.1, label=label, title=label, one_step=y - 0.02, limited=limited
    )


def models(*centres):
    return [{"centre": c, "width": np.full(np.shape(c) or 1, 0.2)} for c in centres]


def every(label):
    rng = np.random.default_rng(0)
    y = rng.normal(size=50)
    counts, edges = np.histogram(y * 0.1, 9)
    history = [
        {"iteration": i, "stage": s, "horizon": 10 * (s + 1), "loss": 1 / (i + 1)}
        | {"validation": None if i == 0 else 2 / (i + 1), "damping": 1.0}
        for i, s in enumerate([0, 0, 1, 1])
    ]
    one = dict(before=models(0.2, 0.7), after=models([0.3], [0.6]))
    two = dict(before=models([0.2, 0.3]), after=models([0.2, 0.3], [0.7, 0.6]))
    cloud = rng.random((9, 2))
    criteria = {"AIC": [3.0, 1.0, None], "BIC": [3.0, 2.0, 2.5]}
    names = [label, "b", "c"]
    return [
        trace(label=label),
        figures.agreement(y, y * 1.1, counts, edges, label=label, unit=label),
        figures.selection_path(names, [0.9, 0.09, 0.01], criteria=criteria),
        figures.selection_path(names[:1], [1.0]),
        figures.refinement(history),
        figures.partition([label], [(0, 1)], **one, cloud=y[:, None]),
        figures.partition([label, "load"], [(0, 1)] * 2, **two, cloud=cloud),
        figures.partition([label] * 3, [(0, 1)] * 3, after=models([0.1, 0.2, 0.3])),
    ]


@pytest.mark.parametrize("i", range(8))
def test_figures_draw_any_channel_name_as_text(i):
    figure = every(EVIL)[i]
    assert isinstance(figure, Figure)
    page = style.inline_svg(figure, "f1-", EVIL.replace("\x07", ""))
    assert "<script" not in page and "http" not in page
    if i not in (4,):
        assert "&lt;script&gt;alert(1)&lt;/script&gt;" in page.split(">", 1)[1]


def test_svg_is_deterministic_and_its_text_is_text():
    first, second = figures.svg(trace()), figures.svg(trace())
    assert first == second
    assert "NOx [ppm]" in first and "dc:date" not in first


def test_identifiers_of_inline_figures_do_not_meet():
    import re

    a, b = (style.inline_svg(trace(), p, "t") for p in ("a-", "b-"))
    ids = [set(re.findall(r' id="([^"]+)"', s)) for s in (a, b)]
    assert ids[0] and not ids[0] & ids[1]
    used = set(re.findall(r"(?:url\(|href=\")#([^)\"]+)", a))
    assert used and used <= ids[0]


@pytest.mark.parametrize("n", [1, 2, 1500, 1501, 100_000])
def test_envelope_is_short_and_keeps_every_peak(n):
    rng = np.random.default_rng(n)
    t, y = np.arange(n) * 0.01, rng.normal(size=n)
    time, value = figures.envelope(t, y)
    assert len(value) <= 1500 and np.all(np.diff(time) >= 0)
    assert value.max() == y.max() and value.min() == y.min()


def test_a_long_record_stays_a_small_figure():
    assert len(style.inline_svg(trace(200_000), "f", "t")) < 250_000


def test_validity_sums_to_one_however_far():
    from jaxnarx.shell.partition_figure import validity

    z = np.array([[0.2], [0.5], [0.9], [1e6]])
    phi = validity(z, np.array([[0.2], [0.5]]), np.array([[0.2], [0.05]]))
    np.testing.assert_allclose(phi.sum(1), 1, rtol=1e-12)
    # DESIGN section 5: Gaussians of unequal width reactivate far away.
    np.testing.assert_allclose(phi[:3, 0], [1.0, 0.245085, 1.0], atol=5e-7)


def test_save_writes_whole_files(tmp_path):
    for name in ("a.svg", "a.png"):
        figures.save(trace(), tmp_path / name)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "a.svg"]
    with pytest.raises(ValueError, match="saved as"):
        figures.save(trace(), tmp_path / "a.pdf")
