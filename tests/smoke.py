"""How the tests run experiments with `--smoke`, and what every record holds."""

import json
import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "experiments" / "benchmarks"


def run(script: str, *arguments: str, results: Path) -> dict[str, dict[str, Any]]:
    """Run a benchmark; the recorded files by name, checked for what all share."""
    command = [sys.executable, str(FOLDER / script), "--smoke", *arguments]
    done = subprocess.run(
        [*command, "--results", str(results)],
        cwd=results.parent,
        env=_environment(),
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert done.returncode == 0, done.stderr
    files = {path.stem: path for path in results.iterdir()}
    assert {path.suffix for path in files.values()} == {".json"}
    return {name: check(path, results) for name, path in files.items()}


def check(path: Path, results: Path) -> dict[str, Any]:
    text = path.read_text(encoding="utf-8")
    for private in (str(results), str(ROOT), str(Path.home()), platform.node()):
        assert len(private) < 4 or private not in text
    content = json.loads(text)
    assert content["benchmark"] == path.stem
    assert content["command"].startswith("python experiments/benchmarks/")
    assert set(content["versions"]) >= {"python", "jax", "jaxlib", "numpy", "jaxnarx"}
    assert content["machine"]["cores"] == os.cpu_count()
    assert set(content["code"]) == {"commit", "dirty"}
    return content["figures"]


def assert_target(row: dict[str, Any]) -> None:
    assert row["met"] == (row["value"] <= row["limit"])


def experiment(script: str, *arguments: str) -> subprocess.CompletedProcess:
    """Run an experiment small; it must end well."""
    done = subprocess.run(
        [sys.executable, str(ROOT / "experiments" / script), "--smoke", *arguments],
        env=_environment(),
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert done.returncode == 0, done.stderr
    return done


def _environment() -> dict[str, str]:
    """That of the tests, with the folder of measured data where tests look for it."""
    folder = Path(os.environ.get("JAXNARX_DATA", ROOT / "../shared/data")).resolve()
    return os.environ | ({"JAXNARX_DATA": str(folder)} if folder.is_dir() else {})
