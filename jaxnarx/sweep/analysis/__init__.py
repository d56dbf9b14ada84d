"""Analysis of a sweep's rows: best of a group, fronts, paired comparisons."""

from jaxnarx.sweep.analysis.groups import best_per_group as best_per_group
from jaxnarx.sweep.analysis.groups import pareto_front as pareto_front
from jaxnarx.sweep.analysis.groups import summary as summary
from jaxnarx.sweep.analysis.pairs import Comparison as Comparison
from jaxnarx.sweep.analysis.pairs import Interval as Interval
from jaxnarx.sweep.analysis.pairs import paired_comparison as paired_comparison
from jaxnarx.sweep.analysis.table import SweepTable as SweepTable
