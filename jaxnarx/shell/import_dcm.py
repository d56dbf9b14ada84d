"""`jaxnarx import-dcm`: changed parameters of an export, back into the model."""

import numpy as np

from jaxnarx.exporters import lower, read_parameters, read_text
from jaxnarx.models import Network, load, load_about, save
from jaxnarx.shell import output
from jaxnarx.shell.commands import ImportDcm
from jaxnarx.shell.messages import about, count, quote_command, say
from jaxnarx.shell.next_command import tell_next

MODEL_FILE = "model.safetensors"


def import_dcm(command: ImportDcm) -> int:
    """Write the model with what has changed, and say what that is."""
    before = load(command.model)
    with about(command.model):
        after = read_parameters(before, read_text(command.file), command.file)
    for line in list_changes(before, after):
        say(line)
    if after is before:
        say("Nothing has changed; no model was written.")
        return 0
    told = {**load_about(command.model), "parameters": command.file}
    with output.run_folder(
        command.out, "", force=command.force, marks=[MODEL_FILE]
    ) as here:
        save(after, here / MODEL_FILE, about=told)
    for line in list_losses(before, after):
        say(line)
    say(f"wrote {here / MODEL_FILE}")
    tell_next(quote_command("jaxnarx", "report", str(here / MODEL_FILE), "DESCRIPTION"))
    return 0


def list_changes(before: Network, after: Network) -> list[str]:
    """The number of changed entries of every table, and the largest change."""
    old, new = ({t.name: t for t in lower(n).tables} for n in (before, after))
    lines = []
    for name, table in old.items():
        now = new[name].values
        if now.shape != table.values.shape:
            lines.append(f"{name}: a term has vanished, all its coefficients are zero")
            continue
        off = np.abs(now - table.values)
        if np.any(off):
            number = int(np.count_nonzero(off))
            lines.append(
                f"{name}: {count(number, 'number')} changed, by {off.max():.3g} at most"
            )
    return lines


def list_losses(before: Network, after: Network) -> list[str]:
    """The facts that were known of the model before and are not of what it is now."""
    lines = []
    if before.errors is not None and after.errors is None:
        lines.append("The model has no prediction intervals any more.")
    if before.certificate is not None:
        found = after.certificate is not None
        lines.append(
            "A certificate of stability was found for the new numbers."
            if found
            else "No certificate of stability was found for the new numbers."
        )
    return lines
