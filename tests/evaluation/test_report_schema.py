"""The keys of `report.json` and what stands under each: scripts rely on them.

A key that goes or changes its kind breaks them; one that is new is added to the
recorded file, `python tests/evaluation/test_report_schema.py` writes it.
"""

import json
import sys
from pathlib import Path
from typing import Any

RECORDED = Path(__file__).parents[1] / "reference" / "report_schema.json"
NUMBERED = "[]"


def kinds(value: Any, path: str = "") -> dict[str, str]:
    """What stands at every path: a text, a number, a truth value, or nothing known."""
    if isinstance(value, dict):
        parts = [kinds(item, f"{path}.{key}") for key, item in value.items()]
    elif isinstance(value, list):
        parts = [kinds(item, path + NUMBERED) for item in value]
    else:
        return {path: _kind(value)}
    found = {path: "object" if isinstance(value, dict) else "list"}
    for part in parts:
        for key, kind in part.items():
            if found.get(key, "null") == "null":
                found[key] = kind
    return found


def _kind(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "truth"
    # An infinite figure is a text.
    is_number = isinstance(value, int | float) or value in ("inf", "-inf")
    return "number" if is_number else "text"


def report_values() -> dict[str, Any]:
    """A report with all that the verbs put into it, as it stands in the file."""
    import common

    import jaxnarx as jnx

    network, records = common.named("by inputs"), common.dataset((120, 110, 45))
    parts = {"train": records[:2], "test": records[2:]}
    network = jnx.confidence.fit_domain(network, parts["train"])
    network = jnx.confidence.fit_error_model(network, parts["train"])
    beside = {"other": common.named("one model")}
    found = jnx.report(network, parts, beside=beside, within=1.0)
    return json.loads(json.dumps(found.to_dict(), allow_nan=False))


def test_no_key_of_the_report_is_lost_and_none_changes_its_kind():
    recorded = json.loads(RECORDED.read_text())
    found = kinds(report_values())
    assert sorted(set(recorded) - set(found)) == []
    assert sorted(set(found) - set(recorded)) == [], "record them, see above"
    known = {p: k for p, k in found.items() if "null" not in (k, recorded[p])}
    assert known == {p: recorded[p] for p in known}


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))
    table = kinds(report_values())
    RECORDED.write_text(json.dumps(table, indent=1, sort_keys=True) + "\n")
