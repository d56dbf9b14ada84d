"""Figures: plain data in, a matplotlib figure out; `style` is the look of them all."""

from jaxnarx.shell.figures import comparison as comparison
from jaxnarx.shell.figures import partition as partition
from jaxnarx.shell.figures import relevance as relevance
from jaxnarx.shell.figures import report as report
from jaxnarx.shell.figures import residuals as residuals
from jaxnarx.shell.figures import sections as sections
from jaxnarx.shell.figures import steady_states as steady_states
from jaxnarx.shell.figures import tree as tree
