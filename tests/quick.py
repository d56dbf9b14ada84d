"""An environment in which programs compile quickly: for tests, and for pages.

Compilation is nearly all of their time, and there nothing is compiled to be run often.
"""

import os
import subprocess
import sys

FLAG = "--xla_cpu_use_fusion_emitters=false"
"""XLA's older code generator: programs compile in a third of the time."""


def compile_quickly(cache: str) -> None:
    """To be called before jax is imported; child processes inherit it.

    What one process has compiled the others and later runs load from `cache`.
    """
    os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", cache)
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    if FLAG not in os.environ.get("XLA_FLAGS", ""):
        flags = f"{os.environ.get('XLA_FLAGS', '')} {FLAG}".strip()
        if _starts_with(flags):
            os.environ["XLA_FLAGS"] = flags


def _starts_with(flags: str) -> bool:
    """Whether jaxlib starts with these flags; one that it does not know makes it abort.

    Asked in a child process once a run: workers and children inherit the answer.
    """
    client = "from jaxlib.xla_client import make_cpu_client as c; c()"
    environment = os.environ | {"XLA_FLAGS": flags}
    done = subprocess.run(
        [sys.executable, "-c", client], env=environment, capture_output=True
    )
    return done.returncode == 0
