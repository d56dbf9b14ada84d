"""How good a network is: metrics, and a report of one-step and free-run figures."""

from jaxnarx.evaluation import metrics as metrics
from jaxnarx.evaluation.cost import Cost as Cost
from jaxnarx.evaluation.cost import cost as cost
from jaxnarx.evaluation.cost import pareto as pareto
from jaxnarx.evaluation.local_models import local_behaviour as local_behaviour
from jaxnarx.evaluation.reactivation import reactivation as reactivation
from jaxnarx.evaluation.region_errors import RegionError as RegionError
from jaxnarx.evaluation.region_errors import region_errors as region_errors
from jaxnarx.evaluation.region_errors import region_sentence as region_sentence
from jaxnarx.evaluation.regions import describe_partition as describe_partition
from jaxnarx.evaluation.report import Report as Report
from jaxnarx.evaluation.reporting import report as report
from jaxnarx.evaluation.residual_tests import Diagnostics as Diagnostics
from jaxnarx.evaluation.residual_tests import diagnose as diagnose
from jaxnarx.evaluation.rows import Row as Row
from jaxnarx.evaluation.shown import ShownRecord as ShownRecord
from jaxnarx.evaluation.traces import Residuals as Residuals
from jaxnarx.evaluation.traces import Trace as Trace
from jaxnarx.evaluation.verdict import Verdict as Verdict
from jaxnarx.evaluation.verdict import judge as judge
