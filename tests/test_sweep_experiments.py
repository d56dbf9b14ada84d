"""Experiments on sweeps run with `--smoke`; see `test_experiments.py`."""

import json
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet
from smoke import ROOT, experiment, run


def figures_of(script: str, results: Path) -> dict:
    """Run an experiment small, check what all of them write, and give its figures."""
    experiment(f"{script}/run.py", "--results", str(results))
    path = results / f"{script}.json"
    assert str(ROOT) not in path.read_text() and str(results) not in path.read_text()
    pictures = list(results.glob("*.png"))
    assert pictures and all(4_000 < p.stat().st_size < 150_000 for p in pictures)
    return json.loads(path.read_text())["figures"]


@pytest.mark.slow
def test_lolimot_refinement_and_going_on(tmp_path):
    figures = figures_of("lolimot_refinement", tmp_path)
    found = {row["how"]: row for row in figures["summary"]}
    assert set(found) == {"LOLIMOT", "coefficients, to full", "staged, to full"}
    assert all(row["free_run"]["members"] == 2 for row in found.values())
    rows = parquet.read_table(tmp_path / "lolimot_refinement.parquet").to_pylist()
    error = {(r["how"], r["engine"]): r["validation_free_run"] for r in rows}
    for (_, engine), value in error.items():
        # The validation record judges; infinity where it diverges.
        assert value <= error["LOLIMOT", engine] * (1 + 1e-9)
    chunks = sorted((tmp_path / "runs").glob("*/chunks/*"))
    times = [chunk.stat().st_mtime_ns for chunk in chunks]
    assert chunks and figures_of("lolimot_refinement", tmp_path) == figures
    assert [chunk.stat().st_mtime_ns for chunk in chunks] == times


@pytest.mark.slow
def test_partition_optimisation(tmp_path):
    figures = figures_of("partition_optimisation", tmp_path)
    rows = parquet.read_table(tmp_path / "partition_optimisation.parquet").to_pylist()
    drawn = {"random", "scattered"}
    assert {r["partition"] for r in rows} == drawn | {"lolimot"}
    ended = [r for r in rows if r["train"] == "staged"]
    (best,) = [r for r in figures["starts"] if r["partition"] == "best found"]
    chosen = []
    for engine in sorted({r["engine"] for r in ended}):
        own = [r for r in ended if r["engine"] == engine]
        chosen.append(min(own, key=lambda r: r["validation_free_run"]))
    test = [r["test_free_run"] for r in chosen]
    # Figures in the record have four digits.
    np.testing.assert_allclose(best["free_run"]["median"], np.median(test), rtol=1e-3)
    assert sum(best["from"].values()) == len(chosen) == 2
    (greedy,) = [
        r
        for r in figures["starts"]
        if r["partition"] == "lolimot" and r["train"] == "staged"
    ]
    for part, share in greedy["share of drawn starts that end better"].items():
        score = f"{part}_free_run"
        own = {r["engine"]: r[score] for r in ended if r["partition"] == "lolimot"}
        others = [r for r in ended if r["partition"] in drawn]
        wins = [r[score] < own[r["engine"]] for r in others]
        np.testing.assert_allclose(share, np.mean(wins), rtol=1e-3)


@pytest.mark.slow
def test_engine_sweep(tmp_path):
    found = figures_of("engine_sweep", tmp_path)["beds"]["pfi"]
    rows = parquet.read_table(tmp_path / "engine_sweep.parquet").to_pylist()
    by = {(r["structure"], r["engine"]): r for r in rows}
    assert len(by) == len(rows) == 4 * (6 + 3 + 3) + 4 * 6
    # On the engine they come from, its terms make the network that it has: the
    # same numbers but for the rounding of sums over pools of other sizes.
    own, again = (by[s, "noise 0"] for s in ("refined", "nominal terms"))
    assert own["term_names"] == again["term_names"]
    for part in ("train", "validation", "test"):
        figures = [row[f"{part}_free_run"] for row in (own, again)]
        np.testing.assert_allclose(*figures, rtol=1e-4)  # five digits are kept
    engines = [r for (s, e), r in by.items() if s == "refined" and "engine" in e]
    share = found["terms"]["share"]["speed[t-1]"]["engine"]
    assert share == np.mean(["speed[t-1]" in r["term_names"] for r in engines])
    assert sum(found["status"]["refined"].values()) == 12
    # A network of another engine is no match for one fitted to the engine itself.
    for n in range(6):
        figures = [by[s, f"engine {n}"]["train_free_run"] for s in ("own", "as it is")]
        assert figures[0] < figures[1]
    assert found["comparisons"]["sister against own"]["pairs"] == 6


@pytest.mark.slow
def test_sweep_benchmark(tmp_path):
    figures = run("sweep.py", results=tmp_path / "out")["sweep"]
    one, side_by_side = figures["chunks"]
    assert [one["batch"], side_by_side["batch"]] == ["map", "vmap"]
    assert one["pool"] == 200 and one["compile_s"] > 0
    # The same fits, whatever the chunk.
    scores = [row["median_nrmse"] for row in (one, side_by_side)]
    np.testing.assert_allclose(*scores, rtol=1e-3)  # four digits are kept
    assert 0 < one["median_nrmse"] < one["median_start"] < 1


@pytest.mark.slow
def test_fleet_calibration(tmp_path):
    given = "--results", str(tmp_path), "--beds", "vct"
    experiment("fleets/calibration.py", *given)
    figures = json.loads((tmp_path / "fleet_calibration.json").read_text())["figures"]
    (table,) = figures["beds"]["vct"].values()
    for said in ("like the donors", "another excitation"):
        assert set(table[said]) == {"10", "20", "500"}
        rows = table[said]["20"]
        assert rows["automatic"]["median"] < rows["own fit"]["median"]
    experiment("fleets/calibration.py", *given, "--many")
    many = json.loads((tmp_path / "fleet_donors.json").read_text())["figures"]
    assert set(many["by donors"]) == {"8", "16"}


@pytest.mark.slow
def test_planned_tests_of_a_fleet(tmp_path):
    given = ("--results", str(tmp_path), "--cache", str(tmp_path / "engines"))
    experiment("fleets/plans.py", *given)
    figures = json.loads((tmp_path / "fleet_plans.json").read_text())["figures"]
    assert set(figures["beds"]) == {"pfi"}
    assert figures["planned over usual, median of seeds"]["pfi"]["20"] > 0


@pytest.mark.slow
def test_a_fleet_of_hysteretic_systems(tmp_path):
    experiment("fleets/bouc_wen.py", "--results", str(tmp_path))
    figures = json.loads((tmp_path / "fleet_bouc_wen.json").read_text())["figures"]
    assert 0 < figures["500 samples, median of seeds [m]"] < 1e-3


@pytest.mark.slow
def test_what_a_fleet_costs(tmp_path):
    experiment("benchmarks/fleet.py", "--results", str(tmp_path))
    figures = json.loads((tmp_path / "fleet.json").read_text())["figures"]
    assert figures["broken"] == 0 and figures["engines"] == 4


@pytest.mark.slow
def test_maps_are_checked_on_the_engine(tmp_path):
    experiment("calibration/maps.py", "--results", str(tmp_path))
    figures = json.loads((tmp_path / "calibration_vct.json").read_text())["figures"]
    told = figures["summary"]["best constants"]
    assert told["objective, promised"][0] < 1.0
    assert told["cycle"]["promise missed by, worst"] < 0.2


@pytest.mark.slow
def test_maps_are_made_for_a_fleet(tmp_path):
    experiment("calibration/robust.py", "--results", str(tmp_path))
    figures = json.loads((tmp_path / "calibration_robust.json").read_text())["figures"]
    assert 0 < figures["summary"]["vct, robust, cycle"]["objective, median"] < 1.5


@pytest.mark.slow
def test_engines_are_steered(tmp_path):
    more = ("--beds", "pfi", "--results", str(tmp_path))
    experiment("control/tracking.py", *more)
    path = tmp_path / "control_tracking.json"
    told = json.loads(path.read_text())["figures"]["summary"]
    assert told["pfi, duty, engine"]["speed"]["median"] < 1.0
    assert told["pfi, duty, constant references"]["speed, left"]["worst"] < 0.2


@pytest.mark.slow
def test_a_step_of_control_is_timed_beside_ipopt(tmp_path):
    pytest.importorskip("casadi")
    experiment("control/speed.py", "--results", str(tmp_path))
    figures = json.loads((tmp_path / "control_speed.json").read_text())["figures"]
    near = figures["first command from IPOPT's, shares of its range, one round"]
    assert near["median"] < 0.05
    assert figures["IPOPT over ours, from Python"] > 0


@pytest.mark.slow
def test_operating_points_at_rest_beside_short_records(tmp_path):
    experiment("physics/at_rest.py", "--results", str(tmp_path))
    figures = json.loads((tmp_path / "at_rest.json").read_text())["figures"]
    (bed,) = figures["beds"].values()
    (row,) = bed.values()
    assert all(0 < row[n]["test"] < 0.5 and not row[n]["diverged"] for n in row)


@pytest.mark.slow
def test_signs_of_gains_on_a_tenth_of_the_records(tmp_path, measured):
    options = "--results", str(tmp_path), "--runs", str(tmp_path / "runs")
    experiment("physics/gengine1_tenth.py", *options)
    figures = json.loads((tmp_path / "physics_gengine1.json").read_text())["figures"]
    (row,) = figures["rows"]
    assert row["output"] == "T_exhaust" and row["with"]["wrong gains"] == 0
    assert row["with"]["known gains"] == 30 and figures["summary"]["no wrong gain"]


@pytest.mark.slow
def test_a_network_follows_an_engine_that_has_changed(tmp_path):
    experiment("control/adaptation.py", "--results", str(tmp_path))
    figures = json.loads((tmp_path / "adaptation.json").read_text())["figures"]
    assert figures["c"]["local"]["difference of coefficients"] < 1e-9
    assert figures["c"]["regions"] == 10
    assert 0 < figures["summary"]["vct"]["adapted"]["NOx"] < 1.0
