"""Residual analysis with probabilities that hold: the verb `diagnose` and its parts."""

from jaxnarx.evaluation.residual_tests._diagnose import diagnose as diagnose
from jaxnarx.evaluation.residual_tests.diagnostics import Diagnostics as Diagnostics
from jaxnarx.evaluation.residual_tests.diagnostics import (
    OutputDiagnostics as OutputDiagnostics,
)
from jaxnarx.evaluation.residual_tests.free_run import (
    FreeRunResiduals as FreeRunResiduals,
)
from jaxnarx.evaluation.residual_tests.free_run import (
    diagnose_free_run as diagnose_free_run,
)
from jaxnarx.evaluation.residual_tests.lag_tests import LagTest as LagTest
from jaxnarx.evaluation.residual_tests.operating_point import (
    OperatingPoint as OperatingPoint,
)
from jaxnarx.evaluation.residual_tests.scalar_tests import ScalarTest as ScalarTest
