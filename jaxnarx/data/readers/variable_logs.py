"""Branches that tools for measuring and identification lay out in ways of their own."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxnarx.data.readers.variable_trees import TimedColumns


def read_branch(branch: Mapping[str, Any]) -> TimedColumns | None:
    """Read such a branch; `None` for any other."""
    return _simulink(branch) or _dspace(branch) or _iddata(branch)


def _simulink(branch: Mapping[str, Any]) -> TimedColumns | None:
    """A log of Simulink, structure with time."""
    time, logged = branch.get("time"), branch.get("signals")
    if not isinstance(time, np.ndarray) or not isinstance(logged, dict | list):
        return None
    columns = {}
    for k, one in enumerate([logged] if isinstance(logged, dict) else logged):
        values = one.get("values") if isinstance(one, dict) else None
        if not isinstance(values, np.ndarray):
            continue
        name = (one.get("label") or one.get("blockName") or [""])[0]
        name = name or f"signal_{k + 1}"
        values = values.reshape(len(values), -1)
        many = values.shape[1] > 1
        for j in range(values.shape[1]):
            columns[f"{name}_{j + 1}" if many else name] = values[:, j]
    return TimedColumns(columns, np.ravel(time).astype(float) if time.size else None)


def _dspace(branch: Mapping[str, Any]) -> TimedColumns | None:
    """A recording of dSPACE: one time X, channels Y with name, data and unit."""
    x, y = branch.get("X"), branch.get("Y")
    x = x[0] if isinstance(x, list) and len(x) == 1 else x
    if not isinstance(x, dict) or not isinstance(y, dict | list) or "Data" not in x:
        return None
    every = [one for one in ([y] if isinstance(y, dict) else y) if "Data" in one]
    names = [str((one.get("Name") or [f"y_{k}"])[0]) for k, one in enumerate(every)]
    columns = {n: np.ravel(one["Data"]) for n, one in zip(names, every, strict=True)}
    units = [str((one.get("Unit") or [""])[0]) for one in every]
    time = np.ravel(np.asarray(x["Data"], float))
    return TimedColumns(columns, time, dict(zip(names, units, strict=True)))


def _iddata(branch: Mapping[str, Any]) -> TimedColumns | None:
    """An `iddata` of one experiment: outputs and inputs with names and units."""
    if not {"OutputData", "InputData"} <= set(branch):
        return None
    columns, units = {}, {}
    for what, letter in (("Input", "u"), ("Output", "y")):
        data = branch[f"{what}Data"]
        if not isinstance(data, np.ndarray) or data.ndim != 2:
            continue
        names = branch.get(f"{what}Name") or []
        told = branch.get(f"{what}Unit") or []
        for k in range(data.shape[1]):
            name = names[k] if k < len(names) else f"{letter}{k + 1}"
            columns[name] = data[:, k]
            units[name] = told[k] if k < len(told) else ""
    step, start = (
        np.ravel(branch[k]) if isinstance(branch.get(k), np.ndarray) else np.ones(0)
        for k in ("Ts", "Tstart")
    )
    if not columns or not step.size:
        return TimedColumns(columns, None, units) if columns else None
    begin = float(start[0]) if start.size else 0.0
    count = len(next(iter(columns.values())))
    return TimedColumns(columns, begin + float(step[0]) * np.arange(count), units)
