"""Exports fed with junk, which is held, flagged and forgotten; hostile names."""

import dataclasses
import math
import sys
from pathlib import Path

import common
import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1] / "exporters"))

from test_missing_inputs import (  # pyright: ignore[reportMissingImports]
    JUNK,
    Compiled,
    absent,
    held,
)
from test_targets import (  # pyright: ignore[reportMissingImports]
    NETWORKS,
    narrowed,
)

from jaxnarx.data import Channel, Channels
from jaxnarx.exporters import export, lower, octave, runners
from jaxnarx.exporters.fmu.prove import fmu_runner
from jaxnarx.exporters.target import as_bytes
from jaxnarx.models import NAN, OUTSIDE, input_memory, set_nan_policy

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(runners.compiler() is None, reason="there is no C compiler"),
]

RUNNERS = {
    "c": lambda folder, p: runners.c_runner(folder, p, folder, single=False),
    "fmu2": lambda folder, p: fmu_runner(folder, p, 2),
    "fmu3": lambda folder, p: fmu_runner(folder, p, 3),
    "python": lambda folder, p: runners.python_runner(folder / "m.py"),
}
if runners.node():
    RUNNERS["javascript"] = lambda folder, p: runners.javascript_runner(
        folder / "m.mjs"
    )


def pick(rng: np.random.Generator, options):
    options = list(options)
    return options[int(rng.integers(len(options)))]


def fewer(battery, share: int):
    """Cases that take as long as `share` others."""
    return dataclasses.replace(battery, cases=math.ceil(battery.cases / share))


def any_network(rng):
    """A network of the catalogue under some policy, and what the policy is."""
    outside, nan = pick(rng, OUTSIDE), pick(rng, ("hold", NAN))
    names = sorted(set(NETWORKS) - {"hidden"})
    net = narrowed(NETWORKS[pick(rng, names)](), outside)
    return set_nan_policy(net, nan, invalid_after=0.35), outside, nan


def junk(rng, samples: int, *, spikes: bool = True) -> np.ndarray:
    """Inputs with gaps, infinities and spikes: single ones and whole stretches."""
    u = common.signals(samples, int(rng.integers(1000)))[:, :2]
    gone = rng.uniform(size=u.shape) < pick(rng, (0.0, 0.01, 0.3))
    for _ in range(int(rng.integers(0, 4))):
        first = int(rng.integers(0, samples))
        gone[first : first + int(rng.integers(1, 40)), int(rng.integers(2))] = True
    u[gone] = rng.choice([*JUNK, -1e300, 1e30, -1e9], np.count_nonzero(gone))
    high = rng.uniform(size=u.shape) < spikes * pick(rng, (0.0, 0.01))
    u[high] = rng.choice([-1.0, 1.0, 1e3, -1e5], np.count_nonzero(high))
    return u


def test_every_target_holds_flags_and_forgets_junk(battery, tmp_path):
    def attempt(rng):
        net, outside, nan = any_network(rng)
        to, program = pick(rng, RUNNERS), lower(net, "m")
        folder = tmp_path / str(rng.integers(2**60))  # a library is loaded once
        folder.mkdir()
        found = export(net, to=[to], name="m", verify=False)
        for file, content in found.files.items():
            (folder / file).write_bytes(as_bytes(content))
        run = RUNNERS[to](folder, program)
        assert run is not None
        u = junk(rng, int(rng.integers(program.history + 2, 900)))
        y = rng.uniform(-3, 3, (program.history + 1, len(program.computed)))
        y[rng.uniform(size=y.shape) < 0.1] = np.nan
        out, clean = run(u, y), run(held(u, net), y)
        gone = absent(u, net)[program.history :]
        silent = np.isnan(clean[:, 0])
        if NAN in (nan, outside):
            silent = silent | gone
        assert outside == NAN or not np.isnan(clean).any()
        assert not np.isnan(out[~silent]).any()
        assert np.isnan(out[silent]).all() and not np.isinf(out).any()
        np.testing.assert_array_equal(out[~silent], clean[~silent])

    fewer(battery, 6).run(attempt, seconds=120, megabytes=800)


def test_c_flags_what_is_missing_and_recovers(battery, tmp_path):
    """Flags count what is missing; behind it outputs are as if it had never been."""

    def attempt(rng):
        net = narrowed(NETWORKS["filters"](), pick(rng, OUTSIDE))
        net = set_nan_policy(net, pick(rng, ("hold", NAN)), invalid_after=0.35)
        folder = tmp_path / str(rng.integers(2**60))
        folder.mkdir()
        code = Compiled(net, folder)
        # behind numbers that a sensor may give these toys rest where those led them
        u = junk(rng, 700, spikes=False)
        u[-400:] = np.clip(common.signals(400, 5)[:, :2], *0.2 * np.array([[-1], [1]]))
        gone = absent(u, net)
        runs = []
        for inputs in (u, np.where(np.arange(700)[:, None] < 300, u[-1], u)):
            code.begin(inputs[0], np.zeros(len(code.program.computed)))
            flags, outputs = [], []
            for row in inputs:
                out = code.step(row)
                outputs.append(list(out.reported))
                flags.append([getattr(out, name) for name in code.program.flags])
            runs.append((np.array(outputs), np.array(flags)))
        (y, flags), (other, _) = runs
        told = dict(zip(code.program.flags, flags.T, strict=True))
        np.testing.assert_array_equal(told["missing"] > 0, gone)
        assert np.all(told["extrapolated"][gone] == 1)
        assert np.isin(told["extrapolated"], (0, 1)).all()
        count = 0
        for t in range(700):
            count = count + 1 if gone[t] else 0
            began = gone[: t + 1].all()
            assert told["missing"][t] == count or began
            assert told["invalid"][t] == (count >= 4 or began), t
        behind = 300 + math.ceil(15 * input_memory(net))
        np.testing.assert_allclose(y[behind:], other[behind:], atol=1e-3)

    fewer(battery, 6).run(attempt, seconds=120, megabytes=800)


def test_c_runs_a_million_samples_of_junk(battery, tmp_path):
    rng = np.random.default_rng(battery.seed)
    net = set_nan_policy(narrowed(NETWORKS["coupled"](), OUTSIDE[0]), "hold")
    program = lower(net, "m")
    for name, text in export(net, name="m", verify=False).texts.items():
        (tmp_path / name).write_text(text)
    run = runners.c_runner(tmp_path, program, tmp_path, single=False)
    u = common.signals(10**6, battery.seed)[:, :2]
    gone = rng.uniform(size=u.shape) < 0.02
    u[gone] = rng.choice(JUNK, np.count_nonzero(gone))
    y = np.zeros((program.history + 1, len(program.computed)))
    out = run(u, y)
    assert np.isfinite(out).all()
    np.testing.assert_array_equal(out, run(held(u, net), y))


TOKENS = ["/*", "*/", "//", "\\", "??/", "'", '"', '"""', "%{", "%}", "--", "]]>", "<"]
TOKENS += [
    "&amp;",
    "\\u002a/",
    "\\n",
    "#",
    "$x",
    "{0}",
    "${x}",
    "%s",
    "%",
    "`",
    ";",
    "é",
]
TOKENS += ["int", "x", " ", "=1+1", "@", "日本", "../", "/begin", "/end", "!", "\\x41"]


def test_random_hostile_names_go_through_every_target(battery):
    """Proven where there are the programs for it: warnings of compilers are errors."""
    net = common.named("by inputs")
    to = ["c", "fmu2", "fmu3", "python", "javascript", "matlab", "dcm", "a2l"]

    def attempt(rng):
        words = ["".join(rng.choice(TOKENS, rng.integers(1, 9))) for _ in range(8)]
        names = [f"{word}{n}" for n, word in enumerate(words[:4])]
        pairs = [Channel(n, u) for n, u in zip(names, words[4:], strict=True)]
        channels = Channels(tuple(pairs[:2]), tuple(pairs[2:]))
        named = dataclasses.replace(net, channels=channels)
        found = export(named, to=to, name="m")
        assert len(found.files) == 11 and not found.failed
        assert {"c, double", "c, single", "fmu2", "fmu3"} <= set(found.difference)
        assert not octave.octave() or "matlab" in found.difference

    fewer(battery, 30).run(attempt, seconds=120, megabytes=800)
