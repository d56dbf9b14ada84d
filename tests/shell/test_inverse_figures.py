"""Figures of inverse models show what they are given."""

from types import SimpleNamespace

import numpy as np

from jaxnarx.shell.inverse_figures import Panel, authority, gain_signs, traces, unity


def test_traces_draw_every_curve():
    time = np.arange(5.0)
    panels = [
        Panel("TRQ [Nm]", {"asked for": time, "direct": 2 * time}),
        Panel("SA [deg]", {"SA": time**2}),
    ]
    figure = traces(time, panels, "cascade")
    top, low = figure.axes
    assert [line.get_label() for line in top.lines] == ["asked for", "direct"]
    np.testing.assert_array_equal(np.asarray(top.lines[1].get_ydata()), 2 * time)
    # One curve needs no legend.
    assert top.get_legend() is not None and low.get_legend() is None
    assert low.get_xlabel() == "time [s]" and top.get_title("left") == "cascade"


def test_unity_leaves_out_points_that_do_not_rest():
    gain = np.array([[[0.9]], [[1.1]], [[7.0]], [[9.0]]])
    value = SimpleNamespace(
        target_names=("TRQ",),
        settled=np.array([True, True, False, True]),
        held=np.array([False, False, False, True]),
        reference=np.arange(4.0)[:, None],
        gain=gain,
        frequency=np.array([0.1, 1.0]),
        response=np.tile(gain[:, None], (1, 2, 1, 1)) + 0j,
    )
    top, low = unity({"direct": value}).axes
    np.testing.assert_array_equal(np.asarray(top.lines[0].get_ydata()), [0.9, 1.1])
    np.testing.assert_allclose(np.asarray(low.lines[0].get_ydata()), 1.0)


def test_signs_stand_where_they_are():
    place = np.array([[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]])
    gains = {"model": np.array([-1.0, 1.0, 2.0]), "bed": np.array([-1.0, -1.0, 1.0])}
    left, right = gain_signs(place, gains, ("EGR", "VGT")).axes
    assert [np.size(line.get_xdata()) for line in left.lines] == [1, 2]
    np.testing.assert_array_equal(np.asarray(right.lines[1].get_xdata()), [4.0])


def test_errors_of_the_spark_by_distance():
    late = np.repeat([-10.0, 0.5], 20)
    wrong = np.repeat([1.0, 3.0], 20)
    _, right = authority(late, -0.05 * late, {"inverse": wrong}).axes
    np.testing.assert_allclose(np.asarray(right.lines[0].get_ydata()), [1.0, 3.0])
    np.testing.assert_allclose(np.asarray(right.lines[0].get_xdata()), [-10.0, 0.5])
