"""The part of a report's page that runs: the model, the records, and scripts."""

from jaxnarx.shell.report.page._running import Running as Running
from jaxnarx.shell.report.page._running import exported_cost as exported_cost
from jaxnarx.shell.report.page._running import make_page as make_page
from jaxnarx.shell.report.page.records import Budget as Budget
