"""Model files: safetensors arrays behind a JSON header. No pickle, no code.

The header (metadata key `jaxnarx`) holds the format version, the package version, the
channels with units and the static tables; the tensors are the network's arrays. A file
of a newer format, a foreign or a damaged one is a `ModelFileError`.
"""

import importlib.metadata
import json
import os
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxnarx.data import Channel, Channels
from jaxnarx.data.batch import check_precision
from jaxnarx.errors import JaxnarxError, ModelFileError
from jaxnarx.models.network import LocalModels, Network, OutputModel
from jaxnarx.models.validity import AbstractValidity, Gaussians
from jaxnarx.regressors import Variables

FORMAT = 1
VALIDITIES: dict[str, type[AbstractValidity]] = {"Gaussians": Gaussians}


def _header(network: Network, about: dict[str, Any] | None) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "kind": "network",
        "jaxnarx": importlib.metadata.version("jaxnarx"),
        "inputs": [[c.name, c.unit] for c in network.channels.inputs],
        "outputs": [[c.name, c.unit] for c in network.channels.outputs],
        "modelled": list(network.modelled),
        "variables": [list(r) for r in network.variables],
        "models": [
            {
                "scheduling": [list(r) for r in m.scheduling],
                "validity": type(m.validity).__name__,
            }
            for m in network.models
        ],
        "about": about or {},
    }


def _tensors(network: Network) -> dict[str, np.ndarray]:
    paths = jax.tree_util.tree_flatten_with_path(eqx.filter(network, eqx.is_array))[0]
    return {
        jax.tree_util.keystr(path): np.ascontiguousarray(leaf) for path, leaf in paths
    }


def save(
    network: Network,
    path: str | os.PathLike[str],
    *,
    about: dict[str, Any] | None = None,
) -> None:
    """Write `network` to `path`, whole or not at all; the folder must exist.

    `about` is kept in the header and must be JSON: where the model came from, say.
    Coefficients that are not finite are refused.
    """
    from safetensors.numpy import save as to_bytes

    tensors = _tensors(network)
    for name, value in tensors.items():
        if value.dtype.kind == "f" and not np.all(np.isfinite(value)):
            raise ModelFileError(
                f"the network holds values that are not finite ({name}); such a model "
                "is not written",
                path=path,
            )
    header = json.dumps(_header(network, about), allow_nan=False)
    path = Path(path)
    temporary = path.with_name(path.name + ".tmp")
    temporary.write_bytes(to_bytes(tensors, metadata={"jaxnarx": header}))
    os.replace(temporary, path)


def load(path: str | os.PathLike[str]) -> Network:
    """Read a network written by `save`. Any defect of the file is a `ModelFileError`."""
    header, tensors = _read(Path(path))
    try:
        network = _build(header, tensors)
    except JaxnarxError:
        raise
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise ModelFileError(
            f"{path}: not a complete model file (format {header.get('format')}, written "
            f"by jaxnarx {header.get('jaxnarx')}): {error}",
            path=path,
        ) from error
    return network


def load_about(path: str | os.PathLike[str]) -> dict[str, Any]:
    """What `save` was told about the model, a JSON dictionary."""
    return dict(_read(Path(path))[0].get("about", {}))


def _read(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise ModelFileError(f"{path}: there is no such model file", path=path)
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            text = metadata.get("jaxnarx")
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as error:
        raise ModelFileError(
            f"{path}: not a model file, or cut short ({error})", path=path
        ) from error
    if text is None:
        raise ModelFileError(
            f"{path}: a safetensors file, but no jaxnarx model", path=path
        )
    try:
        header = json.loads(text)
        version = header["format"]
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise ModelFileError(f"{path}: its header cannot be read", path=path) from error
    if not isinstance(version, int) or version > FORMAT:
        raise ModelFileError(
            f"{path}: format {version!r}, written by jaxnarx {header.get('jaxnarx')}; "
            f"this program reads formats up to {FORMAT}. Update jaxnarx.",
            path=path,
        )
    return header, tensors


def _variables(rows: list, signals: int) -> Variables:
    table = tuple((int(s), int(d)) for s, d in rows)
    if any(not 0 <= s < signals or d < 0 for s, d in table):
        raise ValueError("a lagged variable points outside the channels")
    return Variables(table)


def _build(header: dict[str, Any], tensors: dict[str, np.ndarray]) -> Network:
    channels = Channels(
        tuple(Channel(n, u) for n, u in header["inputs"]),
        tuple(Channel(n, u) for n, u in header["outputs"]),
    )
    signals = len(channels.all)

    def get(name: str) -> jax.Array:
        value = tensors[name]
        check_precision(value.dtype)
        if value.dtype.kind == "f" and not np.all(np.isfinite(value)):
            raise ValueError(f"{name} holds values that are not finite")
        return jnp.asarray(value)

    models = []
    for n, entry in enumerate(header["models"]):
        lead = f".models[{n}]"
        validity = VALIDITIES[entry["validity"]]
        fields = validity.__dataclass_fields__  # type: ignore[attr-defined]
        local = LocalModels(
            *(
                get(f"{lead}.local.{f}")
                for f in ("factor", "index", "used", "coefficient")
            )
        )
        models.append(
            OutputModel(
                _variables(entry["scheduling"], signals),
                get(f"{lead}.offset"),
                get(f"{lead}.span"),
                validity(*(get(f"{lead}.validity.{f}") for f in fields)),
                get(f"{lead}.active"),
                local,
            )
        )
    network = Network(
        channels,
        tuple(int(o) for o in header["modelled"]),
        _variables(header["variables"], signals),
        tuple(models),
        *(
            get(f".{f}")
            for f in ("gain", "lower", "upper", "low", "high", "sample_time")
        ),
    )
    _check(network)
    return network


def _check(network: Network) -> None:
    """Sizes and indices that belong together; a wrong one is a ValueError."""
    signals = (len(network.channels.all),)
    outputs = (len(network.modelled),)
    for name in ("gain", "low", "high"):
        if getattr(network, name).shape != signals:
            raise ValueError(f"{name} has not one entry per channel")
    if network.lower.shape != outputs or network.upper.shape != outputs:
        raise ValueError("the feedback bounds have not one entry per output")
    if not all(0 <= o < len(network.channels.outputs) for o in network.modelled):
        raise ValueError("a modelled output is not among the channels")
    for model in network.models:
        local, count = model.local, model.active.shape[0]
        if not local.index.shape == local.used.shape == local.coefficient.shape:
            raise ValueError("coefficients, indices and masks differ in shape")
        if local.index.shape[0] != count:
            raise ValueError("local models and validities differ in number")
        tables = np.asarray(local.factor), np.asarray(local.index)
        for table, limit in zip(
            tables, (len(network.variables) + 1, len(tables[0])), strict=True
        ):
            if table.size and not (table.min() >= 0 and table.max() < limit):
                raise ValueError("a term points outside its table")
