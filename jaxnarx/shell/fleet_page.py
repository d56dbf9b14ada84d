"""The page of a fleet: one offline HTML file without scripts."""

import numpy as np
from markupsafe import Markup

from jaxnarx.fleet import FleetPrior
from jaxnarx.formatting import count, list_names
from jaxnarx.shell.figures.fleet import (
    distances,
    errors_by_donors,
    errors_by_samples,
    shrinkage,
    spread_of_coefficients,
)
from jaxnarx.shell.figures.svg import svg
from jaxnarx.shell.plain_page import figure, heading, paragraph, plain_page, table
from jaxnarx.shell.report.html import figure_text

SHOWN_DONORS = 400


def fleet_page(prior: FleetPrior) -> str:
    """The page as text: what was learnt, what samples reach, coefficients, donors."""
    names = prior.network.output_names
    title = f"Fleet: {list_names(names)}"
    parts = [_first(prior), heading("A new engine, by its samples")]
    parts.append(
        paragraph(
            "Free-run NRMSE of donors that the others calibrated from so many samples, "
            "on their last ones; the mean of logarithms. The ways compete again for "
            "every engine that is calibrated."
        )
    )
    for o in range(len(names)):
        said = f"Error of {names[o]} by samples"
        picture = errors_by_samples(prior, o)
        parts += [figure(svg(picture, f"errors{o}-", said)), _ladder(prior, o)]
    if prior.counts:
        parts.append(heading("What more donors bring"))
        parts += [
            figure(
                svg(errors_by_donors(prior, o), f"counts{o}-", f"{names[o]} by donors")
            )
            for o in range(len(names))
        ]
    parts.append(heading("In what engines differ"))
    picture = spread_of_coefficients(prior)
    parts.append(figure(svg(picture, "spread-", "Spread of coefficients")))
    parts.append(
        paragraph(
            "What the fleet adds to an engine's own samples: its coefficients are "
            "drawn to the mean where its records do not tell."
        )
    )
    parts.append(figure(svg(shrinkage(prior), "shrinkage-", "Shrinkage")))
    parts.append(heading("Donors"))
    picture = distances(prior)
    parts += [figure(svg(picture, "donors-", "Distances")), _donors(prior)]
    return plain_page(title, parts)


def _first(prior: FleetPrior) -> Markup:
    """What was learnt from whom, in sentences."""
    used, left = int(prior.used.sum()), prior.broken()
    said = (
        f"Learnt from {count(used, 'donor')}: {count(len(prior.names), 'coefficient')} "
        "differ between engines"
        + (", gates of regions among them" if prior.gates else "")
        + "."
    )
    if left:
        said += f" Not used: {list_names(left)}."
    if prior.warm_up:
        said += (
            f" The first {prior.warm_up} samples of every record count nowhere, as "
            "filters remember what was before."
        )
    return paragraph(said)


def _ladder(prior: FleetPrior, output: int) -> Markup:
    name = prior.network.output_names[output]
    rows = [
        [kind, *(figure_text(float(e), 3) for e in errors)]
        for kind, errors in prior.expected(output).items()
    ]
    return table([f"{name}, samples", *map(str, prior.rungs)], rows)


def _donors(prior: FleetPrior) -> Markup:
    """Donors that were not used first, then those farthest from the others."""
    order = np.lexsort((-prior.distance, prior.used))[:SHOWN_DONORS]
    rows = [
        [
            prior.donors[n],
            figure_text(float(prior.distance[n]), 3),
            figure_text(float(np.sqrt(prior.freedom[n])), 3),
            prior.remark[n] or "used",
        ]
        for n in order.tolist()
    ]
    return table(["donor", "distance", "expected about", ""], rows)
