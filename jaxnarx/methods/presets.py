"""How much an automatic identification tries, and how it chooses."""

PRESETS = {
    "quick": "a minute or two",
    "good": "minutes for every output",
    "best": "an hour, or what the budget says; sums of models where they gain",
    "ecu": "the fewest operations within 5 %, no sums, stable for certain",
    "linear": "linear models only",
}
"""Names of presets, and what is special about them."""
