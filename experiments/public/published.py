"""Published free-run figures on the tests, with their source and how certain they are.

Certain: `read` in the primary text, notebook or table; `paper` taken from the tables of
a paper at second hand; `quoted` from an abstract or another's quotation; `doubtful`
where something speaks against it. Parts are those of `experiments/open_sets/sets.py`.
Not all are from the same starting window: before February 2025 tests of tanks and
drives began with 5 and 4 samples.
"""

from typing import Any

CHAMPNEYS = "Champneys et al. 2024, arXiv 2405.10779, and works it lists"
TSFAST = "TSFast defaults, three seeds, table of its repository"


def figure(method: str, source: str, certain: str, **rmse: float) -> dict[str, Any]:
    """A published figure; RMSE by part, `_` for a space."""
    parts = {part.replace("_", " "): value for part, value in rmse.items()}
    return {"method": method, "source": source, "certain": certain, "rmse": parts}


PUBLISHED: dict[str, list[dict[str, Any]]] = {
    "cascaded_tanks": [
        figure("grey box", "Worden 2018", "paper", test=0.191),
        figure("CT-SUBNET", CHAMPNEYS, "paper", test=0.306),
        figure("TSEM", CHAMPNEYS, "paper", test=0.33),
        figure("SUBNET", CHAMPNEYS, "paper", test=0.37),
        figure("GRU", CHAMPNEYS, "paper", test=0.396),
        figure("polynomial NARX", CHAMPNEYS, "paper", test=0.413),
        figure("PNLSS", CHAMPNEYS, "paper", test=0.45),
    ],
    "ced_coupled_drives": [
        figure("LSTM", TSFAST, "read", low_amplitude=0.045, high_amplitude=0.06),
        figure("GRU", TSFAST, "read", low_amplitude=0.051, high_amplitude=0.07),
        figure("GP NARX", CHAMPNEYS, "paper", low_amplitude=0.102, high_amplitude=0.09),
        figure(
            *("polynomial NARX", CHAMPNEYS, "paper"),
            low_amplitude=0.1,
            high_amplitude=0.141,
        ),
        figure(
            "CT-SUBNET", CHAMPNEYS, "paper", low_amplitude=0.115, high_amplitude=0.074
        ),
    ],
    "silverbox": [
        figure(
            *("GRU", TSFAST, "read"),
            multisine=0.32,
            arrow=1.48,
            arrow_without_extrapolation=0.315,
        ),
        figure("PNLSS", CHAMPNEYS, "paper", arrow=0.26),
        figure(
            *("GP NARX", CHAMPNEYS, "paper"),
            multisine=0.3,
            arrow=0.6,
            arrow_without_extrapolation=0.26,
        ),
        figure(
            *("SUBNET", CHAMPNEYS, "doubtful"),
            multisine=0.36,
            arrow=1.4,
            arrow_without_extrapolation=0.32,
        ),
        figure(
            *("polynomial NARX", CHAMPNEYS, "paper"),
            multisine=0.64,
            arrow=2.25,
            arrow_without_extrapolation=0.571,
        ),
    ],
    "wiener_hammerstein": [
        figure("SUBNET", CHAMPNEYS, "paper", test=0.241),
        figure("best linear approximation", "Schoukens 2014", "quoted", test=0.28),
        figure("PNLSS", CHAMPNEYS, "paper", test=0.42),
        figure("dynoNet", "dynoNet; 1.2 in its preprint", "doubtful", test=0.452),
        figure("GRU", TSFAST, "read", test=0.58),
        figure("polynomial NARX", CHAMPNEYS, "paper", test=27.3),
    ],
    "bouc_wen_sysidentpy": [
        figure("FROLS", "documentation of SysIdentPy", "read")
        | {"nrmse": {"test": 0.0451}},
    ],
    "daisy_cstr": [],
}
"""RMSE in the unit of the set, for the damper NRMSE; for the reactor none is known."""
