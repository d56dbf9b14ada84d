"""Every experiment runs with `--smoke`; what it records is whole and portable."""

import json
import subprocess
import sys

import numpy as np
import pytest
from smoke import FOLDER, assert_target, experiment, run

from jaxnarx.engines import BEDS


@pytest.mark.slow
def test_selection_with_peers_that_may_be_missing(tmp_path):
    found = run("selection.py", "--peers", results=tmp_path / "results")
    assert set(found) == {"selection"}
    figures = found["selection"]
    (cell,) = figures["cells"].values()
    assert cell["candidates"] == 903 and figures["terms"] == 15
    for one in cell["jaxnarx"].values():
        # The process that made the data: its larger terms must be among the chosen.
        assert {"1", "u1[t-1]", "u2[t-2]", "y[t-1]", "u3[t-5]"} <= set(one["chosen"])
        assert len(one["chosen"]) == 15
        assert 0 < one["compiled"]["wall_s"] < one["first_call"]["wall_s"]
        assert one["memory"]["above_imports_mb"] > 0
    bare = figures["contraction"]
    assert bare["share"] > 0 and 0 < bare["computed"] < 1
    for row in figures["targets"].values():
        assert_target(row)
    for row in figures["at_least"].values():
        assert row["met"] == (row["value"] >= row["at_least"])
    # With peers the script itself fails where SysIdentPy's ordered terms are not ours.
    assert figures["other_terms"] == []
    compared = [
        row for row in cell.get("peers", {}).values() if "same_ordered_terms" in row
    ]
    assert all(row["same_ordered_terms"] for row in compared)


@pytest.mark.slow
def test_command_line(tmp_path):
    found = run("identify.py", results=tmp_path / "results")
    assert set(found) == {"start", "demo"}
    for name, row in found["start"].items():
        if name not in ("runs", "python"):
            assert_target(row["target_s"])
    demo = found["demo"]["jaxnarx demo"]
    assert demo["cold"]["exit_code"] == demo["warm"]["exit_code"] == 0
    assert 100 < demo["cold"]["peak_mb"] < 4000
    assert demo["warm_repeats_cold"]
    assert "full record" in demo["refinement_steps"]
    row = demo["free_run"]["refined"]["pooled"]
    assert row["status"] == "ok" and row["fit"] > 50
    assert_target(demo["targets"]["warm_s"])


@pytest.mark.slow
def test_accelerator(tmp_path):
    found = run("accelerator.py", results=tmp_path / "results")["accelerator"]
    # Without an accelerator the processor alone.
    assert found["devices"][0] == "cpu"
    rows = [row for name, row in found.items() if name not in ("devices", "sweep")]
    assert len(rows) == 4
    for row in rows:
        assert all(way["best_s"] > 0 for way in row["cpu"].values())
        assert row.get("difference", 0.0) < 1e-12
    ways = [row["scores"] for row in found["sweep"].values()]
    assert len(ways) >= 2 and all(len(scores) == 2 for scores in ways)
    np.testing.assert_allclose(ways[1:], [ways[0]] * (len(ways) - 1), rtol=1e-9)


@pytest.mark.slow
def test_engines(tmp_path):
    found = run("engines.py", results=tmp_path / "results")["engines"]
    beds = {k: v for k, v in found["beds"].items() if k != "cores"}
    assert set(beds) == set(BEDS)
    assert all(row["finite"] and row["times_real_time"] > 0 for row in beds.values())
    assert found["family"]["finite"]
    # Chunks round differently; the engines are stable, so differences stay small.
    assert found["family"]["largest_difference"] < 1e-9
    lsoda = found["lsoda"]
    # LSODA's own tolerance is 1e-6 a step, of which there are hundreds.
    assert lsoda["fixed_step_difference"] < 1e-4
    assert max(lsoda["lsoda_difference"].values()) < 1e-4
    assert lsoda["plain_rate_difference"] < 1e-9


@pytest.mark.slow
def test_recovery_with_peers_that_may_be_missing(tmp_path):
    found = run("recovery.py", "--peers", results=tmp_path / "results")["recovery"]
    (cell,) = found["cells"].values()
    assert cell["seeds"] == len(cell["systems"]) == 2
    assert all(len(set(terms)) == 10 for terms in cell["systems"])
    rows = cell["methods"]
    for row in rows.values():
        assert row["exact"] == 2 - len(row["wrong"])
        assert (row["missing_mean"] + row["extra_mean"] > 0) == bool(row["wrong"])
    # Elimination recovers what the forward search alone, told the size, does not.
    exact = {name: row["exact"] for name, row in rows.items()}
    assert exact["jaxnarx Backward"] == exact["jaxnarx StepwiseF"] == 2
    assert exact["jaxnarx ForwardOLS"] < 2
    assert found["targets"]["met"]


@pytest.mark.slow
def test_bouc_wen(tmp_path, measured):
    found = run("bouc_wen.py", "--peers", results=tmp_path / "results")["bouc_wen"]
    if "skipped" in found:
        pytest.skip(found["skipped"])
    row = found["rows"]["jaxnarx ForwardOLS"]
    # The published figure has six decimals.
    assert abs(row["unseen_rrse"] - found["published_rrse"]) < 5e-7
    assert len(row["terms"]) == 15 and row["unseen_limited"] == 0
    for row in found["targets"].values():
        assert_target(row)


@pytest.mark.slow
def test_beds_of_chapter_3(tmp_path):
    experiment("thesis/chapter3_test_beds.py", "--results", str(tmp_path))
    content = json.loads((tmp_path / "chapter3_test_beds.json").read_text())
    columns = content["figures"]["steady_states"]["pfi_free"]
    assert len(columns) == 5 and all(row["within"] for row in columns.values())
    assert {"steady.png", "pfi.png"} <= {p.name for p in tmp_path.iterdir()}


@pytest.mark.slow
def test_models_of_chapter_5(tmp_path):
    done = experiment("thesis/chapter5_miso.py", "--results", str(tmp_path))
    assert "F history of CORR" in done.stdout
    content = json.loads((tmp_path / "chapter5_miso.json").read_text())
    for output in ("TRQ", "AFR"):
        found = content["figures"][output]
        first = found["models"]["CORR"]
        # One row of partial F is that of the model, to its last term.
        assert set(first["history"][-1]) == set(first["terms"])
        assert len(found["models"]["ERR"]["terms"]) == (16 if output == "TRQ" else 12)
        assert found["models"]["ERR, as many as CORR"]["size"] == first["size"]
        fitted = {
            name: model["quality"]["identification"]["one_step"]
            for name, model in found["models"].items()
        }
        assert all(row["r2"] > 95 for row in fitted.values())
        # Cp is n for the model that gives sigma^2, whatever the data.
        sizes = {name: model["size"] for name, model in found["models"].items()}
        largest = [k for k, size in sizes.items() if size == max(sizes.values())]
        assert abs(min(fitted[k]["cp"] for k in largest) - max(sizes.values())) < 1e-6
        for row in found["unseen_r2"].values():
            assert len(row["free_run"]["values"]) == 2
        assert (tmp_path / f"chapter5_{output}.png").stat().st_size > 10_000
    assert (tmp_path / "chapter5_spread.png").stat().st_size > 10_000


@pytest.mark.slow
def test_optimal_excitation_of_chapter_6(tmp_path):
    experiment("thesis/chapter6_optimal_excitation.py", "--results", str(tmp_path))
    content = json.loads((tmp_path / "chapter6_optimal_excitation.json").read_text())
    figures = content["figures"]
    assert figures["seeds"] == 2 and figures["log_det_rises_in"] == 2
    assert figures["relative_error_random"]["median"] > 0
    assert (tmp_path / "chapter6_optimal_excitation.png").stat().st_size > 10_000


@pytest.mark.slow
def test_the_figure_of_the_readme(tmp_path):
    experiment("demo/figure.py", "--out", str(tmp_path / "demo.png"))
    assert (tmp_path / "demo.png").stat().st_size > 10_000


def test_results_hold_no_folders(tmp_path):
    code = (
        "import sys; from pathlib import Path; sys.argv[0] = 'x.py'\n"
        "from common import record\n"
        f"home = {str(tmp_path)!r}\n"
        "texts = [f'see {home}/a/b.json', '83 GFLOP/s', 'a / b', '~/data/c.csv']\n"
        "print(record('one', {'texts': texts}, folder=Path(home) / 'out'))\n"
    )
    command = [sys.executable, "-c", code]
    subprocess.run(command, cwd=FOLDER, check=True, capture_output=True, timeout=60)
    (path,) = (tmp_path / "out").iterdir()
    figures = json.loads(path.read_text(encoding="utf-8"))["figures"]
    assert figures["texts"] == ["see b.json", "83 GFLOP/s", "a / b", "c.csv"]


@pytest.mark.slow
def test_processes_of_nelles(tmp_path):
    experiment("nelles/processes.py", "--results", str(tmp_path))
    content = json.loads((tmp_path / "nelles_processes.json").read_text())
    (row,) = content["figures"]["rows"]
    (entry,) = content["figures"]["summary"].values()
    # Noise of 5 % alone is an NRMSE of 0.05 on validation; the test has none.
    before, after = (row["validation"][k]["free_run"] for k in ("LOLIMOT", "staged"))
    assert after < 0.06 < 0.2 < before
    for name in ("target", "worst"):
        assert_target(entry[name])
        assert entry[name]["met"]
    assert entry["staged"]["diverged"] == 0
    assert (tmp_path / "nelles_processes.png").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.parametrize("colour", [[], ["--coloured"]], ids=["white", "coloured"])
def test_coverage_of_bands(tmp_path, colour):
    experiment("refinement/coverage.py", "--results", str(tmp_path), *colour)
    (path,) = tmp_path.glob("*.json")
    figures = json.loads(path.read_text())["figures"]
    assert figures["sets"] == len(figures["rows"]) == 3
    for name in ("run", "measurement"):
        parts = figures["coverage"][name]
        # Three sets tell no more than that.
        assert all(0.5 < part["share"] <= 1 for part in parts.values())
    assert path.with_suffix(".png").stat().st_size > 10_000


@pytest.mark.slow
def test_simulation_with_peers_that_may_be_missing(tmp_path):
    found = run("simulation.py", "--peers", results=tmp_path / "results")
    figures = found["simulation"]
    (length,) = figures["lengths"].values()
    for one in length["rounds"]:
        # Both gradients and both runs are the same numbers by other orders of sums.
        assert one["jaxnarx"]["gradient_difference"] < 1e-9
        assert one.get("numba", {}).get("largest_difference", 0.0) < 1e-9
    assert figures["search"]["programs"] == 1
    assert figures["normal_equations"]["parameters"] == 100
    for row in figures["targets"].values():
        assert_target(row)


@pytest.mark.slow
def test_fitting_without_peers(tmp_path, measured):
    figures = run("fitting.py", results=tmp_path / "results")["fitting"]
    (one,) = figures["sets"].values()
    if "skipped" in one:
        pytest.skip(one["skipped"])
    assert figures["peers"].startswith("no peer") and figures["at_least"] == {}
    first, again = (one["rounds"][0]["jaxnarx"][key] for key in ("first", "again"))
    assert len(one["terms"]) == first["parameters"]
    assert first["rmse"] == again["rmse"] and first["limited"]["validation"] == 0
    # The search's own score of the step that was kept, in physical units: rounded to
    # five digits, both of them.
    kept = first["history"][-1]
    assert abs(kept["validation"] / first["rmse"]["validation"]["all"] - 1) < 2e-4
    assert first["selection"]["wall"] < kept["wall"] <= first["total"]["wall"]


@pytest.mark.slow
def test_before_and_after(tmp_path):
    rows = run("before_after.py", results=tmp_path)["before_after"]
    figures = {"select", "free_run", "loss_and_gradient", "grow", "fit in a sweep"}
    assert set(rows) == figures
    for row in rows.values():
        # Without another checkout both are this one.
        assert row["before"] > 0 and row["after"] > 0
        assert_target(row["ratio"])


@pytest.mark.slow
def test_compilations_are_counted(tmp_path):
    found = run("compilations.py", results=tmp_path)["compilations"]
    programs = found["after"]["programs"]
    assert programs["first"] > 0 and programs["one more lag"] > 0
    assert programs["same"] == programs["one more sample"] == programs["renamed"] == 0
    assert 0 < found["after"]["command"]["warm"] < found["after"]["command"]["cold"]
    for aim in found["aims"].values():
        assert_target(aim)


@pytest.mark.slow
def test_the_verbs_beside_the_program(tmp_path):
    (row,) = run("verbs.py", results=tmp_path)["verbs"].values()
    assert all(seconds > 0 for seconds in row["seconds a fit"].values())
    assert_target(row["verbs over program"])


@pytest.mark.slow
def test_the_house_is_counted(tmp_path):
    found = run("house.py", results=tmp_path)["house"]["now"]
    rooms = found["rooms"]
    assert found["public names"] <= 60
    parts = [sums for room, sums in rooms.items() if room.startswith("jaxnarx/")]
    for figure, total in rooms["jaxnarx"].items():
        assert sum(part[figure] for part in parts) == total > 0


@pytest.mark.slow
def test_speed_and_memory_of_the_search(tmp_path, measured):
    found = run("search.py", "--peers", results=tmp_path / "results")["search"]
    for run_ in (*found["candidates"].values(), found["engine"]["quick"]):
        if isinstance(run_, dict) and "candidates" in run_:
            assert 0 < run_["candidates"] == sum(run_["families"].values())
            assert run_["peak_mb"] > 0
    cold, warm = (found["quick"][name] for name in ("cold", "warm"))
    assert cold["compiled"] == cold["programs"] == warm["programs"] > 0
    assert warm["compiled"] == 0
    for row in (
        *(r for r in found["short"].values() if "aim" in r),
        found["one_input"],
    ):
        assert_target(row["aim"])
    assert {name for name in found["short"] if name != "engine"} == {
        "600 samples, cold",
        "600 samples, warm",
    }
    for name in ("seconds", "cross_validated_nrmse", "chosen"):
        assert (cold[name] == warm[name]) == (name != "seconds")
    for row in (cold["aim"], found["candidates"]["a_hundred"]):
        assert_target(row)
    for row in found["equations"].values():
        assert row["aim"]["met"] == (row["aim"]["value"] >= 0.5)
        assert row["samples"] == sum(n for _, n in row["shapes"])
    for row in found["engine"]["peers"].values():
        assert "skipped" in row or row["seconds"] > 0


@pytest.mark.slow
def test_the_search_on_a_real_engine(tmp_path, measured):
    options = "--results", str(tmp_path), "--runs", str(tmp_path / "runs")
    experiment("gengine1/identify.py", *options)
    figures = json.loads((tmp_path / "gengine1_identify.json").read_text())["figures"]
    (row,) = figures["linear"]["rows"]
    assert row["output"] == "T_exhaust"
    assert row["cross_validated"]["chosen"] >= row["cross_validated"]["best"] > 0
    assert 0 < row["test"]["one_step"]["rmse"] < row["test"]["free_run"]["rmse"]
    assert len(figures["linear"]["scored"]) == 1


@pytest.mark.slow
def test_hidden_states_have_exact_derivatives_and_a_price(tmp_path):
    parts = "--only", "derivatives", "price"
    found = run("states.py", *parts, results=tmp_path / "results")["states"]
    for name, count in (("coefficients", 60), ("starting values", 8)):
        row = found["derivatives"][name]
        assert row["count"] == count and row["value"] > 0
        assert_target(row)
        # A share of the largest derivative: the differences themselves leave 1e-8.
        assert row["met"]
    price = found["price"]
    assert set(price["terms"].values()) == {60}
    for what in ("loss", "loss and gradient", "normal equations"):
        assert_target(price[what]["ratio"])
