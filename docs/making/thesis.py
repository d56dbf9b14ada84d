"""The thesis's experiments, told by their scripts' own words, with their pictures."""

import ast

from docstrings import markdown
from markdown_tables import EXPERIMENTS

FOLDER = EXPERIMENTS / "thesis"
CHAPTERS = (
    *("chapter3_test_beds", "chapter4_siso", "chapter5_miso"),
    *("chapter6_optimal_excitation", "chapter6_local_models", "chapter6_lolimot"),
    *("chapter7_forward", "chapter7_inverse", "by_identify"),
)
PICTURES = {
    "chapter3_test_beds": ("steady", "diesel_steps"),
    "chapter4_siso": ("chapter4_narx", "chapter4_fits"),
    "chapter5_miso": ("chapter5_TRQ", "chapter5_spread"),
    "chapter6_optimal_excitation": ("chapter6_optimal_excitation",),
    "chapter6_local_models": ("chapter6_local_models",),
    "chapter6_lolimot": ("chapter6_lolimot",),
    "chapter7_forward": ("chapter7_forward",),
    "chapter7_inverse": ("chapter7_inverse_tracking",),
}
"""Those that a page shows; `experiments/thesis/results` has all."""


def made() -> dict[str, str]:
    """One part of a page: set-up, differences and outcome of every script."""
    return {"_experiments.md": "\n\n".join(map(_told, CHAPTERS)) + "\n"}


def _told(name: str) -> str:
    tree = ast.parse((FOLDER / f"{name}.py").read_text(encoding="utf-8"))
    title, _, words = (ast.get_docstring(tree) or "").partition("\n\n")
    pictures = "\n\n".join(
        f"![{p}](../../experiments/thesis/results/{p}.png)"
        for p in PICTURES.get(name, ())
    )
    head = " ".join(title.split()).rstrip(".")
    script = f"`experiments/thesis/{name}.py`"
    return f"## {head}\n\n{script}\n\n{markdown(words, {})}\n{pictures}"
