"""Settings of every test: float64, strict promotion, run-time shape checks."""

import gc
import os
import shutil
import signal
from pathlib import Path

from quick import compile_quickly, share_contexts

# Two may write one file at once: who reads half of it compiles (the warning is let
# through in pyproject.toml).
compile_quickly(str(Path(__file__).parents[1] / ".pytest_cache" / "compiled"))

import jax  # noqa: E402
import programs  # noqa: E402
import pytest  # noqa: E402
import shape_checks  # noqa: E402

# Begun in the background of a script we would ignore Ctrl-C, and so would every process
# that a test starts and interrupts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

share_contexts()
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

# The slow tests of CI do without: see .ci/run.
if not os.environ.get("JAXTYPING_DISABLE"):
    shape_checks.install()

COMPILED = Path(os.environ["JAX_COMPILATION_CACHE_DIR"])
COMPILED_MB = 2_000
"""What is kept for later runs is thrown away beyond this."""

MAPS = 30_000
"""Memory maps of a process beyond which compiled programs are let go behind a file.
Every program takes a few, Linux allows 65,530, and jaxlib ends in a segmentation fault
there; the package lets them go at 39,000, which in the middle of a file would count its
programs twice."""


def pytest_addoption(parser):
    # of tests/robustness; options of conftest files further down are not known in time
    group = parser.getgroup("robustness", "batteries of damaged input")
    group.addoption("--robustness-seed", type=int, default=0, help="another set")
    group.addoption("--robustness-cases", type=int, default=300, help="of each kind")
    group.addoption("--robustness-first", type=int, default=0, help="first case")


def pytest_sessionstart(session):
    ours = COMPILED.is_dir() and COMPILED.parent.name == ".pytest_cache"
    if hasattr(session.config, "workerinput") or not ours:
        return
    if sum(file.stat().st_size for file in COMPILED.iterdir()) > COMPILED_MB * 1e6:
        shutil.rmtree(COMPILED)


def pytest_collection_finish(session):
    # What is imported stays: the garbage collector need not look through it again, and
    # programs are made of many small objects that it finds alive time and again.
    gc.freeze()
    gc.set_threshold(100_000, 20, 100)


@pytest.fixture(autouse=True)
def first_calls():
    """Every test checks its own first calls."""
    shape_checks.next_test()


MADE: dict[str, int] = {}
"""Programs that each file has made in this process."""
WORKERS: list[dict] = []
"""What every process of this run has cost."""


@pytest.fixture(scope="module", autouse=True)
def few_programs(request):
    """Hold a file to its budget of programs, and let them go where too many are left.

    The budget is that of the default tests.
    """
    before = programs.made()
    yield
    file = request.path.relative_to(programs.ROOT).as_posix()
    MADE[file] = number = programs.made() - before
    default = request.config.getoption("markexpr") == "not slow"
    limit = programs.budget(file)
    if default and number > limit:
        pytest.fail(
            f"{file} makes {number} programs, its budget is {limit}: use problems and "
            "settings that other tests have, and numpy outside of what is compiled; "
            f"or record more: python tests/programs.py {file}",
            pytrace=False,
        )
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_text().count("\n") > MAPS:
        jax.clear_caches()
        gc.collect()


def pytest_sessionfinish(session):
    seconds, memory = programs.effort()
    cost = {"files": MADE, "seconds": seconds, "memory": memory}
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["cost"] = cost
    elif not WORKERS:
        WORKERS.append(cost)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    if cost := getattr(node, "workeroutput", {}).get("cost"):
        WORKERS.append(cost)


def pytest_terminal_summary(terminalreporter):
    for line in programs.lines(WORKERS):
        terminalreporter.write_line(line)


@pytest.fixture(scope="session", autouse=True)
def no_layout():
    """Figures are drawn whole, but nobody looks at their margins."""
    from jaxnarx.shell.figures import style

    style.LAYOUT_ENGINE = "none"


@pytest.fixture
def key():
    return jax.random.key(20120501)


@pytest.fixture(scope="session")
def measured() -> Path:
    """Folder of the measured data; tests that need it skip where it is absent."""
    root = Path(os.environ.get("JAXNARX_DATA", "../shared/data"))
    if not root.is_dir():
        pytest.skip(f"measured data not found in {root} (set JAXNARX_DATA)")
    return root
