"""Reports of one output, made of free-run rows, for what a verdict says of them."""

from jaxnarx.data import Channel
from jaxnarx.evaluation import Report, Row


def row(part, record="pooled", nrmse=0.1, **more) -> Row:
    """A free run of an output of standard deviation 50 K."""
    figures = dict(rmse=50 * nrmse, nrmse=nrmse, r2=1 - nrmse**2)
    figures |= dict(fit=100 * (1 - nrmse), nmse=nrmse**2)
    if more.get("status", "").startswith("diverged"):
        figures = dict.fromkeys(figures)
    place = dict(part=part, output="T", unit="K", mode="free run", record=record)
    counts = dict(samples=1000, limited=0, extrapolated=0, status="ok")
    return Row(**(place | figures | counts | more))  # pyright: ignore


def made(*rows, main="test", **more) -> Report:
    return Report(
        (Channel("T", "K"),), main, rows, more.pop("notes", ()), (), (), **more
    )
