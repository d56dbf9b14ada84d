"""How good a network is: metrics, and a report of one-step and free-run figures."""

from jaxnarx import metrics as metrics
from jaxnarx.evaluation._cost import Cost as Cost
from jaxnarx.evaluation._cost import cost as cost
from jaxnarx.evaluation._cost import pareto as pareto
from jaxnarx.evaluation._error_map import THIN_CELL as THIN_CELL
from jaxnarx.evaluation._error_map import ErrorMap as ErrorMap
from jaxnarx.evaluation._error_map import error_map as error_map
from jaxnarx.evaluation._reactivation import reactivation as reactivation
from jaxnarx.evaluation._region_errors import RegionError as RegionError
from jaxnarx.evaluation._region_errors import region_errors as region_errors
from jaxnarx.evaluation._region_errors import region_sentence as region_sentence
from jaxnarx.evaluation._relevance import Relevance as Relevance
from jaxnarx.evaluation._relevance import relevance as relevance
from jaxnarx.evaluation._report import Report as Report
from jaxnarx.evaluation._steady_states import Intersection as Intersection
from jaxnarx.evaluation._steady_states import ResponseSurface as ResponseSurface
from jaxnarx.evaluation._steady_states import intersections as intersections
from jaxnarx.evaluation._steady_states import response_surface as response_surface
from jaxnarx.evaluation._steady_states import steady_states as steady_states
from jaxnarx.evaluation.analyses import ANALYSES as ANALYSES
from jaxnarx.evaluation.analyses import Analysis as Analysis
from jaxnarx.evaluation.charts import Band as Band
from jaxnarx.evaluation.charts import Bars as Bars
from jaxnarx.evaluation.charts import Cells as Cells
from jaxnarx.evaluation.charts import Chart as Chart
from jaxnarx.evaluation.charts import Colour as Colour
from jaxnarx.evaluation.charts import Curve as Curve
from jaxnarx.evaluation.charts import Mark as Mark
from jaxnarx.evaluation.charts import Number as Number
from jaxnarx.evaluation.charts import Picture as Picture
from jaxnarx.evaluation.charts import Range as Range
from jaxnarx.evaluation.charts import RegionMap as RegionMap
from jaxnarx.evaluation.charts import Span as Span
from jaxnarx.evaluation.charts import StraightLine as StraightLine
from jaxnarx.evaluation.charts import Text as Text
from jaxnarx.evaluation.charts import Values as Values
from jaxnarx.evaluation.charts import ellipse as ellipse
from jaxnarx.evaluation.charts import floats as floats
from jaxnarx.evaluation.charts import uprights as uprights
from jaxnarx.evaluation.comparison import ComparedRecord as ComparedRecord
from jaxnarx.evaluation.comparison import ModelComparison as ModelComparison
from jaxnarx.evaluation.comparison import compare as compare
from jaxnarx.evaluation.domain_errors import INDEX_EDGES as INDEX_EDGES
from jaxnarx.evaluation.gain_signs import GainFinding as GainFinding
from jaxnarx.evaluation.gain_signs import check_gains as check_gains
from jaxnarx.evaluation.local_models import LocalBehaviour as LocalBehaviour
from jaxnarx.evaluation.local_models import local_behaviour as local_behaviour
from jaxnarx.evaluation.page_records import ShownRecord as ShownRecord
from jaxnarx.evaluation.physics_checks import WrongSigns as WrongSigns
from jaxnarx.evaluation.physics_checks import count_wrong_signs as count_wrong_signs
from jaxnarx.evaluation.physics_checks import is_slower as is_slower
from jaxnarx.evaluation.physics_checks import (
    longest_time_constants as longest_time_constants,
)
from jaxnarx.evaluation.regions import describe_partition as describe_partition
from jaxnarx.evaluation.reporting import report as report
from jaxnarx.evaluation.residual_tests import Diagnostics as Diagnostics
from jaxnarx.evaluation.residual_tests import FreeRunResiduals as FreeRunResiduals
from jaxnarx.evaluation.residual_tests import LagTest as LagTest
from jaxnarx.evaluation.residual_tests import OperatingPoint as OperatingPoint
from jaxnarx.evaluation.residual_tests import OutputDiagnostics as OutputDiagnostics
from jaxnarx.evaluation.residual_tests import diagnose as diagnose
from jaxnarx.evaluation.residual_tests import diagnose_free_run as diagnose_free_run
from jaxnarx.evaluation.residual_tests.correlations import (
    LAG_TEST_TITLES as LAG_TEST_TITLES,
)
from jaxnarx.evaluation.residual_tests.diagnostics import HOW_ESTIMATED as HOW_ESTIMATED
from jaxnarx.evaluation.rows import Row as Row
from jaxnarx.evaluation.rules import judge as judge
from jaxnarx.evaluation.section import FreeRun as FreeRun
from jaxnarx.evaluation.section import Section as Section
from jaxnarx.evaluation.sizes import SizeErrors as SizeErrors
from jaxnarx.evaluation.sizes import errors_by_size as errors_by_size
from jaxnarx.evaluation.table import name_data as name_data
from jaxnarx.evaluation.table import number as number
from jaxnarx.evaluation.table import rows_beside as rows_beside
from jaxnarx.evaluation.traces import Residuals as Residuals
from jaxnarx.evaluation.traces import Trace as Trace
from jaxnarx.evaluation.verdict import AT_LEAST as AT_LEAST
from jaxnarx.evaluation.verdict import GOOD as GOOD
from jaxnarx.evaluation.verdict import LIMITED as LIMITED
from jaxnarx.evaluation.verdict import UNUSABLE as UNUSABLE
from jaxnarx.evaluation.verdict import Verdict as Verdict
from jaxnarx.evaluation.verdict import VerdictRule as VerdictRule

__all__ = [
    "ANALYSES",
    "Analysis",
    "Band",
    "Bars",
    "Cells",
    "Chart",
    "Curve",
    "FreeRun",
    "Picture",
    "RegionMap",
    "StraightLine",
    "Section",
    "Span",
    "Text",
    "Cost",
    "Diagnostics",
    "ErrorMap",
    "FreeRunResiduals",
    "GainFinding",
    "Intersection",
    "ModelComparison",
    "RegionError",
    "Relevance",
    "Report",
    "Residuals",
    "ResponseSurface",
    "Row",
    "ShownRecord",
    "SizeErrors",
    "Trace",
    "Verdict",
    "VerdictRule",
    "check_gains",
    "count_wrong_signs",
    "compare",
    "cost",
    "describe_partition",
    "diagnose",
    "diagnose_free_run",
    "error_map",
    "errors_by_size",
    "intersections",
    "judge",
    "local_behaviour",
    "longest_time_constants",
    "metrics",
    "pareto",
    "reactivation",
    "region_errors",
    "region_sentence",
    "relevance",
    "report",
    "response_surface",
    "steady_states",
]
"""Names for users; other rooms may import every name above."""
