"""An analysis of reports: at which frequencies the error of the free run lies.

The spectrum is the mean periodogram of half-overlapping stretches with a Hann window
(P. D. Welch, 1967); stretches with a sample that does not count are left out.
"""

import numpy as np

from jaxnarx.evaluation import ANALYSES, Chart, Curve, Section

SAMPLES = 256
"""Length of a stretch."""


def periodograms(error, step):
    """The periodograms of all complete stretches [unit^2/Hz]."""
    window = np.hanning(SAMPLES)
    scale = 2 * step / np.sum(window**2)
    for begin in range(0, len(error) - SAMPLES + 1, SAMPLES // 2):
        stretch = error[begin : begin + SAMPLES]
        if np.all(np.isfinite(stretch)):
            yield scale * np.abs(np.fft.rfft(window * (stretch - stretch.mean()))) ** 2


def spectrum(run):
    """The spectrum of every output's error, and the frequency below which half of it
    lies; None where no record is long enough."""
    step = run.data.sample_time
    frequency = np.fft.rfftfreq(SAMPLES, step)[1:]
    rows, curves = [], []
    for o, channel in enumerate(run.outputs):
        every = [p for error in run.errors(o) for p in periodograms(error, step)]
        if not every:
            continue
        power = np.mean(every, axis=0)[1:]
        share = np.cumsum(power) / power.sum() if power.sum() else np.ones(len(power))
        half = float(frequency[np.searchsorted(share, 0.5)])
        rows.append((channel.name, len(every), half, float(share[len(share) // 10])))
        curves.append(Curve(channel.name, frequency, np.sqrt(power)))
    if not rows:
        return None
    slow = [name for name, _, _, share in rows if share > 0.9]
    told = [f"The error of {name} is slow: a drift, not noise." for name in slow]
    return Section(
        "Spectrum of the free-run error",
        tuple(told),
        ("output", "stretches", "half below [Hz]", "share of the lowest tenth"),
        tuple(rows),
        (Chart(tuple(curves), "frequency [Hz]", "amplitude density", log="xy"),),
        f"Mean of half-overlapping stretches of {SAMPLES} samples, with a Hann window.",
    )


ANALYSES.register("spectrum", spectrum)
