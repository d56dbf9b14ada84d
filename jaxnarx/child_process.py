"""Start Python processes: none imports what lies in the current folder, and those that
share the cores with others keep to one thread.

`python -c` and multiprocessing's `spawn` put the current folder first on the module
path, so a `json.py` beside the data would be executed. `-P` and `PYTHONSAFEPATH`
prevent that (Python 3.11).
"""

import os
import sys
from collections.abc import Mapping

SAFE_ENVIRONMENT = {"PYTHONSAFEPATH": "1"}
"""Environment of a Python process and of those that it starts."""

_THREAD_POOLS = ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "VECLIB_MAXIMUM")
_ONE_THREAD = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"


def python_command(code: str, *arguments: str) -> list[str]:
    """Words that run `code` in a Python without the current folder on its path."""
    return [sys.executable, "-P", "-c", code, *arguments]


def one_thread() -> dict[str, str]:
    """Environment of a process whose linear algebra and XLA keep to one thread."""
    flags = f"{os.environ.get('XLA_FLAGS', '')} {_ONE_THREAD}".strip()
    return {f"{name}_NUM_THREADS": "1" for name in _THREAD_POOLS} | {"XLA_FLAGS": flags}


def python_environment(given: Mapping[str, str] | None = None) -> dict[str, str]:
    """This process's environment, `given` and module path, the current folder last.

    A notebook has the current folder on its path; a pickle of one of its modules finds
    it there, yet no module of Python or of a package is shadowed.
    """
    here = os.getcwd()
    elsewhere = [p for p in sys.path if p and os.path.abspath(p) != here]
    last = [here] if len(elsewhere) < len(sys.path) else []
    paths = os.pathsep.join([*elsewhere, *last])
    return os.environ | dict(given or {}) | SAFE_ENVIRONMENT | {"PYTHONPATH": paths}
