"""The page of a fleet: one offline HTML file without scripts."""

from pathlib import Path

import numpy as np
from markupsafe import Markup, escape

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
from jaxnarx.shell.report.html import figure_text

STYLE = Path(__file__).parent / "report" / "templates" / "style.css"
POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
SHOWN_DONORS = 400


def fleet_page(prior: FleetPrior) -> str:
    """The page as text: what was learnt, what samples reach, coefficients, donors."""
    names = prior.network.output_names
    heading = f"Fleet: {list_names(names)}"
    parts = [Markup("<h1>{}</h1>").format(heading), _first(prior)]
    parts.append(Markup("<h2>A new engine, by its samples</h2>"))
    parts.append(
        Markup(
            "<p>Free-run NRMSE of donors that the others calibrated from so many "
            "samples, on their last ones; the mean of logarithms. The ways compete "
            "again for every engine that is calibrated.</p>"
        )
    )
    for o in range(len(names)):
        title = f"Error of {names[o]} by samples"
        picture = errors_by_samples(prior, o)
        parts += [_figure(svg(picture, f"errors{o}-", title)), _ladder(prior, o)]
    if prior.counts:
        parts.append(Markup("<h2>What more donors bring</h2>"))
        parts += [
            _figure(
                svg(errors_by_donors(prior, o), f"counts{o}-", f"{names[o]} by donors")
            )
            for o in range(len(names))
        ]
    parts.append(Markup("<h2>In what engines differ</h2>"))
    picture = spread_of_coefficients(prior)
    parts.append(_figure(svg(picture, "spread-", "Spread of coefficients")))
    parts.append(
        Markup(
            "<p>What the fleet adds to an engine's own samples: its coefficients are "
            "drawn to the mean where its records do not tell.</p>"
        )
    )
    parts.append(_figure(svg(shrinkage(prior), "shrinkage-", "Shrinkage")))
    parts.append(Markup("<h2>Donors</h2>"))
    picture = distances(prior)
    parts += [_figure(svg(picture, "donors-", "Distances")), _donors(prior)]
    body = Markup("\n").join(parts)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{escape(heading)}</title>\n<style>\n{STYLE.read_text()}</style>\n"
        f"</head>\n<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def _figure(text: str) -> Markup:
    return Markup("<figure>{}</figure>").format(Markup(text))


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
    return Markup("<p>{}</p>").format(said)


def _ladder(prior: FleetPrior, output: int) -> Markup:
    head = Markup("").join(Markup("<th>{}</th>").format(n) for n in prior.rungs)
    rows = Markup("").join(
        Markup("<tr><td>{}</td>{}</tr>").format(
            kind,
            Markup("").join(
                Markup("<td>{}</td>").format(figure_text(float(e), 3)) for e in errors
            ),
        )
        for kind, errors in prior.expected(output).items()
    )
    name = prior.network.output_names[output]
    return Markup(
        "<table><thead><tr><th>{}, samples</th>{}</tr></thead><tbody>{}</tbody></table>"
    ).format(name, head, rows)


def _donors(prior: FleetPrior) -> Markup:
    """Donors that were not used first, then those farthest from the others."""
    order = np.lexsort((-prior.distance, prior.used))[:SHOWN_DONORS]
    rows = Markup("").join(
        Markup("<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>").format(
            prior.donors[n],
            figure_text(float(prior.distance[n]), 3),
            figure_text(float(np.sqrt(prior.freedom[n])), 3),
            prior.remark[n] or "used",
        )
        for n in order.tolist()
    )
    return Markup(
        "<table><thead><tr><th>donor</th><th>distance</th><th>expected about</th>"
        "<th></th></tr></thead><tbody>{}</tbody></table>"
    ).format(rows)
