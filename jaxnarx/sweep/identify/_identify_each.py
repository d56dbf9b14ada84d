"""The verb `identify_each`: many engines and settings by one program."""

from collections.abc import Sequence
from typing import Any, Literal

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data import Fleet
from jaxnarx.settings import Identification
from jaxnarx.sweep.cases import Case
from jaxnarx.sweep.identify.work import FITS_PER_CALL, IdentificationWork


@guard_arguments
def identify_each(
    fleet: Fleet,
    method: Identification,
    cases: Sequence[Case] = ({},),
    members: Sequence[int | str] | None = None,
    *,
    batch: Literal["map", "vmap"] | int = "map",
    chunk: int = FITS_PER_CALL,
) -> list[dict[str, Any]]:
    """Select, grow, refine and score every engine under every case; a row for each.

    A case says what differs from `method`, by path: `{"refine.ridge": 1e-4}`. `members`
    names engines, by default all of them. The program is compiled once for a chunk of
    fits; `batch` says how it takes them: one after the other, all side by side, or so
    many side by side. Results do not depend on it but for rounding.

    A row holds the labels (`engine`, `case` and the settings under the paths that any
    case names), `status` and `detail`, and what `jaxnarx.sweep.network_of` needs;
    scores are NRMSE pooled over the records of a part, one step ahead and in free run,
    of the grown network (`train_one_step_start`, `test_free_run_start`) and of the
    refined one
    (`test_free_run`), infinite where a record has diverged (`..._diverged`), None where
    an engine could not be identified.

    Statuses: `ok`; `no_improvement` where no step was better by the validation records'
    free run; `unidentifiable` where the chosen terms are collinear, or nothing excites
    the engine; `start_diverged` where no network was found that runs within its bounds
    on the validation records; `diverged` where the result leaves them in another part;
    `nonfinite_data` and `too_short` of an engine's records.
    """
    if members is not None:
        at = [fleet.index(m) if isinstance(m, str) else int(m) for m in members]
        fleet = fleet.pick(at)
    total = len(fleet) * len(cases)
    lanes = max(1, min(chunk, total))
    at_once = {"map": 1, "vmap": lanes}.get(batch, batch)  # pyright: ignore
    work = IdentificationWork(fleet, method, cases, lanes=lanes, at_once=int(at_once))
    rows = work.run(range(total))
    return [label | row for label, row in zip(work.members, rows, strict=True)]
