"""How good a network is: metrics, and a report of one-step and free-run figures."""

from jaxnarx.evaluation import metrics as metrics
from jaxnarx.evaluation.regions import describe_partition as describe_partition
from jaxnarx.evaluation.report import Report as Report
from jaxnarx.evaluation.report import report as report
from jaxnarx.evaluation.rows import Row as Row
from jaxnarx.evaluation.traces import Residuals as Residuals
from jaxnarx.evaluation.traces import Trace as Trace
