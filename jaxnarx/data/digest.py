"""Digests of measured samples: the same contents give the same digest."""

import hashlib

import numpy as np

from jaxnarx.data.dataset import Dataset
from jaxnarx.data.record import Record


def fingerprint(record: Record, names: list[str]) -> str:
    """SHA-256 of a record's samples by channel name, whatever the record is called."""
    columns = record.signals.astype(np.float64)
    digest = hashlib.sha256()
    for i in np.argsort(np.asarray(names)):
        digest.update(names[i].encode() + b"\0")
        digest.update(np.where(record.valid[:, i], columns[:, i], 0.0).tobytes())
        digest.update(np.ascontiguousarray(record.valid[:, i]).tobytes())
    return digest.hexdigest()


def data_hash(data: Dataset) -> str:
    """SHA-256 over all records of a dataset, in order."""
    names = data.channels.names
    joined = "".join(fingerprint(record, names) for record in data)
    return hashlib.sha256(joined.encode()).hexdigest()
