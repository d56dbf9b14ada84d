"""Frequency response and coherence by Welch's averages, record by record.

Every record is cut into overlapping windowed segments; spectra are averages over the
segments of all records, which are never joined. With inputs u, output y and spectra S
the response is H = S_yu S_uu^-1 and the (multiple) coherence the share of S_yy that it
explains, H S_uy / S_yy: with one input the ordinary |S_yu|^2 / (S_uu S_yy) of figure
4.3.

References: P. D. Welch 1967; J. S. Bendat and A. G. Piersol, Random Data, 4th ed. 2010,
chapter 9.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy.special
from jaxtyping import Complex, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import require_known
from jaxnarx.data import Channel, Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.linear.orders import output_place

WINDOW_NAME = "hann"
OVERLAP_SHARE = 0.5


@dataclasses.dataclass(frozen=True, eq=False)
class Spectra:
    """Averaged spectra, response and coherence.

    Frequencies in Hz, between zero and that of Nyquist, both excluded.

    `response` is in units of the output per unit of the input; `deviation` the standard
    deviation of its magnitude (and, over the magnitude, of its phase [rad]), (9.58) of
    Bendat and Piersol; infinite where inputs cannot be told apart. `coherence` is 0 to
    1. `output_spectrum` and `residual_spectrum`, what the response does not explain,
    are one-sided densities [output^2/Hz], the latter corrected for the degrees of
    freedom the response takes. `averages` is the number of independent segments that
    the overlapping ones amount to, `segments` their number.
    """

    frequency: Float[np.ndarray, " points"]
    response: Complex[np.ndarray, "points inputs"]
    deviation: Float[np.ndarray, "points inputs"]
    coherence: Float[np.ndarray, " points"]
    output_spectrum: Float[np.ndarray, " points"]
    residual_spectrum: Float[np.ndarray, " points"]
    segments: int
    averages: float
    sample_time: float
    inputs: tuple[Channel, ...]
    output: Channel

    @property
    def chance(self) -> float:
        """Coherence that unrelated signals stay below at 95 % of the frequencies.

        With one input 1 - 0.05^(1/(n - 1)), n averages.
        """
        inputs = len(self.inputs)
        return float(scipy.special.betaincinv(inputs, self.averages - inputs, 0.95))


@guard_arguments
def spectra(
    data: Dataset,
    *,
    inputs: str | Sequence[str] | None = None,
    output: str | None = None,
    segment: int | None = None,
    overlap: float = OVERLAP_SHARE,
    window: str = WINDOW_NAME,
) -> Spectra:
    """Response from `inputs` (default: all) to `output`, with coherence.

    `segment` is the length of a segment [samples], by default an eighth of the longest
    record but at most 1024; it must be several times the system's memory, or leakage
    lowers the coherence of a perfectly linear system. `overlap` is a share of it,
    `window` a name of `scipy.signal.get_window`. Segments that hold a missing sample
    are left out, records shorter than one too; means of segments are removed. With
    several inputs the coherence is the multiple one: the ordinary one of a single input
    is low because of the others.

    Fewer segments than two more than inputs raise `DataError`.
    """
    used = input_places(data, inputs)
    place = output_place(data, output)
    segment = default_segment(data) if segment is None else segment
    step = _step(segment, overlap)
    transforms, taper = segment_transforms(data, used, place, segment, step, window)
    count, inputs_used = len(transforms), len(used)
    averages = independent(count, taper, step)
    if averages < inputs_used + 2 and count < inputs_used + 2:
        raise DataError(
            f"{count} complete segments of {segment} samples are too few for "
            f"{inputs_used} input(s); use shorter segments or longer records"
        )
    one_sided = 2 * data.sample_time / float(np.sum(taper**2))
    s = np.einsum("nfi,nfj->fij", transforms.conj(), transforms) / count * one_sided
    frequency = np.fft.rfftfreq(segment, data.sample_time)[_inner_frequencies(segment)]
    response, noise, inverse = solve_response(s, inputs_used)
    total = np.real(s[:, -1, -1])
    coherence = np.clip(1 - noise / np.where(total > 0, total, 1.0), 0.0, 1.0)
    freedom = max(averages - inputs_used, 1.0)
    residual = noise * averages / freedom
    spread = np.sqrt(residual[:, None] * inverse / (2 * averages))
    channels = data.channels
    return Spectra(
        frequency,
        response,
        spread,
        np.where(total > 0, coherence, 0.0),
        total,
        residual,
        count,
        averages,
        data.sample_time,
        tuple(channels.inputs[i] for i in used),
        channels.outputs[place],
    )


def input_places(data: Dataset, names: str | Sequence[str] | None) -> tuple[int, ...]:
    """Positions of the named inputs; all where none are named."""
    known = data.channels.input_names
    chosen = known if names is None else [names] if isinstance(names, str) else names
    for name in chosen:
        require_known(name, known, "inputs", f"unknown input {name!r}")
    if not chosen:
        raise SpecError("spectra need at least one input", field="inputs")
    return tuple(known.index(name) for name in chosen)


def default_segment(data: Dataset) -> int:
    """An eighth of the longest record, at most 1024 and at least 16 samples."""
    return max(16, min(1024, max((len(r) for r in data), default=0) // 8))


def _inner_frequencies(segment: int) -> slice:
    """The frequencies of a real transform strictly between zero and the Nyquist
    frequency."""
    return slice(1, (segment + 1) // 2)


def _step(segment: int, overlap: float) -> int:
    if segment < 8 or not 0 <= overlap < 1:
        raise SpecError(
            f"a segment must have at least 8 samples and overlap lie in [0, 1), got "
            f"{segment} and {overlap}",
            field="segment",
        )
    return max(1, segment - int(round(segment * overlap)))


def segment_transforms(
    data: Dataset,
    inputs: Sequence[int],
    output: int,
    segment: int,
    step: int,
    window: str,
) -> tuple[
    Complex[np.ndarray, "segments points signals"], Float[np.ndarray, " segment"]
]:
    """Fourier transforms of the windowed segments, inputs then the output; the window.

    Without zero and the Nyquist frequency. Only segments of valid samples.
    """
    import scipy.signal

    taper = np.asarray(scipy.signal.get_window(window, segment))
    own = len(data.channels.inputs) + output
    pieces = []
    for record in data:
        x = np.concatenate([record.u[:, list(inputs)], record.y[:, [output]]], axis=1)
        good = np.all(record.valid[:, [*inputs, own]], axis=1)
        for start in range(0, len(record) - segment + 1, step):
            if good[start : start + segment].all():
                pieces.append(x[start : start + segment].astype(float))
    if not pieces:
        raise DataError(
            f"no record has {segment} valid samples in a row; use shorter segments"
        )
    cut = np.stack(pieces)
    cut = (cut - cut.mean(axis=1, keepdims=True)) * taper[None, :, None]
    return np.fft.rfft(cut, axis=1)[:, _inner_frequencies(segment)], taper


def independent(count: int, taper: Float[np.ndarray, " segment"], step: int) -> float:
    """Independent segments that `count` overlapping ones are worth (Welch 1967)."""
    energy, total = float(np.sum(taper**2)), 0.0
    for j in range(1, min(count, -(-len(taper) // step))):
        shared = float(np.sum(taper[j * step :] * taper[: len(taper) - j * step]))
        total += (count - j) / count * (shared / energy) ** 2
    return count / (1 + 2 * total)


def solve_response(
    s: Complex[np.ndarray, "points signals signals"], inputs: int
) -> tuple[
    Complex[np.ndarray, "points inputs"],
    Float[np.ndarray, " points"],
    Float[np.ndarray, "points inputs"],
]:
    """H = S_yu S_uu^-1, the unexplained spectrum, and the diagonal of S_uu^-1.

    Where inputs cannot be told apart the response is that of smallest norm, the
    diagonal infinite.
    """
    suu, suy = s[:, :inputs, :inputs], s[:, :inputs, inputs]
    root = np.sqrt(np.maximum(np.real(np.einsum("fii->fi", suu)), 0.0))
    root = np.where(root > 0, root, 1.0)
    scaled = suu / (root[:, :, None] * root[:, None, :])
    inverse = np.linalg.pinv(scaled, rcond=1e-10, hermitian=True)
    full = np.linalg.matrix_rank(scaled, tol=1e-10, hermitian=True) == inputs
    inverse = inverse / (root[:, :, None] * root[:, None, :])
    h = np.einsum("fij,fj->fi", inverse, suy)
    explained = np.real(np.einsum("fi,fi->f", h.conj(), suy))
    noise = np.maximum(np.real(s[:, inputs, inputs]) - explained, 0.0)
    diagonal = np.real(np.einsum("fii->fi", inverse))
    return h, noise, np.where(full[:, None], diagonal, np.inf)
