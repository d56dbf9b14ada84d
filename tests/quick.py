"""An environment in which programs compile quickly: for tests, and for pages.

Compilation is nearly all of their time, and there nothing is compiled to be run often.
"""

import os
import subprocess
import sys
import threading

FLAGS = (
    # XLA's older code generator: programs compile in a third of the time.
    "--xla_cpu_use_fusion_emitters=false",
    # Programs whole, not in parts side by side: a seventh less work, for workers are
    # side by side as it is.
    "--xla_cpu_parallel_codegen_split_count=1",
)


def compile_quickly(cache: str) -> None:
    """To be called before jax is imported; child processes inherit it.

    What one process has compiled the others and later runs load from `cache`.
    """
    os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")
    # Nobody looks up in a program which line an operation comes from.
    os.environ.setdefault("JAX_TRACEBACK_IN_LOCATIONS_LIMIT", "0")
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", cache)
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    known = os.environ.get("XLA_FLAGS", "").split()
    if missing := [flag for flag in FLAGS if flag not in known]:
        flags = " ".join([*known, *missing])
        if _starts_with(flags):
            os.environ["XLA_FLAGS"] = flags


def share_contexts() -> None:
    """One context of the compiler for all programs of a thread, not one for each.

    To be called when jax is imported. A context takes 3 ms and more than a megabyte,
    which stays as long as the program does. It is no public part of jax: without it
    everything runs as before.
    """
    from jax._src.interpreters import mlir

    make = getattr(mlir, "make_ir_context", None)
    if make is None:
        return
    from jaxlib.mlir import ir

    own = threading.local()

    def writing() -> bool:
        """Whether a program is written right now, within which another one begins."""
        try:
            return ir.InsertionPoint.current is not None
        except ValueError:
            return False

    def shared() -> object:
        if writing():
            return make()
        if not hasattr(own, "context"):
            own.context = make()
        return own.context

    mlir.make_ir_context = shared  # pyright: ignore[reportPrivateImportUsage]


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
