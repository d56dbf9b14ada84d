"""Model files: safetensors arrays behind a JSON header. No pickle, no code.

The header (metadata key `jaxnarx`) holds the format version, the package version, the
channels with units and the static tables; the tensors are the network's arrays. A file
of a newer format, a foreign or a damaged one is a `ModelFileError`. A network with
filtered variables is written as format 2, one with other validity functions than
Gaussians as format 3, one that is held to its trained ranges as format 5, one with
hidden channels as format 6, one with groups of local models that have feedback of their
own as format 7, one with a domain, a certificate, or inputs that are not held where its
outputs are, as format 8, one with prediction intervals, or that says nothing beyond its
ranges, as format 9, one whose outputs are not a number where an input is missing, or
with a time of its own from which they are invalid then, as format 10, one that computes
roots of outputs as format 11, so that older programs say what they lack; any other is
still written as format 1. Files of formats 1 to 4 hold none to their ranges. In format
4 a group is a local model alone.

The last key of the header, `sha256`, is a digest of the rest of it and the arrays: a
file that was changed after it was written is refused. Files of before have none.
"""

import dataclasses
import hashlib
import importlib.metadata
import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data import Channel, Channels, check_precision
from jaxnarx.errors import ModelFileError, SpecError
from jaxnarx.files import write_whole
from jaxnarx.models.domain import Domain
from jaxnarx.models.error_model import ErrorModel
from jaxnarx.models.network import (
    FLAG,
    HOLD,
    NAN,
    LocalModels,
    Network,
    OutputModel,
)
from jaxnarx.models.signed_root import SignedRoot
from jaxnarx.models.validate import LARGEST_LAG, require_consistent
from jaxnarx.models.validity import VALIDITIES, Gaussians
from jaxnarx.regressors import (
    Variables,
    filter_from_dict,
    filter_to_dict,
)

FORMAT_VERSION = 11
"""Newest format read."""
WINDOW_WORDS = "the window of hidden channels"
AFTER_WORDS = "the number of samples from which outputs are invalid"


def _header(network: Network, about: dict[str, Any] | None) -> dict[str, Any]:
    return {
        "format": _format(network),
        "kind": "network",
        "jaxnarx": importlib.metadata.version("jaxnarx"),
        "inputs": [[c.name, c.unit] for c in network.channels.inputs],
        "outputs": [[c.name, c.unit] for c in network.channels.outputs],
        "modelled": list(network.modelled),
        **_hidden(network),
        **_edge(network),
        **_describe_rows("variables", network.variables),
        "models": [
            {
                **_describe_rows("scheduling", m.scheduling),
                "validity": type(m.validity).__name__,
            }
            for m in network.models
        ],
        "about": about or {},
    }


def _hidden(network: Network) -> dict[str, Any]:
    """Hidden channels and the window they are estimated from, if there are any."""
    if not network.hidden:
        return {}
    channels = [[c.name, c.unit] for c in network.channels.hidden]
    return {"hidden": channels, "window": network.window}


def _edge(network: Network) -> dict[str, Any]:
    """The policy of inputs beyond their ranges, and the features of the domain."""
    out: dict[str, Any] = _missing_policy(network)
    if network.outside != _usual(network.hold):
        out["outside"] = network.outside
    if network.domain is not None:
        out["domain"] = _describe_rows("features", network.domain.features)
    return out


def _missing_policy(network: Network) -> dict[str, Any]:
    """The policy of outputs where an input is missing, if it is not the usual one."""
    out: dict[str, Any] = {}
    if network.nan != HOLD:
        out["nan"] = network.nan
    if network.invalid_after is not None:
        out["invalid_after"] = network.invalid_after
    return out


def _usual(hold: object) -> str:
    """The policy where nothing is said, as in files up to format 7: inputs are held if
    outputs are."""
    return FLAG if hold is None else HOLD


def _format(network: Network) -> int:
    """Oldest format that holds all of the network."""
    if any(model.root is not None for model in network.models):
        return 11
    if _missing_policy(network):
        return 10
    if network.errors is not None or network.outside == NAN:
        return 9
    if _edge(network) or network.certificate is not None:
        return 8
    if network.parallel:
        return 7
    if network.hidden:
        return 6
    if network.hold is not None:
        return 5
    if not all(isinstance(m.validity, Gaussians) for m in network.models):
        return 3
    tables = (network.variables, *(m.scheduling for m in network.models))
    return 2 if any(t.filters for t in tables) else 1


def _describe_rows(name: str, table: Variables) -> dict[str, Any]:
    """The rows of a table, and its filters if it has any."""
    out: dict[str, Any] = {name: [list(r) for r in table]}
    if table.filters:
        out[f"{name}_filters"] = [
            None if f is None else filter_to_dict(f) for f in table.filters
        ]
    return out


def _tensors(network: Network) -> dict[str, np.ndarray]:
    paths = jax.tree_util.tree_flatten_with_path(eqx.filter(network, eqx.is_array))[0]
    # not np.ascontiguousarray, which makes an axis for a number
    return {
        jax.tree_util.keystr(path): np.array(leaf, order="C") for path, leaf in paths
    }


@guard_arguments
def save(
    network: Network,
    path: str | os.PathLike[str],
    *,
    about: dict[str, Any] | None = None,
) -> None:
    """Write `network` to `path`, whole or not at all; the folder must exist.

    `about` is kept in the header and must be JSON: where the model came from, say.
    Coefficients that are not finite are refused, and so are validity functions that no
    program could read again: those of a class that is not registered
    (`jaxnarx.models.register_validity`).

    Example:
        jnx.save(network, "model.safetensors", about={"records": "day 1"})
    """
    from safetensors.numpy import save as to_bytes

    _require_known(network)
    tensors = _tensors(network)
    for name, value in tensors.items():
        if value.dtype.kind == "f" and not np.all(np.isfinite(value)):
            raise ModelFileError(
                f"the network holds values that are not finite ({name}); such a model "
                "is not written",
                path=path,
            )
    header = json.dumps(_header(network, about), allow_nan=False)
    _require_readable(header, tensors, path)
    header = f'{header[:-1]}, "sha256": "{_digest(header, tensors)}"}}'
    path = Path(path)
    if not path.name:
        raise ModelFileError(f"{path}: a folder; name a file in it", path=path)
    try:
        write_whole(path, to_bytes(tensors, metadata={"jaxnarx": header}))
    except (OSError, ValueError) as error:  # the latter: no name for a file
        told = getattr(error, "strerror", None) or error
        raise ModelFileError(
            f"{path!s}: cannot be written ({told}); what was there "
            "before is kept. Name another place.",
            path=path,
        ) from error


def _digest(header: str, tensors: dict[str, np.ndarray]) -> str:
    """SHA-256 of the header and of the name, kind, size and bytes of every array."""
    found = hashlib.sha256(header.encode())
    for name, value in sorted(tensors.items()):
        found.update(f"{name} {value.dtype.str} {value.shape}".encode())
        found.update(np.ascontiguousarray(value).tobytes())
    return found.hexdigest()


def _has_its_digest(header: str, tensors: dict[str, np.ndarray]) -> bool:
    """Whether the digest is that of the file; True where the header has none."""
    signed = re.fullmatch(r'(.*), "sha256": "([0-9a-f]{64})"\}', header, re.DOTALL)
    if signed is None:
        return '"sha256"' not in header[-100:]
    return signed[2] == _digest(signed[1] + "}", tensors)


def _require_readable(
    header: str, tensors: dict[str, np.ndarray], path: str | os.PathLike[str]
) -> None:
    """ModelFileError where `load` would refuse what is to be written."""
    try:
        _build(json.loads(header), tensors)
    except (LookupError, TypeError, ValueError, ArithmeticError) as error:
        raise ModelFileError(
            f"{path}: not written, because no program could read it again: {error}",
            path=path,
        ) from error


def _require_known(network: Network) -> None:
    """SpecError where a file could not tell what the validity functions are."""
    for validity in (m.validity for m in network.models):
        kind = type(validity)
        if VALIDITIES.get(kind.__name__) is not kind:
            raise SpecError(
                f"model files know validity functions by name, and {kind.__name__!r} "
                "is not registered: `jaxnarx.models.register_validity` does it, here "
                "and in every program that is to load the model",
                field="validity",
            )
        for field in dataclasses.fields(validity):
            if not eqx.is_array(getattr(validity, field.name)):
                raise SpecError(
                    f"{kind.__name__}.{field.name} is no array; model files hold "
                    "nothing else of validity functions",
                    field="validity",
                )


@guard_arguments
def load(path: str | os.PathLike[str]) -> Network:
    """Read what `save` wrote. Any defect of the file is a `ModelFileError`.

    Example:
        jnx.save(network, "model.safetensors")
        network = jnx.load("model.safetensors")
    """
    header, tensors = _read(Path(path))
    for value in tensors.values():
        check_precision(value.dtype)
    try:
        network = _build(header, tensors)
    except _Unknown as error:
        raise ModelFileError(
            f"{path}: its validity functions are of the class {error.args[0]!r}, which "
            "is not known here. If it is your own, register it first "
            "(jaxnarx.models.register_validity); a newer jaxnarx may know it, too.",
            path=path,
        ) from error
    except (LookupError, TypeError, ValueError, ArithmeticError) as error:
        missing = f"{error} is missing" if isinstance(error, KeyError) else error
        raise ModelFileError(
            f"{path}: damaged or not complete (format {header['format']}, written by "
            f"jaxnarx {header.get('jaxnarx')}): {missing}. Identify anew, or restore "
            "the file from a copy.",
            path=path,
        ) from error
    return network


class _Unknown(Exception):
    """A class of validity functions that is not registered."""


def load_about(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Load what `save` was told about the model, a JSON dictionary."""
    about = _read(Path(path))[0].get("about", {})
    if not isinstance(about, dict):
        raise ModelFileError(
            f"{path}: damaged; what it says about the model is no table", path=path
        )
    return about


def _read(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    from safetensors import SafetensorError, safe_open

    try:
        is_folder, is_file = path.is_dir(), path.is_file()
    except (OSError, ValueError):  # no name for a file
        is_folder = is_file = False
    if is_folder:
        raise ModelFileError(
            f"{path}: a folder; name the model file in it, "
            f"{path / 'model.safetensors'}",
            path=path,
        )
    if not is_file:
        raise ModelFileError(f"{path}: there is no such model file", path=path)
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            text = metadata.get("jaxnarx")
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except OSError as error:
        raise ModelFileError(
            f"{path}: cannot be opened ({error.strerror or error})", path=path
        ) from error
    except (
        SafetensorError,
        ValueError,
        TypeError,
        LookupError,
        AttributeError,
    ) as error:
        # the last three: number types that NumPy does not have
        raise ModelFileError(
            f"{path}: not a model file of jaxnarx, or cut short ({error})", path=path
        ) from error
    if text is None:
        raise ModelFileError(
            f"{path}: a safetensors file, but no jaxnarx model", path=path
        )
    try:
        header = json.loads(text)
        version = header["format"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ModelFileError(f"{path}: its header cannot be read", path=path) from error
    if type(version) is not int or version < 1:
        raise ModelFileError(
            f"{path}: its header cannot be read (format {version!r})", path=path
        )
    if version > FORMAT_VERSION:
        raise ModelFileError(
            f"{path}: format {version!r}, written by jaxnarx {header.get('jaxnarx')}; "
            f"this program reads formats up to {FORMAT_VERSION}. Update jaxnarx.",
            path=path,
        )
    if not _has_its_digest(text, tensors):
        raise ModelFileError(
            f"{path}: changed after it was written (its digest is another). Restore "
            "the file from a copy, or identify anew.",
            path=path,
        )
    return header, tensors


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise ValueError(f"a channel's name or unit is {value!r}")
    return value


def _require_count(value: object, what: str) -> int:
    if type(value) is not int:
        raise ValueError(f"{what} is {value!r}, no count of samples")
    return value


def _variables(entry: dict[str, Any], name: str, signals: int) -> Variables:
    table = tuple((int(s), int(d)) for s, d in entry[name])
    if any(not 0 <= s < signals or not 0 <= d <= LARGEST_LAG for s, d in table):
        raise ValueError("a lagged variable points outside the channels, or too far")
    filters = entry.get(f"{name}_filters", ())
    return Variables(
        table, tuple(None if f is None else filter_from_dict(f) for f in filters)
    )


def _build(header: dict[str, Any], tensors: dict[str, np.ndarray]) -> Network:
    channels = Channels(
        tuple(Channel(_text(n), _text(u)) for n, u in header["inputs"]),
        tuple(Channel(_text(n), _text(u)) for n, u in header["outputs"]),
        tuple(Channel(_text(n), _text(u)) for n, u in header.get("hidden", [])),
    )
    signals = len(channels.all)

    numbers = {str(x.dtype) for x in tensors.values() if x.dtype.kind == "f"}
    if numbers not in ({"float64"}, {"float32"}):
        raise ValueError("numbers are neither all of float64 nor all of float32")

    def get(name: str, kinds: str = "f") -> jax.Array:
        value = tensors[name]
        if value.dtype.kind not in kinds:
            raise ValueError(f"{name} is of another kind of numbers ({value.dtype})")
        if value.dtype.kind == "f" and not np.all(np.isfinite(value)):
            raise ValueError(f"{name} holds values that are not finite")
        return jax.device_put(value)

    models = []
    for n, entry in enumerate(header["models"]):
        lead = f".models[{n}]"
        validity = VALIDITIES.get(entry["validity"])
        if validity is None:
            raise _Unknown(entry["validity"])
        fields = {
            f.name: "f" if f.name in validity.trained else "fib"
            for f in dataclasses.fields(validity)
        }
        table = {"factor": "i", "index": "i", "used": "b", "coefficient": "f"}
        local = LocalModels(*(get(f"{lead}.local.{f}", k) for f, k in table.items()))
        models.append(
            OutputModel(
                _variables(entry, "scheduling", signals),
                get(f"{lead}.offset"),
                get(f"{lead}.span"),
                validity(*(get(f"{lead}.validity.{f}", k) for f, k in fields.items())),
                get(f"{lead}.active", "b"),
                local,
                _groups(get(f"{lead}.own", "b")) if f"{lead}.own" in tensors else None,
                _root(lead, get) if f"{lead}.root.floor" in tensors else None,
            )
        )
    after = header.get("invalid_after")
    hold = get(".hold") if ".hold" in tensors else None
    network = Network(
        channels,
        tuple(int(o) for o in header["modelled"]),
        _variables(header, "variables", signals),
        tuple(models),
        *(
            get(f".{f}")
            for f in ("gain", "lower", "upper", "low", "high", "sample_time")
        ),
        hold=hold,
        window=_require_count(header["window"], WINDOW_WORDS) if channels.hidden else 0,
        outside=_text(header.get("outside", _usual(hold))),
        nan=_text(header.get("nan", HOLD)),
        invalid_after=None if after is None else _require_count(after, AFTER_WORDS),
        domain=_domain(header, get),
        certificate=get(".certificate") if ".certificate" in tensors else None,
        errors=_errors(get) if ".errors.knots" in tensors else None,
    )
    require_consistent(network)
    return network


def _domain(header: dict[str, Any], get: Callable[..., jax.Array]) -> Domain | None:
    """The domain, if there is one."""
    if "domain" not in header:
        return None
    features = _variables(header["domain"], "features", len(header["inputs"]))
    names = [f.name for f in dataclasses.fields(Domain) if f.name != "features"]
    return Domain(features, *(get(f".domain.{name}") for name in names))


def _errors(get: Callable[..., jax.Array]) -> ErrorModel:
    """The error model."""
    return ErrorModel(
        *(get(f".errors.{field.name}") for field in dataclasses.fields(ErrorModel))
    )


def _root(lead: str, get: Callable[..., jax.Array]) -> SignedRoot:
    """The root that groups of an output compute."""
    return SignedRoot(get(f"{lead}.root.squares", "b"), get(f"{lead}.root.floor"))


def _groups(own: jax.Array) -> jax.Array:
    """A list of the local models that are groups by themselves, of format 4."""
    return jnp.diag(own) if own.ndim == 1 else own
