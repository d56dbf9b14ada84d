"""The page of a report: its size, and the time to its first figure in a browser.

Twenty records of 12,000 samples, six of them for test: three inputs that are held and
filtered, a measured output with noise, a network of three regions refined on the free
run, with its domain and prediction intervals, beside a linear model and the network
before refinement. The page is written, opened from its file by a headless Chromium in a
new profile, and the clock of the browser is read when the first record is drawn.

    python experiments/benchmarks/page.py [--smoke] [--results DIR]
"""

import json
import re
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from common import ROOT, benchmark_parser, child, record, results_folder, target

RECORDS, TEST, SAMPLES, ROUNDS = 20, 6, 12_000, 5
BYTES, SECONDS = 3e6, 2.0
READY = "window.jaxnarx && jaxnarx.page.tried"
FIGURE = "performance.getEntriesByName('first-figure')[0].startTime"
NOTES = {
    "first_figure": "seconds from the start of loading to the first record drawn",
    "everything": "until sliders and step response stand as well",
    "switch": "milliseconds to show another record",
    "run": "milliseconds of the model's free run over a record in the page",
    "surface": "seconds of 1,024 steady states",
    "write": "seconds of writing the page from a report",
}


def records(numbers: range, samples: int) -> Any:
    """A first-order lag behind a product of held inputs, with noise."""
    import numpy as np
    from scipy.signal import lfilter

    from jaxnarx.data import Channel, Dataset

    inputs, outputs = [], []
    for number in numbers:
        rng = np.random.default_rng(number)
        low, high = np.array([800.0, 10.0, 0.0]), np.array([3000.0, 90.0, 40.0])
        held = np.repeat(rng.uniform(low, high, (samples // 40 + 1, 3)), 40, axis=0)
        u = np.asarray(lfilter([0.3], [1, -0.7], held[:samples], axis=0))
        u = u + rng.normal(size=u.shape) * 0.002 * (high - low)  # as sensors are
        drive = 0.002 * u[:, 0] * u[:, 1] * (1 - u[:, 2] / 80)
        y = np.asarray(lfilter([0.1], [1, -0.9], drive))[:, None]
        inputs.append(u)
        outputs.append(y + rng.normal(size=y.shape))
    return Dataset.from_arrays(
        inputs,
        outputs,
        inputs=[Channel("speed", "rpm"), Channel("load", "%"), Channel("egr", "%")],
        outputs=[Channel("NOx", "ppm")],
        sample_time=0.1,
        names=[f"record_{n:02d}" for n in numbers],
    )


def write(path: Path, samples: int, count: int) -> dict[str, Any]:
    """Identify, report and write the page."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import jaxnarx as jnx

    train = records(range(count - TEST), samples)
    test = records(range(count - TEST, count), samples)
    short = train[:3]
    pool = jnx.polynomial_pool(
        train.channels, input_lags=(0, 1), output_lags=(1,), degree=2
    )
    terms = jnx.select(pool, short, jnx.ForwardOLS(max_terms=10)).value
    method = jnx.Lolimot(scheduling=["speed[t]", "load[t]"], max_models=3)
    start = jnx.grow(terms, short, method).value
    network = jnx.refine(start, short, jnx.SimulationError()).value
    network = jnx.confidence.fit_domain(network, short)
    network = jnx.confidence.fit_error_model(network, short)
    found = jnx.report(
        network,
        {"train": train, "test": test},
        stability=False,
        diagnostics=False,
        beside={"before refinement": start},
    )
    begin = time.perf_counter()
    found.to_html(path)
    return {"write": time.perf_counter() - begin, "bytes": path.stat().st_size}


def opened(path: Path, rounds: int) -> dict[str, Any]:
    """Seconds in the browser, of every round in a new profile."""
    sys.path.insert(0, str(ROOT / "tests"))
    from browser import Browser  # pyright: ignore  (of the tests)

    figures: dict[str, Any] = {"first_figure": [], "everything": []}
    more: dict[str, Any] = {}
    for n in range(rounds):
        with Browser() as browser:
            begin = time.perf_counter()
            browser.open(path, ready=READY)
            figures["everything"].append(time.perf_counter() - begin)
            figures["first_figure"].append(browser.value(FIGURE) / 1000)
            if n == rounds - 1:
                more = _used(browser)
    return figures | more


def _used(browser: Any) -> dict[str, Any]:
    """What takes how long once it is there, and how the records are kept."""

    def clock(expression: str) -> float:
        return browser.value(
            f"(async () => {{ const t = performance.now(); {expression};"
            "return performance.now() - t; })()"
        )

    switch = clock("await jaxnarx.page.open(3)")
    browser.value("jaxnarx.page.open(jaxnarx.page.worst())")
    run = clock("document.getElementById('compute-here').click()")
    begin = time.perf_counter()
    browser.value("jaxnarx.page.surface.start()")
    browser.wait("document.getElementById('surface').dataset.done")
    surface = time.perf_counter() - begin
    told = browser.value(
        "[...document.querySelectorAll('#view small')].pop().textContent"
    )
    return {
        "switch": switch,
        "run": run,
        "surface": surface,
        "detail": told.partition("Here: ")[2],
        "browser": browser.send("Browser.getVersion")["product"],
        "requests": [a for a in browser.requests()[1:] if not a.startswith("data:")],
        "errors": browser.errors(),
    }


def shares(path: Path) -> dict[str, int]:
    """Bytes of the page by what they are."""
    text = path.read_text("utf-8")
    data = re.findall(r'<script type="application/json".*?</script>', text, flags=re.S)
    code = re.findall(r"<script>.*?</script>", text, flags=re.S)
    drawn = re.findall(r"<svg.*?</svg>", text, flags=re.S)
    sizes = {
        name: sum(len(part.encode()) for part in parts)
        for name, parts in (("records", data), ("scripts", code), ("figures", drawn))
    }
    return sizes | {"text": len(text.encode()) - sum(sizes.values())}


def measured(samples: int, count: int, rounds: int) -> dict[str, Any]:
    """All figures."""
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "report.html"
        figures = write(path, samples, count)
        figures |= {"samples": samples, "records": count, "shares": shares(path)}
        return figures | opened(path, rounds)


def main() -> None:
    """Run what the command line asks for."""
    parser = benchmark_parser("The page of a report.", "8 records of 400 samples")
    chosen = parser.parse_args()
    if chosen.worker:
        print(json.dumps(measured(**json.loads(chosen.worker[1]))))
        return
    options = {"samples": SAMPLES, "count": RECORDS, "rounds": ROUNDS}
    if chosen.smoke:
        options = {"samples": 400, "count": 8, "rounds": 1}
    words = [sys.executable, __file__, "--worker", "measured", json.dumps(options)]
    done = child(words)
    if done.code != 0:
        sys.exit(done.stderr)
    figures = json.loads(done.stdout.splitlines()[-1]) | {"notes": NOTES}
    browser = figures.pop("browser")
    middle = sorted(figures["first_figure"])[len(figures["first_figure"]) // 2]
    figures["targets"] = {
        "bytes": target(figures["bytes"], BYTES),
        "first_figure": target(middle, SECONDS),
    }
    folder = results_folder(chosen.results, smoke=chosen.smoke)
    path = record(
        "page",
        figures,
        folder=folder,
        note=chosen.note,
        versions={"browser": browser},
    )
    print(path, json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
